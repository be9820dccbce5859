"""The image of a case: its layout by keys, and no more of it read than the crop keeps."""

import numpy as np
import pytest

from isphcli.case.load import read_case
from isphcli.case.yaml import CaseError
from isphcli.geometry.images.image import VoxelError
from isphcli.output.convert_images import write_image
from isphcli.scene import image_file
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.image_file import image_of

CASE = """
geometry:
  voxels: {{file: {file}, labels: {{solid: 1, water: 0}}, voxel_size: 2 um, {keys}}}
  periodic: [x, y, z]
particles: {{spacing: 2.0e-6}}
fluids: {{water: {{density: 1000, viscosity: 1.0e-3}}}}
flow: stokes
drive: {{axes: [x]}}
"""
ROCK = (np.random.default_rng(0).random((6, 7, 9)) < 0.4).astype(np.uint16)


def case(tmp_path, file, keys=""):
    return read_case(CASE.format(file=file, keys=keys).encode(), tmp_path / "case.yaml")


def test_a_raw_file_by_the_keys_of_its_layout(tmp_path):
    (tmp_path / "scan.raw").write_bytes(b"head" + ROCK.astype(">u2").tobytes())
    spec = case(tmp_path, "scan.raw", "shape: [9, 7, 6], dtype: uint16, offset: 4, byte_order: big").geometry.voxels
    assert np.array_equal(image_of(spec).values, ROCK)


def test_what_was_read_and_how_it_was_understood_is_said(tmp_path):
    (tmp_path / "rock_9x7x6_uint16.raw").write_bytes(ROCK.transpose().tobytes())
    geometry = build_geometry(case(tmp_path, "rock_9x7x6_uint16.raw", "axes: xyz, crop: [[2, 8], [1, 6], [0, 4]]"))
    assert np.array_equal(geometry.labels < 0, ROCK[:4, 1:6, 2:8] == 1)
    said = dict(geometry.described)["image"]
    assert "6 x 5 x 4 voxels along x, y, z, cropped from 9 x 7 x 6" in said
    assert "is an array 9 x 7 x 6, its axes taken as x, y, z" in said
    assert any("shape and dtype by its name and size" in text for text in geometry.warnings)


def test_a_folder_of_slices_in_a_case(tmp_path):
    import tifffile

    (tmp_path / "scan").mkdir()
    for k, one in enumerate(ROCK):
        tifffile.imwrite(tmp_path / "scan" / f"{k}.tif", one)
    assert np.array_equal(build_geometry(case(tmp_path, "scan")).labels < 0, ROCK == 1)


def test_only_the_part_that_is_kept_is_read(tmp_path):
    """A file of 4 GB that takes no room on the disk: its end is read in an instant and in no memory to speak of."""
    import tracemalloc

    side = 1600
    with open(tmp_path / "rock.raw", "wb") as file:
        file.truncate(side**3)
        file.seek(side**3 - 1)
        file.write(b"\1")
    part = ", ".join(f"[{side - n}, {side}]" for n in (8, 9, 10))
    spec = case(tmp_path, "rock.raw", f"shape: [{side}, {side}, {side}], dtype: uint8, crop: [{part}]").geometry.voxels
    tracemalloc.start()
    values = image_of(spec).values
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert values.shape == (10, 9, 8) and values.sum() == values[-1, -1, -1] == 1
    assert peak < 20e6  # bytes: ten layers of the kept rows, one at a time, of 1600 x 9


@pytest.mark.parametrize(("name", "times"), [("rock.npy", 1), ("rock.npz", 1), ("rock.nrrd", 1), ("rock.raw", 3)])
def test_an_image_is_read_once_until_its_file_changes(tmp_path, monkeypatch, name, times):
    """Not where its data may be in another file than the one that is looked at."""
    read, real = [], image_file.read_image
    monkeypatch.setattr(image_file, "read_image", lambda *words, **more: read.append(words) or real(*words, **more))
    for rock in (ROCK, 1 - ROCK):
        read.clear()
        if name == "rock.raw":
            (tmp_path / name).write_bytes(rock.astype(np.uint8).tobytes())
        else:
            write_image(tmp_path / name, rock)
        spec = case(tmp_path, name, "shape: [9, 7, 6]" if name == "rock.raw" else "").geometry.voxels
        for _ in range(3):
            found = image_of(spec).values
            assert np.array_equal(found, rock) and found.dtype == np.uint8
        assert len(read) == times


def test_the_whole_of_a_large_file_is_refused_before_it_is_read(tmp_path):
    with open(tmp_path / "rock.raw", "wb") as file:
        file.truncate(10**13)
    spec = case(tmp_path, "rock.raw", "shape: [100000, 10000, 10000], dtype: uint8").geometry.voxels
    with pytest.raises(VoxelError, match="more than half of the memory; crop the image"):
        image_of(spec)


@pytest.mark.parametrize(
    ("file", "keys", "message"),
    [
        ("a.npy", "shape: [9, 7, 6]", r"geometry.voxels.shape: is of files without a header \(.raw, .bin, .dat\)"),
        ("a.npy", "dtype: uint8", "geometry.voxels.dtype: is of files without a header"),
        ("a.raw", "shape: [9, 7, 6], dtype: uint9", "'uint9' is not a choice; did you mean 'uint"),
        ("a.raw", "shape: [9, 0, 6]", "must be at least 1"),
        ("a.raw", "shape: [9]", "expected 2 or 3 entries"),
        ("a.raw", "array: rock", "only .npz, .h5, .hdf5, .vti, .vtk, .mat files hold named arrays"),
        ("a.dat", "offset: 5", "geometry.voxels.offset: is of files without a header"),
        ("a.raw", "byte_order: middle", "not a choice"),
        ("a.npy", "axes: zzz", "not a choice"),
        ("nowhere", "", "no such file"),
    ],
)
def test_keys_that_do_not_fit_the_file(tmp_path, file, keys, message):
    if "." in file:
        (tmp_path / file).write_bytes(b"0")
    with pytest.raises(CaseError, match=message):
        case(tmp_path, file, keys)
