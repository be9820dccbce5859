"""`isph convert-voxels`: values, sizes, and the files that it may replace."""

import errno
import os
import re
from pathlib import Path

import numpy as np
import pytest

from isphcli.geometry.images.image import Layout, VoxelError
from isphcli.geometry.images.read import read_image
from isphcli.output.convert_images import Conversion, convert, slab_shape, write_image
from tests.geometry.images.files import rock


def test_convert_grey_values(tmp_path):
    grey = np.array([[-5, 100, 200], [99, 101, 300]], np.int16)[None].repeat(4, 0)
    np.save(tmp_path / "g.npy", grey)
    found = convert(tmp_path / "g.npy", tmp_path / "o.mhd", Conversion(threshold=100, voxel_size=2e-6))
    assert read_image(tmp_path / "o.mhd").values[0].tolist() == [[0, 1, 1], [0, 1, 1]]
    assert found["threshold"] == "grey >= 100 is solid" and found["porosity"] == pytest.approx(1 / 3)
    assert found["percolates"] == {"x": False, "y": True, "z": True} and found["labels"] == {0: 8, 1: 16}
    assert found["voxel_size"] == (2e-6,) * 3 and found["shape"] == {"x": 3, "y": 2, "z": 4}
    how = Conversion(threshold=100, invert=True, crop_to=((1, 3), (0, 2), (0, 1)))
    found = convert(tmp_path / "g.npy", tmp_path / "o.npz", how)
    assert found["porosity"] == 1 and found["threshold"].startswith("grey < 100 is solid; 100 parts nothing")


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("target, there", [("o.mhd", "o.raw"), ("o.mhd", "o.mhd"), ("o.npy", "o.npy"),
                                           ("o.npz", "o.npz"), ("o.mha", "o.mha"), ("o.NPY", "o.NPY")])
def test_a_conversion_replaces_nothing_unasked(tmp_path, target, there):
    """Neither its target nor the raw file beside it; with force both, and all is as in an empty folder."""
    (tmp_path / "empty").mkdir()
    np.save(tmp_path / "a.npy", np.arange(6, dtype=np.uint8).reshape(2, 3))
    convert(tmp_path / "a.npy", tmp_path / "empty" / target)
    folder = tmp_path / "full"
    folder.mkdir()
    (folder / there).write_text("mine")
    with pytest.raises(VoxelError, match=f"{re.escape(there)}: exists; .*--force"):
        convert(tmp_path / "a.npy", folder / target)
    assert files(folder) == {there: b"mine"}
    convert(tmp_path / "a.npy", folder / target, force=True)
    suffix = Path(target).suffix.lower()
    assert files(folder).keys() == ({"o.mhd", "o.raw"} if suffix == ".mhd" else {target})
    assert suffix == ".npz" or files(folder) == files(tmp_path / "empty")  # a zip holds the time
    assert np.array_equal(read_image(folder / target).values, np.load(tmp_path / "a.npy"))


@pytest.mark.parametrize("source, target", [("a.mhd", "a.mhd"), ("a.mhd", "b.mhd"), ("b.raw.mha", "link.mha"),
                                            ("g.npy", "./g.npy"), ("a.mhd", "hard.mha")])
def test_an_image_is_not_written_over_by_what_is_made_of_it(tmp_path, source, target):
    """By no other name either, not through a link, and not the data that its header names."""
    write_image(tmp_path / "b.mhd", np.arange(6, dtype=np.uint8).reshape(2, 3))
    (tmp_path / "b.mhd").rename(tmp_path / "a.mhd")  # its data are in b.raw
    write_image(tmp_path / "b.raw.mha", np.arange(6, dtype=np.uint8).reshape(2, 3))
    np.save(tmp_path / "g.npy", np.arange(6, dtype=np.uint8).reshape(2, 3))
    (tmp_path / "link.mha").symlink_to("b.raw.mha")
    (tmp_path / "hard.mha").hardlink_to(tmp_path / "b.raw")
    before = files(tmp_path)
    with pytest.raises(VoxelError, match="is read from, and cannot be written over"):
        convert(tmp_path / source, tmp_path / target, force=True)
    assert files(tmp_path) == before


