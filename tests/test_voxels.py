"""Images: reading and writing, bad input, conversion; and the geometry of voxel images."""

import errno
import io
import itertools
import os
import re
import tracemalloc
import zipfile
import zlib
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.domain.lattice import ParticleError
from isphcli.geometry.images.image import VoxelError
from isphcli.geometry.images.read import image_shape, read_image
from isphcli.geometry.labels import apply_labels, faces_that_differ
from isphcli.geometry.voxel_geometry import VoxelGeometry
from isphcli.geometry.wall_distance import nearest_centre, wall_field
from isphcli.output.convert_images import convert, write_image
from isphcli.scene import memory
from isphcli.scene.build_geometry import build_geometry


def rock(shape=(5, 6, 7), porosity=0.6, seed=0):
    """Random labels, 0 fluid and -1 solid."""
    return np.where(np.random.default_rng(seed).random(shape) < porosity, 0, -1).astype(np.int8)


def header(**changes):
    lines = {
        "NDims": "3",
        "DimSize": "4 3 2",
        "ElementType": "MET_UCHAR",
        "ElementSpacing": "1 2 3",
        **changes,
        "ElementDataFile": changes.get("ElementDataFile", "LOCAL"),
    }
    return "".join(f"{k} = {v}\n" for k, v in lines.items()).encode()


# reading and writing


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".mhd", ".mha"])
@pytest.mark.parametrize("shape", [(5, 6, 7), (6, 7)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32])
def test_round_trip(tmp_path, suffix, shape, dtype):
    values = np.random.default_rng(0).integers(0, 100, shape).astype(dtype)
    spacing = (1e-6, 2e-6, 3.5e-6)[: len(shape)]
    write_image(tmp_path / f"a{suffix}", values, spacing)
    image = read_image(tmp_path / f"a{suffix}")
    assert np.array_equal(image.values, values) and image.values.dtype == np.uint8
    assert image.spacing == (None if suffix == ".npy" else spacing)


def test_npy_in_fortran_order_and_bool(tmp_path):
    values = np.random.default_rng(0).random((3, 4, 5)) < 0.5
    np.save(tmp_path / "a.npy", np.asfortranarray(values))
    assert np.array_equal(read_image(tmp_path / "a.npy").values, values)


def test_npz_with_several_arrays_wants_a_name(tmp_path):
    np.savez(tmp_path / "a.npz", rock=np.ones((2, 2), int), grey=np.zeros((3, 3), int))
    with pytest.raises(VoxelError, match=r"rock.*grey"):
        read_image(tmp_path / "a.npz")
    with pytest.raises(VoxelError, match="there is no 'x'"):
        read_image(tmp_path / "a.npz", array="x")
    assert read_image(tmp_path / "a.npz", array="grey").values.shape == (3, 3)


def test_metaimage_big_endian_skipped_bytes_and_zlib(tmp_path):
    values = np.arange(24, dtype=np.uint16).reshape(2, 3, 4) * 300
    (tmp_path / "d.raw").write_bytes(b"skip" + values.astype(">u2").tobytes())
    meta = header(
        ElementType="MET_USHORT", BinaryDataByteOrderMSB="True", HeaderSize="4", ElementDataFile="d.raw"
    )
    (tmp_path / "a.mhd").write_bytes(meta)
    image = read_image(tmp_path / "a.mhd")
    assert np.array_equal(image.values, values) and image.spacing == (1, 2, 3)
    (tmp_path / "a.mhd").write_bytes(meta.replace(b"= 4\n", b"= -1\n"))
    assert np.array_equal(read_image(tmp_path / "a.mhd").values, values)
    packed = zlib.compress(values.astype("u1").tobytes())
    (tmp_path / "b.mha").write_bytes(header(CompressedData="True") + packed)
    assert np.array_equal(read_image(tmp_path / "b.mha").values, values.astype("u1"))


# bad input


@pytest.mark.parametrize(
    "array, message",
    [
        (np.zeros((3, 3)), "float64"),
        (np.full((3, 3), np.nan), "NaN"),
        (-np.ones((3, 3), int), "negative"),
        (np.zeros((0, 3), int), "empty"),
        (np.zeros(5, int), "dimensions"),
        (np.zeros((2, 2, 2, 2), int), "dimensions"),
        (np.array([["a", "b"]]), "type"),
        (np.array([[1, None]], dtype=object), "type object"),
        (np.zeros((2, 2), complex), "type complex"),
    ],
)
def test_arrays_that_are_no_labels(tmp_path, array, message):
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    np.savez(tmp_path / "a.npz", array)
    for name in ("a.npy", "a.npz"):
        with pytest.raises(VoxelError, match=message) as error:
            read_image(tmp_path / name)
        assert name in str(error.value)


