"""Images: every format reads back what was written; what is damaged is named and refused."""

import io
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.geometry.images.image import VoxelError
from isphcli.geometry.images.read import image_shape, read_image
from isphcli.output.convert_images import write_image


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
        (header(DimSize="99999 99999 99999"), "truncated"),
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
    (tmp_path / "a.jpg").write_bytes(b"")
    for name, message in [("none.npy", "no such file"), ("a.jpg", "jpg"), (".", "folder without slices")]:
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


@pytest.mark.parametrize("suffix", ["npy", "npz", "mhd", "mha"])
def test_the_header_tells_the_shape(tmp_path, suffix):
    path = tmp_path / f"image.{suffix}"
    write_image(path, np.zeros((3, 4, 5), np.uint8), (1.0, 1.0, 1.0))
    assert image_shape(path) == (3, 4, 5)
    path.write_bytes(b"nothing of the kind")
    assert image_shape(path) is None and image_shape(tmp_path / "absent.npy") is None