@pytest.mark.parametrize("target", ["o.mhd", "o.npy", "o.npz", "o.mha"])
def test_a_conversion_that_fails_on_the_way_leaves_what_was_there(tmp_path, target, monkeypatch):
    """A disk that is full before the first file is whole: the files of before, and no part of a new one. The data of
    an mhd come before the header that names them."""
    np.save(tmp_path / "a.npy", np.arange(6, dtype=np.uint8).reshape(2, 3))
    folder = tmp_path / "full"
    folder.mkdir()
    convert(tmp_path / "a.npy", folder / target)
    before, real, moved = files(folder), os.replace, []

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        with pytest.raises(VoxelError, match="cannot be written"):
            convert(tmp_path / "a.npy", folder / target, force=True)
    assert files(folder) == before
    monkeypatch.setattr(os, "replace", lambda a, b: (moved.append(Path(b).name), real(a, b)))
    convert(tmp_path / "a.npy", folder / target, force=True)
    assert moved == (["o.raw", "o.mhd"] if target == "o.mhd" else [target])


def test_convert_relabels_and_downsamples_by_majority(tmp_path):
    values = np.zeros((4, 5), np.uint8)
    values[:2, :2] = [[255, 255], [255, 0]]  # mostly solid
    values[2:, :2] = [[255, 255], [0, 2]]  # half and half: pore
    values[:2, 2:4] = 2
    np.save(tmp_path / "a.npy", values)
    found = convert(tmp_path / "a.npy", tmp_path / "b.npz", Conversion(labels={255: 1}, downsample=2, voxel_size=1.0))
    image = read_image(tmp_path / "b.npz")
    assert image.values.tolist() == [[1, 2], [0, 0]] and image.spacing == (2, 2)
    assert found["labels"] == {0: 2, 1: 1, 2: 1}


@pytest.mark.parametrize(
    "options, message",
    [
        ({"labels": {9: 1}}, "no voxel has the value"),
        ({"labels": {1: 999}}, "0 to 255"),
        ({"crop_to": ((0, 9), (0, 3), (0, 3))}, "crop x"),
        ({"crop_to": ((0, 2),)}, "one per axis"),
        ({"downsample": 4}, "downsample"),
        ({"downsample": 0}, "downsample"),
        ({"voxel_size": -1}, "positive"),
        ({"voxel_size": (1, 1)}, "one number or 3"),
    ],
)
def test_bad_conversions(tmp_path, options, message):
    np.save(tmp_path / "a.npy", np.ones((3, 3, 3), np.uint8))
    with pytest.raises(VoxelError, match=message):
        convert(tmp_path / "a.npy", tmp_path / "b.npy", Conversion(**options))
    with pytest.raises(VoxelError, match="not written"):
        convert(tmp_path / "a.npy", tmp_path / "b.png")


def test_a_conversion_says_where_the_voxel_size_is_from(tmp_path):
    np.savez(tmp_path / "a.npz", image=rock() + 1, voxel_size=2e-6)
    found = convert(tmp_path / "a.npz", tmp_path / "b.npz")
    assert found["voxel_size"] == (2e-6,) * 3 and found["voxel_size_from"] == "from a.npz" and found["warnings"] == ()
    found = convert(tmp_path / "a.npz", tmp_path / "c.npz", Conversion(voxel_size=(1e-6, 2e-6, 3e-6)))
    assert found["voxel_size"] == (1e-6, 2e-6, 3e-6)
    assert "given, 1e-06 x 2e-06 x 3e-06 m, is not that" in found["warnings"][0]
    write_image(tmp_path / "d.mhd", rock() + 1, (1.0, 1.0, 1.0))
    assert convert(tmp_path / "d.mhd", tmp_path / "e.npz")["voxel_size"] is None