def test_truncated_long_and_huge_npy(tmp_path):
    buffer = io.BytesIO()
    np.save(buffer, np.ones((8, 8), np.uint8))
    data = buffer.getvalue()
    for text, message in [(data[:-1], "truncated"), (data + b"0", "header says"), (data[:20], "not an npy")]:
        (tmp_path / "a.npy").write_bytes(text)
        with pytest.raises(VoxelError, match=message):
            read_image(tmp_path / "a.npy")
    for shape in (b"(99999999, 9999999)", b"(9999999, 9)", b"(-1, -5)"):
        (tmp_path / "a.npy").write_bytes(
            data.replace(b"(8, 8), }" + b" " * (len(shape) - 6), shape + b", }", 1)
        )
        with pytest.raises(VoxelError, match=r"memory|truncated|negative"):
            read_image(tmp_path / "a.npy")


def test_damaged_archives(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", np.arange(1000).reshape(10, 100) % 251)
    data = bytearray((tmp_path / "a.npz").read_bytes())
    for cut in (b"", data[: len(data) // 2], data[:60] + b"0000" + data[64:]):
        (tmp_path / "b.npz").write_bytes(cut)
        with pytest.raises(VoxelError, match=r"archive|damaged|npy"):
            read_image(tmp_path / "b.npz")
    with zipfile.ZipFile(tmp_path / "c.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("x.npy", b"0" * 1000)
    with pytest.raises(VoxelError, match="compressed"):
        read_image(tmp_path / "c.npz")


@pytest.mark.parametrize(
    "text, message",
    [
        (header() + b"0" * 23, "truncated"),
        (header() + b"0" * 25, "holds 25 bytes"),
        (header(DimSize="4 3") + b"0" * 24, "NDims"),
        (header(DimSize="4 x 3"), "DimSize"),
        (header(DimSize="-4 3 2"), "negative"),
        (header(DimSize="0 3 2"), "empty"),
        (header(DimSize="99999 99999 99999"), "memory"),
        (header(ElementType="MET_OTHER"), "ElementType"),
        (header(ElementType="MET_FLOAT") + b"0" * 96, "float32"),
        (header(ElementSpacing="1 0 1") + b"0" * 24, "voxel size"),
        (header(ElementSpacing="nan 1 1") + b"0" * 24, "voxel size"),
        (header(ElementDataFile="none.raw"), "does not exist"),
        (header(ElementDataFile="LIST"), "one file"),
        (header(BinaryData="False"), "text data"),
        (header(ElementNumberOfChannels="3"), "channels"),
        (header(CompressedData="True") + b"0" * 24, "damaged"),
        (header(CompressedData="True") + zlib.compress(b"0" * 23), "truncated"),
        (header(CompressedData="True", DimSize="999 999 99") + b"0" * 24, "truncated"),
        (b"NDims = 3\n", "ElementDataFile"),
        (b"\0\1\2", "not a MetaImage"),
        (b"", "not a MetaImage"),
    ],
)
def test_bad_metaimages(tmp_path, text, message):
    (tmp_path / "a.mha").write_bytes(text)
    with pytest.raises(VoxelError, match=message):
        read_image(tmp_path / "a.mha")


def test_missing_files_and_unknown_suffixes(tmp_path):
    (tmp_path / "a.tif").write_bytes(b"")
    for name, message in [("none.npy", "no such file"), ("a.tif", "tif"), (".", "no such file")]:
        with pytest.raises(VoxelError, match=message):
            read_image(tmp_path / name)


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from([".npy", ".npz", ".mhd", ".mha"]),
    st.one_of(
        st.binary(max_size=300),
        st.binary(max_size=60).map(lambda b: b"\x93NUMPY\x01\x00" + b),
        st.binary(max_size=60).map(lambda b: header() + b),
        st.dictionaries(
            st.sampled_from(
                ["DimSize", "NDims", "ElementType", "CompressedData", "HeaderSize", "ElementSpacing"]
            ),
            st.one_of(
                st.text(max_size=20),
                st.lists(st.integers(-3, 10**12), max_size=4).map(lambda v: " ".join(map(str, v))),
                st.sampled_from(["True", "MET_SHORT", "MET_DOUBLE"]),
            ),
        ).map(
            lambda changes: header(
                **{k: v.encode("utf8", "ignore").decode("latin-1") for k, v in changes.items()}
            )
        ),
        st.text(max_size=60).map(
            lambda t: (
                (h := f"{{'descr': '|u1', 'fortran_order': False, 'shape': {t}}}\n".encode())
                and b"\x93NUMPY\x01\x00" + len(h).to_bytes(2, "little") + h
            )
        ),
    ),
)
def test_any_bytes_give_an_image_or_a_clean_error(tmp_path_factory, suffix, data):
    path = tmp_path_factory.mktemp("bytes") / f"a{suffix}"
    path.write_bytes(data)
    tracemalloc.start()
    try:
        image = read_image(path)
        assert image.values.size and image.values.dtype.kind == "u"
    except VoxelError as error:
        assert path.name in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 5e6


# labels and conversion


def test_labels_become_phases():
    values = np.array([[0, 1, 2], [3, 1, 0]], np.uint8)
    labels = {"solid": (1, 3), "brine": (0,), "co2": 2}
    assert apply_labels(values, labels, ("co2", "brine")).tolist() == [[1, -1, 0], [-1, -1, 1]]
    with pytest.raises(VoxelError, match=r"\[3\] have no label"):
        apply_labels(values, {**labels, "solid": 1}, ("co2", "brine"))
    with pytest.raises(VoxelError, match="'co2' \\[7\\]"):
        apply_labels(values, {"solid": (1, 2, 3), "brine": 0, "co2": 7}, ("co2", "brine"))
    with pytest.raises(VoxelError, match="'oil'"):
        apply_labels(values, {**labels, "oil": 5}, ("co2", "brine"))


def test_convert_grey_values(tmp_path):
    grey = np.array([[-5, 100, 200], [99, 101, 300]], np.int16)[None].repeat(4, 0)
    np.save(tmp_path / "g.npy", grey)
    found = convert(tmp_path / "g.npy", tmp_path / "o.mhd", threshold=100, voxel_size=2e-6)
    assert read_image(tmp_path / "o.mhd").values[0].tolist() == [[0, 1, 1], [0, 1, 1]]
    assert found["threshold"] == "grey >= 100 is solid" and found["porosity"] == pytest.approx(1 / 3)
    assert found["percolates"] == {"x": False, "y": True, "z": True} and found["labels"] == {0: 8, 1: 16}
    assert found["voxel_size"] == (2e-6,) * 3 and found["shape"] == {"x": 3, "y": 2, "z": 4}
    found = convert(
        tmp_path / "g.npy", tmp_path / "o.npz", threshold=100, invert=True, crop_to=((1, 3), (0, 2), (0, 1))
    )
    assert found["porosity"] == 1 and found["threshold"] == "grey < 100 is solid"


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
    found = convert(tmp_path / "a.npy", tmp_path / "b.npz", labels={255: 1}, downsample=2, voxel_size=1.0)
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
        convert(tmp_path / "a.npy", tmp_path / "b.npy", **options)
    with pytest.raises(VoxelError, match="not written"):
        convert(tmp_path / "a.npy", tmp_path / "b.tif")


# distance


@pytest.mark.parametrize("voxel", [(1, 1, 1), (1, 1.5, 0.7)])
@pytest.mark.parametrize("around", list(itertools.product([True, False], repeat=3)))
def test_distance_transform_against_brute_force(voxel, around):
    target = rock(porosity=0.85) < 0
    found = nearest_centre(target, np.array(voxel, float), np.array(around))
    centres = np.argwhere(np.ones_like(target))
    shifts = [(-1, 0, 1) if a else (0,) for a in around]  # x, y, z
    sources = np.concatenate(
        [np.argwhere(target) + np.array(s[::-1]) * target.shape for s in itertools.product(*shifts)]
    )
    offset = centres[:, None] - sources[None]
    squares = ((offset * np.array(voxel)[::-1]) ** 2).sum(2)
    exact = np.sqrt(squares.min(1))
    if len(set(voxel)) == 1:
        assert np.abs(found.ravel() - np.maximum(exact - 0.5, 0)).max() < 1e-6
    else:  # half a voxel in the direction of the nearest centre, one of them where several are as near
        half = np.where(squares == squares.min(1)[:, None], np.sqrt((offset**2).sum(2)), np.nan)
        low, high = (exact * (1 - 0.5 / np.maximum(f(half, 1), 0.5)) for f in (np.nanmin, np.nanmax))
        assert ((found.ravel() > low - 1e-6) & (found.ravel() < high + 1e-6)).all()


@pytest.mark.parametrize("kind", ["smooth", "stairs"])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("width", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("scale", [1.0, 2.0**-20])
def test_slits_along_the_axes_are_exact_at_centres(kind, axis, width, scale):
    """Slits and walls of any width, also one voxel: distances at the centres to round-off."""
    h = np.array([1.0, 1.0, 1.0]) * scale
    labels = np.full((16, 16, 16), -1, np.int8)
    np.moveaxis(labels, 2 - axis, 0)[5 : 5 + width] = 0
    centres = (np.arange(3, 7 + width) + 0.5) * scale
    x = np.full((len(centres), 3), 3.5 * scale)
    x[:, axis] = centres
    exact = np.minimum(centres - 5 * scale, (5 + width) * scale - centres)
    for phases, sign in ((labels, 1), (-1 - labels, -1)):
        d = VoxelGeometry(phases, h, (True,) * 3, kind).distance(x)
        near = np.abs(exact) < 1.5 * scale if kind == "stairs" else slice(None)
        assert np.abs(d - sign * exact)[near].max() < 1e-12 * scale


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("thick", [1, 2, 3, 5])
@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("inverse", [False, True])
def test_layers_at_a_sealed_face_are_exact_at_centres(axis, thick, side, inverse):
    """A layer of any thickness next to a face that is not periodic; faces themselves are added exactly."""
    inside = np.zeros(12)
    inside[:thick] = -1
    exact = thick - (np.arange(12) + 0.5)
    if side:
        inside, exact = inside[::-1], exact[::-1]
    labels, exact = (-1 - inside, exact) if inverse else (inside, -exact)
    grid = np.empty((12, 12, 12), np.int8)
    np.moveaxis(grid, 2 - axis, 2)[:] = labels
    around = np.array([a != axis for a in range(3)])
    for faces in (around, np.zeros(3, bool)):
        found = np.moveaxis(wall_field(grid, np.ones(3), faces), 2 - axis, 2)
        assert np.abs(found - exact).max() < 1e-6


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_planes_between_anisotropic_voxels(axis):
    h = np.array([1.0, 1.7, 0.6])
    labels = np.zeros((12, 12, 12), np.int8)
    np.moveaxis(labels, 2 - axis, 0)[6:] = -1
    g = VoxelGeometry(labels, h, (True,) * 3)
    x = np.random.default_rng(0).uniform(4, 8, (200, 3)) * h
    assert np.abs(g.distance(x) - (6 * h[axis] - x[:, axis])).max() < 1e-6


def test_faces_are_exact_planes():
    """An empty image in sealed sides: distances, crossings and walls as of the box."""
    g = VoxelGeometry(
        np.zeros((4, 5, 6), np.int8), 0.5, (True, False, False), face_velocity={(1, 1): (1, 0, 0)}
    )
    rng = np.random.default_rng(0)
    x = rng.uniform([0, 0, 0], [3, 2.5, 2], (300, 3))
    d = np.minimum.reduce([x[:, 1], 2.5 - x[:, 1], x[:, 2], 2 - x[:, 2]])
    assert np.abs(g.distance(x) - d).max() < 1e-14
    out = x + [0, 2.5, 0]
    assert np.allclose(g.distance(out), -x[:, 1], atol=1e-14) and (g.phase(out) == -1).all()
    t = g.crossing(x, out)
    assert np.abs(x[:, 1] + t * 2.5 - 2.5).max() < 1e-13
    met = x + t[:, None] * (out - x)
    assert np.mean(g.wall_velocity[g.wall(met)][:, 0]) > 0.99


def sphere(n, radius, centre):
    z, y, x = np.indices((n,) * 3) + 0.5
    return np.where(np.hypot(np.hypot(x - centre[0], y - centre[1]), z - centre[2]) > radius, 0, -1)


def test_smooth_distance_of_a_sphere():
    """rms within two voxels of the wall: 0.12 voxels smooth, 0.18 plain; the mean error stays below 0.03."""
    centre, radius, h = np.array([12.3, 11.8, 12.1]), 8.2, 3e-6
    labels = sphere(24, radius, centre)
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 24, (50000, 3))
    true = np.linalg.norm(x - centre, axis=1) - radius
    x, true = x[np.abs(true) < 2], true[np.abs(true) < 2]
    g = VoxelGeometry(labels, h, (True,) * 3)
    error = g.distance(x * h) / h - true
    assert np.sqrt((error**2).mean()) < 0.135 and abs(error.mean()) < 0.03
    g._field = wall_field(g._grid, g._voxel, g._around, "stairs")
    assert np.sqrt(((g.distance(x * h) / h - true) ** 2).mean()) > 0.16
    assert np.array_equal(g.distance(x * h) > 0, g.phase(x * h) >= 0)


@pytest.mark.parametrize("kind", ["smooth", "stairs"])
@pytest.mark.parametrize("shape", [(5, 6, 7), (8, 9)])
def test_signs_agree_with_the_labels_anywhere(kind, shape):
    dim = len(shape)
    rng = np.random.default_rng(1)
    x = rng.uniform(-2, 11, (3000, dim))
    for periodic in itertools.product([True, False], repeat=dim):
        g = VoxelGeometry(rock(shape), 1.0, periodic, kind)
        phase = g.phase(x)
        assert np.array_equal(g.distance(x) > 0, phase >= 0)
        inside = ((x >= 0) & (x < shape[::-1]) | np.array(periodic)).all(1)
        index = np.floor(x).astype(int) % shape[::-1]
        assert np.array_equal(phase, np.where(inside, g.labels[tuple(index.T[::-1])], -1))


def test_stairs_distance_is_exact_within_a_voxel():
    labels = rock((6, 6, 6), 0.75, seed=3)
    g = VoxelGeometry(labels, 1.0, (True,) * 3, "stairs")
    x = np.random.default_rng(2).uniform(0, 6, (500, 3))
    every = np.argwhere(np.tile(labels < 0, (3, 3, 3)))[:, ::-1] - 6
    free = np.argwhere(np.tile(labels >= 0, (3, 3, 3)))[:, ::-1] - 6
    to = [
        np.linalg.norm(np.maximum(np.maximum(v[None] - x[:, None], x[:, None] - v[None] - 1), 0), axis=2).min(
            1
        )
        for v in (every, free)
    ]
    exact = np.where(g.phase(x) >= 0, to[0], -to[1])
    near = np.abs(exact) < 1
    assert near.mean() > 0.9 and np.abs(g.distance(x) - exact)[near].max() < 1e-12


def test_no_wall_and_only_wall():
    x = np.random.default_rng(0).uniform(0, 4, (10, 3))
    free = VoxelGeometry(np.zeros((4, 4, 4), np.int8), 1.0, (True,) * 3)
    assert not free.has_solid and np.isposinf(free.distance(x)).all() and (free.crossing(x, x + 1) == 1).all()
    full = VoxelGeometry(np.full((4, 4, 4), -1, np.int8), 1.0, (True,) * 3)
    assert full.has_solid and np.isneginf(full.distance(x)).all() and (full.phase(x) == -1).all()


# crossings


@pytest.mark.parametrize("shape", [(6, 6, 6), (6, 7)])
@pytest.mark.parametrize("scale", [1.0, 3e-6])
def test_march_against_samples(shape, scale):
    rng = np.random.default_rng(5)
    dim = len(shape)
    for periodic in [(True,) * dim, (False,) * dim]:
        g = VoxelGeometry(rock(shape, 0.75), scale, periodic, "stairs")
        xi = rng.uniform(0, 6, (400, dim)) * scale
        xi = xi[g.phase(xi) >= 0]
        xj = xi + rng.uniform(-2.4, 2.4, xi.shape) * scale
        t = np.linspace(0, 1, 4001)[1:]
        solid = (
            g.phase((xi[:, None] + t[:, None] * (xj - xi)[:, None]).reshape(-1, dim)).reshape(len(xi), -1) < 0
        )
        sampled = np.where(solid.any(1), t[solid.argmax(1)], 1.0)
        assert np.abs(g.crossing(xi, xj) - sampled).max() < 3e-4


@pytest.mark.parametrize("kind", ["smooth", "stairs"])
@pytest.mark.parametrize("scale", [1.0, 3e-6, 1e5 / 3])
def test_diagonals_of_the_lattice(kind, scale):
    """Centre to centre through an edge: blocked where both neighbours are solid, open where one is fluid."""
    labels = np.zeros((4, 4), np.int8)
    xi, xj = np.array([[1.5, 1.5]]) * scale, np.array([[2.5, 2.5]]) * scale
    labels[1, 2] = -1
    assert VoxelGeometry(labels, scale, (True, True), kind).crossing(xi, xj)[0] == 1
    labels[2, 1] = -1
    assert VoxelGeometry(labels, scale, (True, True), kind).crossing(xi, xj)[0] == pytest.approx(0.5)
    far = VoxelGeometry(labels, scale, (True, True), kind).crossing(xi + 400 * scale, xj + 400 * scale)
    assert far[0] == pytest.approx(0.5)


@pytest.mark.parametrize("kind", ["smooth", "stairs"])
def test_corners_of_three_voxels(kind):
    """Along a space diagonal: open as long as a way over faces of fluid voxels is left."""
    xi, xj = np.array([[1.5] * 3]), np.array([[2.5] * 3])
    for around in itertools.product([0, -1], repeat=6):
        labels = np.zeros((4, 4, 4), np.int8)
        places = [p for p in itertools.product([1, 2], repeat=3) if p not in ((1, 1, 1), (2, 2, 2))]
        for place, phase in zip(places, around):
            labels[place] = phase
        ways = any(
            all(labels[tuple(1 + int(axis in order[:k]) for axis in range(3))] == 0 for k in (1, 2))
            for order in itertools.permutations(range(3))
        )
        t = VoxelGeometry(labels, 1.0, (True,) * 3, kind).crossing(xi, xj)[0]
        assert (t == 1) == ways


@pytest.mark.parametrize("kind", ["smooth", "stairs"])
def test_walls_and_throats_of_one_voxel_are_seen(kind):
    labels = np.zeros((8, 8, 8), np.int8)
    labels[:, :, 4] = -1
    labels[3, 3, 4] = 0  # the throat
    g = VoxelGeometry(labels, 1e-6, (True,) * 3, kind)
    xi = np.array([[3.5, 6.5, 6.5], [3.5, 3.5, 3.5]]) * 1e-6
    t = g.crossing(xi, xi + np.array([2e-6, 0, 0]))
    assert t[0] == pytest.approx(0.25) and t[1] == 1
    assert g.distance(np.array([[4.5, 3.5, 3.5]]) * 1e-6)[0] == pytest.approx(0.5e-6)


def test_smooth_crossings_lie_on_the_smooth_wall():
    """Through a voxelised sphere, at lattice points: |distance| at the crossing, and to the true wall."""
    centre, radius = np.array([12.3, 11.8, 12.1]), 8.2
    g = VoxelGeometry(sphere(24, radius, centre), 1.0, (True,) * 3)
    x = np.indices((24,) * 3).reshape(3, -1).T + 0.5
    step = np.random.default_rng(0).integers(-2, 3, x.shape)
    keep = (g.phase(x) == 0) & (g.phase(x + step) == -1)
    x, step = x[keep], step[keep]
    met = x + g.crossing(x, x + step)[:, None] * step
    assert np.abs(g.distance(met)).max() < 0.05 + 1e-6  # the labels move the sign by 0.05 voxels
    error = np.sqrt(np.mean((np.linalg.norm(met - centre, axis=1) - radius) ** 2))
    g._field = wall_field(g._grid, g._voxel, g._around, "stairs")
    met = x + g.crossing(x, x + step)[:, None] * step
    plain = np.sqrt(np.mean((np.linalg.norm(met - centre, axis=1) - radius) ** 2))
    assert error < 0.19 and error < 0.75 * plain, (error, plain)


def test_clear_layers():
    labels = np.full((5, 4, 3), -1, np.int8)
    g = VoxelGeometry(labels, (1.0, 2.0, 3.0), (False, False, False), flow_axis=1, clear=2)
    assert g.upper.tolist() == [3, 16, 15] and g.periodic == (False, True, False)
    assert g.sample_lower.tolist() == [0, 4, 0] and g.sample_upper.tolist() == [3, 12, 15]
    x = np.array([[1.5, 1, 7], [1.5, 5, 7], [1.5, 15, 7], [1.5, 17, 7], [-0.1, 1, 7]])
    assert g.phase(x).tolist() == [0, -1, 0, 0, -1]


@pytest.mark.parametrize(
    "change",
    [
        {"labels": np.zeros((0, 2), np.int8)},
        {"voxel_size": 0},
        {"voxel_size": np.nan},
        {"wall_distance": "exact"},
        {"periodic": (True,)},
    ],
)
def test_bad_arguments(change):
    with pytest.raises(ValueError):
        VoxelGeometry(
            **({"labels": np.zeros((2, 2), np.int8), "voxel_size": 1.0, "periodic": (True, True)} | change)
        )


# from a case


def read(tmp_path, scene):
    from isphcli.case.load import read_case

    text = f"""
geometry: {scene}
particles: {{spacing: 0.1}}
fluids: {{brine: {{density: 1000, viscosity: 1.0e-3}}, co2: {{density: 500, viscosity: 1.0e-4}}}}
drive: {{body_force: [0, 1, 0]}}
time: {{end: 1}}
"""
    return read_case(text.encode(), tmp_path / "case.yaml")


def test_image_of_a_case(tmp_path):
    values = np.array([[[0, 1, 2]] * 4] * 5, np.uint8)
    np.save(tmp_path / "a.npy", values)
    scene = "{voxels: {file: a.npy, labels: {solid: 1, brine: 0, co2: 2}, voxel_size: 0.5}, periodic: [z]}"
    g = build_geometry(read(tmp_path, scene))
    assert g.periodic == (False, True, True) and g.upper.tolist() == [1.5, 8, 2.5]  # six clear voxels a side
    assert g.phase(np.array([[0.2, 4, 1], [0.7, 4, 1], [1.2, 4, 1], [0.7, 1, 1]])).tolist() == [0, -1, 1, 0]
    along_z = build_geometry(read(tmp_path, scene), axis=2)
    assert along_z.periodic == (False, False, True) and along_z.upper.tolist() == [1.5, 2, 2.5]


SPACING = "voxels: {file: FILE, labels: {solid: 1, brine: 0}SIZE}, periodic: [z]"


def scene_of(tmp_path, file, size=None, **values):
    """Geometry of an image that is solid in 3 of 4 layers along x."""
    image = np.ones((8, 8, 8), np.uint8)
    image[..., :2] = 0
    path = tmp_path / file
    if path.suffix in (".mhd", ".mha"):
        write_image(path, image, values.get("voxel_size"))
    elif path.suffix == ".npy":
        np.save(path, image)
    else:
        np.savez(path, image=image, **values)
    scene = SPACING.replace("FILE", file).replace("SIZE", "" if size is None else f", voxel_size: {size}")
    with mock.patch.object(memory, "available", lambda: None):  # voxels of metres are not to be refused by their number
        return build_geometry(read(tmp_path, "{" + scene + "}"))


def test_a_size_in_another_unit_is_named_where_it_is_refused(tmp_path):
    """voxel_size: 5, micrometres meant, beside a spacing that fits micrometres no better."""
    np.save(tmp_path / "a.npy", np.zeros((10, 10, 10), np.uint8))
    scene = SPACING.replace("FILE", "a.npy").replace("SIZE", ", voxel_size: 5")
    said = r"fluid particles need .* if micrometres are meant, the voxel size is 5e-06 m"
    with pytest.raises(ParticleError, match=said):
        build_geometry(read(tmp_path, "{" + scene + "}"))


@pytest.mark.parametrize(
    "file, of_file, given, size, source, warning",
    [
        ("a.npz", 5e-6, None, 5e-6, "from a.npz", None),
        ("a.npz", [1e-6, 2e-6, 3e-6], None, [1e-6, 2e-6, 3e-6], "from a.npz", None),
        ("a.npz", np.array([3]), 3, 3, "as given, as in a.npz", "voxels of 3 m"),
        ("a.npz", 3e-6, 5e-6, 5e-6, "as given; a.npz has 3e-06 m", "given, 5e-06 m, is not that of a.npz, 3e-06 m"),
        ("a.npz", 5e-3, 5e-6, 5e-6, "as given; a.npz has 0.005 m", "given, 5e-06 m, is not that of a.npz, 0.005 m"),
        ("a.npz", 5.0001e-6, 5e-6, 5e-6, "as given, as in a.npz", None),
        ("a.mha", [5e-6] * 3, None, 5e-6, "from a.mha, whose ElementSpacing has no unit: taken as metres", None),
        ("a.mhd", [5e-3] * 3, None, 5e-3, "from a.mhd, whose", "give the voxel size, 5e-06 m if it is in milli"),
        ("a.mhd", [5e-3] * 3, 5e-6, 5e-6, "as given, as in a.mhd if that is in millimetres", None),
        ("a.mhd", [5.0] * 3, 5e-6, 5e-6, "as given, as in a.mhd if that is in micrometres", None),
        ("a.mhd", [5.0] * 3, 4e-6, 4e-6, "as given; a.mhd has 5 (without", "is not that of a.mhd, 5 (without a unit)"),
        ("a.mhd", [1.0] * 3, 4e-6, 4e-6, "as given", None),
        ("a.npy", None, 4e-6, 4e-6, "as given", None),
    ],
)
def test_voxel_size_of_the_case_and_of_the_file(tmp_path, file, of_file, given, size, source, warning):
    held = {} if of_file is None else {"voxel_size": of_file}
    g = scene_of(tmp_path, file, given, **held)
    assert g.voxel_size.tolist() == np.broadcast_to(size, 3).tolist()
    assert source in dict(g.described)["voxel size"]
    about = [w for w in g.warnings if "voxel" in w]
    assert (warning is None and not about) or any(warning in w for w in about)


@pytest.mark.parametrize("file, held", [("a.npz", {}), ("a.mhd", {"voxel_size": [1.0] * 3}), ("a.mha", {})])
def test_no_voxel_size_anywhere(tmp_path, file, held):
    with pytest.raises(VoxelError, match=f"{file}: holds no voxel size; give geometry.voxels.voxel_size"):
        scene_of(tmp_path, file, None, **held)


def test_what_is_said_of_an_image(tmp_path):
    image = np.ones((4, 5, 6), np.uint8)
    image[:, :, 1:] = 0
    np.save(tmp_path / "a.npy", image)
    voxels = "{voxels: {file: a.npy, labels: {solid: [1], brine: 0}, voxel_size: 1e-6, AXES}}"
    g = build_geometry(read(tmp_path, voxels.replace("AXES", "axes: xyz, crop: [[0, 3], [0, 5], [0, 6]]")))
    said = dict(g.described)
    assert said["image"] == ("3 x 5 x 6 voxels along x, y, z, cropped from 4 x 5 x 6; a.npy is an array 4 x 5 x 6, "
                             "its axes taken as x, y, z")  # fmt: skip
    assert said["porosity"] == "83.33 % of the image's voxels (solid 1, brine 0)"
    assert g.warnings == ("porosity 83.3 %: more than rock has; check which values are solid (solid 1, brine 0; the "
                          "other way round it is 16.7 %)",)  # fmt: skip
    g = build_geometry(read(tmp_path, voxels.replace("AXES", "axes: zyx")))
    assert dict(g.described)["image"].startswith("6 x 5 x 4 voxels along x, y, z; a.npy is an array 4 x 5 x 6, its "
                                                 "axes taken as z, y, x")  # fmt: skip


def test_faces_that_do_not_match_are_told():
    """Layers that drift along x, and the same beside their mirror image; noise, whose layers never match."""
    rng = np.random.default_rng(0)
    drift = np.sin(np.arange(58) / 6 + 2 * np.pi * rng.random((30, 30))[..., None]) > 0  # [z, y, x]
    (said,) = faces_that_differ(drift, (True, False, False))
    across = 100 * (drift[..., 0] != drift[..., -1]).mean()
    assert f"the two faces across x differ in {across:.0f} % of their voxels" in said and across > 30
    assert faces_that_differ(drift, (False, True, True)) == ()
    assert faces_that_differ(np.concatenate([drift, drift[..., ::-1]], axis=2), (True, False, False)) == ()
    assert faces_that_differ(rng.random((20, 20, 20)) < 0.5, (True,) * 3) == ()
    assert faces_that_differ(drift[:, 0].T, (False, True)) != ()  # 2D [y, x]


COLOURS = np.random.default_rng(0).integers(0, 256, (40, 50, 3)).astype(np.uint8)
GREY = np.repeat((COLOURS[..., :1] > 90) * np.uint8(255), 3, axis=2)


@pytest.mark.parametrize(
    "values, fix",
    [
        (COLOURS, "mean"),
        (GREY, r"image\[..., 0\]"),
        (np.dstack([GREY, np.full(GREY.shape[:2], 255, np.uint8)]), r"image\[..., 0\]"),
        (np.dstack([COLOURS > 90, np.ones(GREY.shape[:2])]).astype(np.uint8), "mean"),
        (COLOURS / 255, "mean"),
        (np.stack([COLOURS] * 5), "mean"),
    ],
)
def test_pictures_in_colours_are_refused(tmp_path, values, fix):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(VoxelError, match=f"a.npy: looks like a picture in colours, [34] channels.*{fix}"):
        read_image(tmp_path / "a.npy", grey=True)


@pytest.mark.parametrize(
    "values, axis",
    [
        (GREY > 0, "last axis of the array has 3 entries"),
        (GREY[..., :1], "last axis of the array has 1 entry"),
        (GREY[..., :2], "last axis of the array has 2 entries"),
        (np.moveaxis(GREY, 2, 0), "first axis of the array has 3 entries"),
        (np.moveaxis(GREY, 2, 0)[:1], None),  # [1, y, x] is 2D
        (GREY[..., 0], None),
        (GREY[:12, :12], None),
        (GREY[:, :3], None),
    ],
)
def test_a_thin_axis_may_be_colours(tmp_path, values, axis):
    np.save(tmp_path / "a.npy", values)
    said = read_image(tmp_path / "a.npy").warnings
    assert (axis is None and said == ()) or (len(said) == 1 and axis in said[0])


def test_a_conversion_says_where_the_voxel_size_is_from(tmp_path):
    np.savez(tmp_path / "a.npz", image=rock() + 1, voxel_size=2e-6)
    found = convert(tmp_path / "a.npz", tmp_path / "b.npz")
    assert found["voxel_size"] == (2e-6,) * 3 and found["voxel_size_from"] == "from a.npz" and found["warnings"] == ()
    found = convert(tmp_path / "a.npz", tmp_path / "c.npz", voxel_size=(1e-6, 2e-6, 3e-6))
    assert found["voxel_size"] == (1e-6, 2e-6, 3e-6)
    assert "given, 1e-06 x 2e-06 x 3e-06 m, is not that" in found["warnings"][0]
    write_image(tmp_path / "d.mhd", rock() + 1, (1.0, 1.0, 1.0))
    assert convert(tmp_path / "d.mhd", tmp_path / "e.npz")["voxel_size"] is None


def test_shapes_of_a_case(tmp_path):
    (tmp_path / "b.csv").write_text("x,y,z\n0.5,0.5,0.5\n")
    scene = """
  box: [1, 1, 1]
  origin: [0, 0, 0.25]
  periodic: [x, y]
  slip_length: 0.01
  walls: {z_max: {velocity: [1, 0, 0]}}
  shapes:
    - {spheres: {file: b.csv, radius: 0.1}, is: solid}
    - {cylinder: {axis: x, radius: 0.4}, outside: true, is: co2}
    - {box: {lower: [0, 0, 0], upper: [1, 0.1, 2]}, is: solid, slip_length: 0.1}"""
    g = build_geometry(read(tmp_path, scene))
    assert g.lower.tolist() == [0, 0, 0.25] and g.periodic == (True, True, False)
    x = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.75], [0.1, 0.15, 0.3], [0.1, 0.05, 0.6], [0.1, 0.5, 1.24]])
    assert g.phase(x).tolist() == [-1, 0, 1, -1, 1]
    assert g.wall_velocity[g.wall(x[4:])].tolist() == [[1, 0, 0]]
    assert g.slip_length[g.wall(x[3:])].tolist() == [0.1, 0.01]


@pytest.mark.parametrize("suffix", ["npy", "npz", "mhd", "mha"])
def test_the_header_tells_the_shape(tmp_path, suffix):
    path = tmp_path / f"image.{suffix}"
    write_image(path, np.zeros((3, 4, 5), np.uint8), (1.0, 1.0, 1.0))
    assert image_shape(path) == (3, 4, 5)
    path.write_bytes(b"nothing of the kind")
    assert image_shape(path) is None and image_shape(tmp_path / "absent.npy") is None
