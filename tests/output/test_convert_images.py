"""`isph convert-voxels`: values, sizes, and the files that it may replace."""

import errno
import os
import re
from pathlib import Path

import numpy as np
import pytest

from isphcli.geometry.images.image import VoxelError
from isphcli.geometry.images.read import read_image
from isphcli.output.convert_images import Conversion, convert, write_image
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
        ({"crop_to": ((0, 2),)}, "one an axis"),
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