BLOCK = np.zeros((6, 7, 9), np.uint8)  # [z, y, x]: a block of solid with two pores in a border of solid
BLOCK[...] = 1
BLOCK[2:4, 3, 1:8] = 0  # along x, closed at both ends by the border
BLOCK[2, 5, 4] = 0


def test_the_steps_of_a_conversion_in_their_order(tmp_path):
    """The border is cut off, and the long pore reaches the ends; the short one is filled; the mirror image follows."""
    np.save(tmp_path / "a.npy", BLOCK)
    how = Conversion(trim=True, mirror=("y",), connected="x", voxel_size=2e-6)
    found = convert(tmp_path / "a.npy", tmp_path / "b.npz", how)
    image = read_image(tmp_path / "b.npz")
    expected = np.ones((2, 6, 7), np.uint8)
    expected[:, 0] = expected[:, 5] = 0
    assert np.array_equal(image.values, expected) and image.spacing == (2e-6,) * 3
    assert found["trimmed"] == (2, 4, 4) and found["filled"] == 2 and found["percolates"]["x"]
    assert found["read"] == "npy, array 6 x 7 x 9, its axes taken as z, y, x"


def test_two_labels_are_exchanged_and_axes_put_in_order(tmp_path):
    np.save(tmp_path / "a.npy", np.ascontiguousarray(BLOCK.transpose()))
    found = convert(tmp_path / "a.npy", tmp_path / "b.npy", Conversion(layout=Layout(axes="xyz"), invert=True))
    assert np.array_equal(np.load(tmp_path / "b.npy"), 1 - BLOCK) and found["shape"] == {"x": 9, "y": 7, "z": 6}


@pytest.mark.parametrize(
    "threshold, values", [(50, {0: 3, 1: 6}), ((50, 150), {0: 3, 2: 3, 1: 3}), ("otsu", {0: 3, 1: 6})]
)
def test_thresholds_of_two_and_three_phases(tmp_path, threshold, values):
    np.save(tmp_path / "a.npy", np.array([[10, 11, 12], [140, 141, 142], [180, 181, 182]], np.uint8))
    assert convert(tmp_path / "a.npy", tmp_path / "b.npy", Conversion(threshold=threshold))["labels"] == values


@pytest.mark.parametrize("suffix", ["npy", "npz", "mhd", "mha", "tif", "nrrd", "raw"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(5, 6, 7), (6, 7)])
def test_what_is_written_is_read_back_with_its_voxel_size(tmp_path, suffix, dtype, shape):
    values = (np.random.default_rng(0).random(shape) * 200).astype(dtype)
    spacing = (1e-6, 2e-6, 3e-6)[: len(shape)]
    path = tmp_path / f"a.{suffix}"
    write_image(path, values, spacing)
    layout = Layout(shape=shape[::-1], dtype=np.dtype(dtype).name) if suffix == "raw" else None
    image = read_image(path, grey=True, layout=layout)
    assert np.array_equal(image.values, values) and image.values.dtype == dtype
    assert image.spacing == (None if suffix in ("npy", "raw") else pytest.approx(spacing, rel=1e-6))


@pytest.mark.slow
def test_the_picture_is_refused_and_replaced_as_the_image_is(tmp_path):
    np.save(tmp_path / "a.npy", BLOCK)
    (tmp_path / "b_slices.png").write_text("mine")
    with pytest.raises(VoxelError, match=r"b_slices.png: exists; .*--force"):
        convert(tmp_path / "a.npy", tmp_path / "b.npy", picture=True)
    assert not (tmp_path / "b.npy").exists() and (tmp_path / "b_slices.png").read_text() == "mine"
    found = convert(tmp_path / "a.npy", tmp_path / "b.npy", picture=True, force=True)
    assert Path(found["picture"]).read_bytes().startswith(b"\x89PNG") and found["picture"].endswith("b_slices.png")


def test_an_image_without_a_solid_voxel_is_warned_of(tmp_path):
    np.save(tmp_path / "a.npy", BLOCK * 255)
    found = convert(tmp_path / "a.npy", tmp_path / "b.npy")
    assert found["porosity"] == 1
    assert "no voxel is solid (--solid 1): it holds 0 (15 voxels), 255" in found["warnings"][0]
    assert convert(tmp_path / "a.npy", tmp_path / "c.npy", Conversion(solid=255))["warnings"] == ()


@pytest.mark.slow
@pytest.mark.parametrize("suffix, options", [
    (".raw", {"threshold": 120.0}), (".npz", {"threshold": (80.0, 160.0), "invert": True}),
    (".mhd", {"threshold": 120.0, "downsample": 2}), (".mha", {"labels": {3: 1, 200: 7}, "solid": (1, 7)}),
    (".npy", {"crop_to": ((3, 19), (0, 15), (2, 22)), "threshold": 100.0}),
    (".npy", {"solid": (3, 9), "downsample": 3}),
])  # fmt: skip
def test_slabs_give_what_the_whole_gives(tmp_path, monkeypatch, suffix, options):
    """File and report, of an image of 24 layers in slabs of two to six."""
    grey = "threshold" in options
    rng = np.random.default_rng(5)
    size = (24, 15, 20)
    values = rng.integers(0, 256, size) if grey else rng.choice([0, 3, 9, 200], size, p=[0.5, 0.3, 0.1, 0.1])
    np.save(tmp_path / "scan.npy", values.astype(np.uint8))
    how = Conversion(voxel_size=2e-6, **options)
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    layout = Layout()
    whole = convert(tmp_path / "scan.npy", tmp_path / "whole" / f"rock{suffix}", how, picture=True)
    monkeypatch.setattr("isphcli.output.convert_images.LARGE", 1)
    monkeypatch.setattr("isphcli.output.convert_images.SLAB", 1000)
    target = tmp_path / "parts" / f"rock{suffix}"
    assert slab_shape(tmp_path / "scan.npy", target, how) is not None
    parts = convert(tmp_path / "scan.npy", target, how, picture=True)
    for key, name in (("file", f"rock{suffix}"), ("picture", "rock_slices.png")):
        assert Path(whole.pop(key)).name == Path(parts.pop(key)).name == name
    assert whole == parts
    if suffix == ".raw":
        layout = Layout(shape=tuple(whole["shape"].values()))
    a, b = (read_image(tmp_path / name / f"rock{suffix}", layout=layout) for name in ("whole", "parts"))
    assert np.array_equal(a.values, b.values) and a.spacing == b.spacing
    assert (tmp_path / "whole/rock_slices.png").read_bytes() == (tmp_path / "parts/rock_slices.png").read_bytes()


def test_what_needs_all_of_an_image_is_not_done_by_slabs(tmp_path, monkeypatch):
    monkeypatch.setattr("isphcli.output.convert_images.LARGE", 1)
    np.save(tmp_path / "scan.npy", np.zeros((4, 4, 4), np.uint8))
    for options in ({"threshold": "otsu"}, {"trim": True}, {"mirror": ("x",)}, {"connected": "x"}):
        assert slab_shape(tmp_path / "scan.npy", tmp_path / "rock.raw", Conversion(**options)) is None
    assert slab_shape(tmp_path / "scan.npy", tmp_path / "rock.tif", Conversion()) is None
    assert slab_shape(tmp_path / "scan.npy", tmp_path / "rock.raw", Conversion()) == (4, 4, 4)


def test_a_part_that_fails_leaves_nothing(tmp_path, monkeypatch):
    """Labels that are not there are said before anything is written."""
    monkeypatch.setattr("isphcli.output.convert_images.LARGE", 1)
    np.save(tmp_path / "scan.npy", np.zeros((4, 4, 4), np.uint8))
    with pytest.raises(VoxelError, match="no voxel has the value"):
        convert(tmp_path / "scan.npy", tmp_path / "rock.raw", Conversion(labels={5: 1}))
    assert [path.name for path in tmp_path.iterdir()] == ["scan.npy"]
