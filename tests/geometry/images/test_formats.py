"""Every format: what was written by a library of the field is read back, whole and in part; damage is refused."""

import base64
import bz2
import gzip
import struct
import sys
import zlib

import numpy as np
import pytest

from isphcli.geometry.images.image import Layout, VoxelError
from isphcli.geometry.images.read import FORMATS, image_shape, read_image

VALUES = np.random.default_rng(0).integers(0, 200, (6, 7, 9)).astype(np.uint8)
CROP = ((2, 7), (1, 6), (3, 5))  # along x, y, z


def tiff(path, values, **options):
    import tifffile

    tifffile.imwrite(path, values, **options)


def pictures(folder, values, suffix):
    from PIL import Image

    folder.mkdir()
    for k, one in enumerate(values):
        Image.fromarray(one).save(folder / f"slice_{k + 8}.{suffix}")  # 8, 9, 10: not the order of the letters


def tiff_slices(folder, values):
    folder.mkdir()
    for k, one in enumerate(values):
        tiff(folder / f"slice_{k + 8}.tif", one)


def nrrd(path, values, **header):
    import nrrd as library

    library.write(str(path), values, header=header, index_order="C")


def hdf5(path, values, **options):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset("entry/image", data=values, **options)
        file["entry/note"] = "text beside it"


def matlab(path, values, **options):
    from scipy import io

    io.savemat(path, {"rock": values.transpose(1, 2, 0), "note": 3.0}, **options)  # rows, columns, slices


def matlab73(path, values):
    """Version 7.3 is HDF5 with the axes the other way round."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        file["rock"] = values.transpose(1, 2, 0).transpose()
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")


def vti(path, values, form="raw", packed=False, header="UInt32"):
    """As VTK writes them: the length in front of the data, compressed ones in blocks."""
    length = np.uint64 if header == "UInt64" else np.uint32
    data = values.tobytes()
    if packed:
        half = len(data) // 2 + 1
        blocks = [zlib.compress(data[:half]), zlib.compress(data[half:])]
        head = np.array([2, half, len(data) - half, *map(len, blocks)], length).tobytes()
        body = b"".join(blocks)
    else:
        head, body = length(len(data)).tobytes(), data
    apart = base64.b64encode(head) + base64.b64encode(body)
    together = apart if packed else base64.b64encode(head + body)
    kind = {np.dtype("u1"): "UInt8", np.dtype("u2"): "UInt16", np.dtype("f4"): "Float32"}[values.dtype]
    inline = {"ascii": " ".join(map(str, values.ravel())).encode(), "binary": together}.get(form, b"")
    spot = b'format="%s"' % (form.encode() if inline else b"appended") + (b"" if inline else b' offset="0"')
    end = (
        b""
        if inline
        else b'<AppendedData encoding="%s">\n_%s\n</AppendedData>'
        % (b"raw" if form == "raw" else b"base64", head + body if form == "raw" else together)
    )
    nx, ny, nz = values.shape[::-1]
    extent = f"0 {nx} 0 {ny} 0 {nz}".encode()
    path.write_bytes(
        b'<?xml version="1.0"?>\n<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="'
        + header.encode() + b'"' + b' compressor="vtkZLibDataCompressor"' * packed + b'>\n<ImageData WholeExtent="'
        + extent + b'" Origin="0 0 0" Spacing="1e-6 2e-6 3e-6"><Piece Extent="' + extent + b'"><CellData>'
        b'<DataArray type="' + kind.encode() + b'" Name="rock" ' + spot + b">" + inline
        + b"</DataArray></CellData></Piece></ImageData>" + end + b"</VTKFile>\n")  # fmt: skip


def vtk(path, values, text=False, field=False):
    nx, ny, nz = values.shape[::-1]
    big = values.astype(values.dtype.newbyteorder(">"))
    kind = {"u1": "unsigned_char", "u2": "unsigned_short"}[values.dtype.str[1:]]
    data = " ".join(map(str, values.ravel())).encode() if text else big.tobytes()
    head = (
        f"FIELD FieldData 1\nrock 1 {values.size} {kind}" if field else f"SCALARS rock {kind} 1\nLOOKUP_TABLE default"
    )
    path.write_bytes(
        f"# vtk DataFile Version 3.0\nrock\n{'ASCII' if text else 'BINARY'}\nDATASET STRUCTURED_POINTS\n"
        f"DIMENSIONS {nx} {ny} {nz}\nORIGIN 0 0 0\nSPACING 1e-6 2e-6 3e-6\nPOINT_DATA {values.size}\n"
        f"{head}\n".encode()
        + data
        + b"\n"
    )


def metaimage(path, values, packed=False):
    kind = {"u1": "MET_UCHAR", "u2": "MET_USHORT"}[values.dtype.str[1:]]
    sizes = " ".join(map(str, values.shape[::-1]))
    data = zlib.compress(values.tobytes()) if packed else values.tobytes()
    path.write_bytes(
        f"NDims = 3\nDimSize = {sizes}\nElementType = {kind}\nCompressedData = {packed}\n"
        "ElementDataFile = LOCAL\n".encode()
        + data
    )


def nhdr(path, values, encoding, pack):
    path.with_suffix(".data").write_bytes(pack(values.tobytes()))
    path.write_text(
        f"NRRD0004\ntype: uint{8 * values.itemsize}\ndimension: 3\nsizes: "
        f"{' '.join(map(str, values.shape[::-1]))}\nendian: little\nencoding: {encoding}\n"
        "data file: rock.data\n"
    )


BYTES = {  # name of the file: how it is written, for values of one and two bytes
    "stack.tif": tiff,
    "deflate.tif": lambda path, v: tiff(path, v, compression="deflate"),
    "by page.tif": lambda path, v: tiff(path, v, metadata=None),
    "imagej.tif": lambda path, v: tiff(path, v, imagej=True),
    "big endian.tif": lambda path, v: tiff(path, v, byteorder=">"),
    "tiles.tiff": lambda path, v: tiff(path, v, tile=(16, 16), compression="deflate"),
    "slices of tif": tiff_slices,
    "raw.nrrd": lambda path, v: nrrd(path, v, encoding="raw"),
    "gzip.nrrd": lambda path, v: nrrd(path, v, encoding="gzip"),
    "ascii.nrrd": lambda path, v: nrrd(path, v, encoding="ascii"),
    "detached.nhdr": lambda path, v: nhdr(path, v, "raw", bytes),
    "gzip.nhdr": lambda path, v: nhdr(path, v, "gzip", gzip.compress),
    "bzip2.nhdr": lambda path, v: nhdr(path, v, "bzip2", bz2.compress),
    "whole.h5": hdf5,
    "chunks.hdf5": lambda path, v: hdf5(path, v, chunks=(2, 3, 4), compression="gzip"),
    "raw.vti": vti,
    "long.vti": lambda path, v: vti(path, v, header="UInt64"),
    "packed.vti": lambda path, v: vti(path, v, packed=True),
    "text.vti": lambda path, v: vti(path, v, "ascii"),
    "binary.vti": lambda path, v: vti(path, v, "binary"),
    "packed binary.vti": lambda path, v: vti(path, v, "binary", packed=True),
    "base64.vti": lambda path, v: vti(path, v, "base64"),
    "binary.vtk": vtk,
    "text.vtk": lambda path, v: vtk(path, v, text=True),
    "field.vtk": lambda path, v: vtk(path, v, field=True),
    "version5.mat": matlab,
    "packed.mat": lambda path, v: matlab(path, v, do_compression=True),
    "version73.mat": matlab73,
    "plain.npy": lambda path, v: np.save(path, v),
    "fortran.npy": lambda path, v: np.save(path, np.asfortranarray(v)),
    "stored.npz": lambda path, v: np.savez(path, v),
    "packed.npz": lambda path, v: np.savez_compressed(path, v),
    "local.mha": metaimage,
    "packed.mha": lambda path, v: metaimage(path, v, packed=True),
    "rock_9x7x6.raw": lambda path, v: path.write_bytes(v.tobytes()),
    "rock_9_7_6.bin": lambda path, v: path.write_bytes(v.tobytes()),
}
OF_BYTES = {
    "slices of png": lambda path, v: pictures(path, v, "png"),
    "slices of bmp": lambda path, v: pictures(path, v, "bmp"),
    "lines_9x7x6.dat": lambda path, v: np.savetxt(path, v.transpose().ravel(), fmt="%d"),
    "rows_9_7_6.dat": lambda path, v: np.savetxt(path, v.transpose().reshape(-1, 6), fmt="%d"),
}


def written(tmp_path, name, values):
    path = tmp_path / ("rock.nhdr" if name.endswith(".nhdr") else name)
    (BYTES | OF_BYTES)[name](path, values)
    return path


@pytest.mark.parametrize("name", [*BYTES, *OF_BYTES])
def test_what_was_written_is_read_whole_and_in_part(tmp_path, name):
    path = written(tmp_path, name, VALUES)
    image = read_image(path)
    assert image.values.dtype == np.uint8 and np.array_equal(image.values, VALUES)
    assert image_shape(path) == VALUES.shape
    (x0, x1), (y0, y1), (z0, z1) = CROP
    part = read_image(path, crop=CROP)
    assert np.array_equal(part.values, VALUES[z0:z1, y0:y1, x0:x1])
    with pytest.raises(VoxelError, match=r"crop y \[0, 8\) does not lie in 0 to 7"):
        read_image(path, crop=((0, 9), (0, 8), (0, 6)))


@pytest.mark.parametrize("name", BYTES)
def test_sixteen_bits(tmp_path, name):
    values = VALUES.astype(np.uint16) * 300
    image = read_image(written(tmp_path, name, values), grey=True)
    assert image.values.dtype == np.uint16 and np.array_equal(image.values, values)


@pytest.mark.parametrize("axes", ["zyx", "xyz", "zxy", "yxz", "yzx", "xzy"])
@pytest.mark.parametrize("name", ["a.npy", "a.h5", "a.tif", "rock_9x7x6.raw", "rows_9_7_6.dat"])
def test_axes_in_any_order(tmp_path, name, axes):
    """The array is written with its axes in that order: what is read is [z, y, x] again, and so is a part."""
    values = VALUES.transpose(["zyx".index(a) for a in axes])
    path = tmp_path / name
    {"npy": np.save, "h5": hdf5, "tif": tiff, "raw": lambda p, v: p.write_bytes(v.tobytes()),
     "dat": lambda p, v: np.savetxt(p, v.ravel(), fmt="%d")}[path.suffix[1:]](path, values)  # fmt: skip
    image = read_image(path, layout=Layout(axes=axes))
    assert np.array_equal(image.values, VALUES) and image.axes == axes
    assert image_shape(path, layout=Layout(axes=axes)) == VALUES.shape
    assert np.array_equal(read_image(path, layout=Layout(axes=axes), crop=CROP).values, VALUES[3:5, 1:6, 2:7])


@pytest.mark.parametrize("values", [VALUES[0], VALUES[0].astype(np.uint16) * 300])
@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "npy"])
def test_thin_sections_are_2d(tmp_path, values, suffix):
    from PIL import Image

    if suffix == "bmp" and values.itemsize == 2:
        values = (values > 100).astype(bool)  # one bit a pixel
    path = tmp_path / f"section.{suffix}"
    if suffix in ("png", "bmp"):
        Image.fromarray(values).save(path)
    elif suffix == "tif":
        tiff(path, values)
    else:
        np.save(path, values)
    assert np.array_equal(read_image(path).values, values)
    assert np.array_equal(read_image(path, crop=((1, 4), (2, 6))).values, values[2:6, 1:4])


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif"])
def test_grey_in_several_channels_is_one_channel_and_colours_are_refused(tmp_path, suffix):
    from PIL import Image

    grey = np.random.default_rng(1).integers(0, 255, (20, 30)).astype(np.uint8)
    save = tiff if suffix == "tif" else lambda path, values: Image.fromarray(values).save(path)
    path = tmp_path / f"section.{suffix}"
    save(path, np.repeat(grey[..., None], 3, 2))
    image = read_image(path)
    assert np.array_equal(image.values, grey) and "the same grey; one of them is taken" in image.warnings[0]
    save(path, np.dstack([grey, grey, grey[::-1]]))
    with pytest.raises(VoxelError, match=f"section.{suffix}: is a picture in colours; save it with one grey value"):
        read_image(path)


# the size of a voxel


def voxel_size(path, layout=None):
    return read_image(path, grey=True, layout=layout)


def test_sizes_of_voxels_with_their_unit(tmp_path):
    """Edges x, y, z of 1, 2 and 3 micrometres; a TIFF of ImageJ keeps voxels per unit as a fraction."""
    v, expected = VALUES, pytest.approx((1e-6, 2e-6, 3e-6), rel=1e-6)
    tiff(tmp_path / "j.tif", v, imagej=True, resolution=(1.0, 0.5), metadata={"spacing": 3.0, "unit": "um"})
    tiff(
        tmp_path / "o.ome.tif",
        v,
        metadata={
            "axes": "ZYX",
            "PhysicalSizeX": 1000,
            "PhysicalSizeXUnit": "nm",
            "PhysicalSizeY": 2.0,
            "PhysicalSizeZ": 0.003,
            "PhysicalSizeZUnit": "mm",
        },
    )
    nrrd(
        tmp_path / "d.nrrd",
        v,
        **{
            "space directions": np.diag([1e-3, 2e-3, 3e-3]),
            "space dimension": 3,
            "space units": ["mm"] * 3,
            "kinds": ["domain"] * 3,
        },
    )
    for name in ("j.tif", "o.ome.tif", "d.nrrd"):
        image = voxel_size(tmp_path / name)
        assert image.spacing == expected and not image.spacing_key, name


def test_sizes_of_voxels_in_hdf5(tmp_path):
    h5py = pytest.importorskip("h5py")
    for name, key, sizes in (("a.h5", "element_size_um", [3.0, 2.0, 1.0]), ("b.h5", "voxel_size", [1e-6, 2e-6, 3e-6])):
        with h5py.File(tmp_path / name, "w") as file:
            file["rock"] = VALUES
            file["rock"].attrs[key] = sizes
        assert voxel_size(tmp_path / name).spacing == pytest.approx((1e-6, 2e-6, 3e-6))


def test_sizes_without_a_unit_are_named(tmp_path):
    nrrd(tmp_path / "a.nrrd", VALUES, spacings=[1e-6, 2e-6, 3e-6])
    vti(tmp_path / "a.vti", VALUES)
    vtk(tmp_path / "a.vtk", VALUES)
    for name, key in (("a.nrrd", "spacings"), ("a.vti", "Spacing"), ("a.vtk", "SPACING")):
        image = voxel_size(tmp_path / name)
        assert image.spacing == pytest.approx((1e-6, 2e-6, 3e-6)) and image.spacing_key == key


def test_sizes_follow_their_axes(tmp_path):
    nrrd(tmp_path / "a.nrrd", VALUES, spacings=[1e-6, 2e-6, 3e-6])
    assert voxel_size(tmp_path / "a.nrrd", Layout(axes="xyz")).spacing == pytest.approx((3e-6, 2e-6, 1e-6))
    assert voxel_size(tmp_path / "a.nrrd", Layout(axes="yxz")).spacing == pytest.approx((2e-6, 3e-6, 1e-6))


def test_the_resolution_of_a_print_is_no_voxel_size(tmp_path):
    tiff(tmp_path / "a.tif", VALUES, resolution=(300, 300), resolutionunit="INCH")
    assert read_image(tmp_path / "a.tif").spacing is None


# files without a header


def raw(tmp_path, name, values=VALUES, head=b""):
    (tmp_path / name).write_bytes(head + values.tobytes())
    return tmp_path / name


def test_a_raw_file_as_it_is_described(tmp_path):
    values = (VALUES.astype(np.uint16) * 300).astype(">u2")
    path = raw(tmp_path, "scan.raw", values, b"header of 16 byt")
    layout = Layout(shape=(9, 7, 6), dtype="uint16", offset=16, byte_order="big")
    image = read_image(path, layout=layout)
    assert np.array_equal(image.values, values) and image.warnings == ()


def test_what_a_name_tells_of_a_raw_file_is_said(tmp_path):
    image = read_image(raw(tmp_path, "rock_9x7x6_16bit.raw", VALUES.astype(np.uint16)))
    assert np.array_equal(image.values, VALUES)
    assert image.warnings == (
        "rock_9x7x6_16bit.raw: shape and dtype by its name and size: 9 x 7 x 6 voxels along x, y, z, "
        "uint16, little endian",
    )
    signed = read_image(raw(tmp_path, "rock_9x7x6_int16.raw", (VALUES.astype(np.int16) - 50)), grey=True)
    assert signed.values.min() == -50 and signed.values.dtype == np.int16


@pytest.mark.parametrize(("name", "kind"), [
    ("rock_9x7x6_uint16be.raw", ">u2"), ("rock_9x7x6_16bit_BE.raw", ">u2"),
    ("rock_9x7x6_float32-big-endian.raw", ">f4"),
    ("rock_9x7x6_uint16le.raw", "<u2"), ("be_9x7x6_uint16.raw", "<u2"), ("berea_9x7x6_16bit_best.raw", "<u2"),
])  # fmt: skip
def test_the_order_of_bytes_in_the_name_of_a_raw_file(tmp_path, name, kind):
    image = read_image(raw(tmp_path, name, VALUES.astype(kind)), grey=True)
    assert np.array_equal(image.values, VALUES)
    asked = "shape, dtype and byte_order" if ">" in kind else "shape and dtype"
    assert asked in image.warnings[0] and ("big endian" in image.warnings[0]) == (">" in kind)


def test_a_header_beside_a_raw_file(tmp_path):
    path = raw(tmp_path, "scan.raw")
    (tmp_path / "scan.mhd").write_text(
        "NDims = 3\nDimSize = 9 7 6\nElementType = MET_UCHAR\n"
        "ElementSpacing = 1e-6 2e-6 3e-6\nElementDataFile = scan.raw\n"
    )
    image = read_image(path)
    assert np.array_equal(image.values, VALUES) and image.spacing == (1e-6, 2e-6, 3e-6)


@pytest.mark.parametrize(
    ("name", "size", "layout", "message"),
    [
        ("a.raw", 8000, {}, "has no header: give its sizes .*its 8000 bytes would be 20 x 20 x 20 of uint8"),
        ("a.raw", 16000, {}, "16000 bytes would be 20 x 20 x 20 of uint16"),
        ("a.raw", 400, {}, "400 bytes would be 20 x 20 of uint8"),
        ("a.raw", 7919, {}, r"has no header: give its sizes along x, y, z and its type, such as --set 'geometry"),
        ("a.raw", 8001, {"shape": (20, 20, 20), "dtype": "uint8"}, "holds 8001 bytes; 20 x 20 x 20 voxels of uint8"),
        ("a.raw", 7999, {"shape": (20, 20, 20), "dtype": "uint8"}, "correct shape, dtype or offset"),
        ("a.raw", 8000, {"shape": (20, 20, 20), "dtype": "uint16"}, "are 16000"),
        ("a.raw", 32000, {"shape": (20, 20, 20)}, "32000 bytes are 4 for each of .* give the type"),
        ("a.raw", 8010, {"shape": (20, 20, 20)}, "8010 bytes are 1.001 for each of .*give the type"),
        ("a.raw", 8000, {"shape": (20, 20, 20), "dtype": "uint8", "offset": 8}, "after 8 bytes are 8008"),
        ("a_20x20x20_float32.raw", 8000, {}, "voxels of float32"),
        ("a.raw", 0, {"shape": (20, 20, 20), "dtype": "uint8"}, "holds 0 bytes"),
    ],
)
def test_raw_files_that_do_not_fit(tmp_path, name, size, layout, message):
    (tmp_path / name).write_bytes(bytes(size))
    with pytest.raises(VoxelError, match=f"{name}: {message}" if message.startswith("has") else message) as error:
        read_image(tmp_path / name, layout=Layout(**layout))
    assert name in str(error.value)


@pytest.mark.parametrize(
    ("text", "shape", "message"),
    [
        ("0 1 2 0 1 2 0", (2, 2, 2), "bytes of text cannot hold|holds 7 numbers where 2 x 2 x 2 are 8"),
        ("0 1 2 0 1 2 0 1 0", (2, 2, 2), "more than 8 numbers"),
        ("0 1 2 0 1 2 0 x", (2, 2, 2), "more than whole numbers"),
        ("0 1 2 0 1 2 0 -1", (2, 2, 2), "more than whole numbers"),
        ("0 1 2 0 1 2 0 1.5", (2, 2, 2), "more than whole numbers"),
        ("0 1 2 0 1 2 0 256", (2, 2, 2), "value 256"),
        ("0 1 2 0 1 2 0 99999", (2, 2, 2), "value 999|more than"),
        ("", (2, 2, 2), "cannot hold"),
        ("0 1 2 0 1 2 0 1", None, "text without a header"),
        ("01201201", (2, 2, 2), "cannot hold"),
        ("\0\1\2\0\1\2\0\1\0\1\2\0\1\2\0", (2, 2, 2), "more than whole numbers"),
    ],
)
def test_palabos_files_that_do_not_fit(tmp_path, text, shape, message):
    (tmp_path / "a.dat").write_text(text)
    with pytest.raises(VoxelError, match=message) as error:
        read_image(tmp_path / "a.dat", layout=Layout(shape=shape))
    assert "a.dat" in str(error.value)


# what is damaged


def damages(data):
    """Ten kinds of damage, none of which leaves an image of 6 x 7 x 9 voxels behind."""
    noise = np.random.default_rng(1).integers(0, 256, len(data)).astype(np.uint8).tobytes()
    quarter = len(data) // 4
    other = b"# a text\n" if data[:1] == b"\x93" else b"\x93NUMPY\x01\x00"
    return {"empty": b"", "a beginning": data[:10], "a third": data[: len(data) // 3], "half": data[: len(data) // 2],
            "without its last fifth": data[: -(len(data) // 5)], "noise": noise, "zeros": bytes(len(data)),
            "a head of zeros": bytes(quarter) + data[quarter:], "a head of noise": noise[:quarter] + data[quarter:],
            "another kind of file": other + b"of another kind " * 20}  # fmt: skip


DAMAGED = [name for name in BYTES if not name.startswith(("slices", "rock_"))]


@pytest.mark.parametrize("kind", damages(b" " * 1000))
@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_refused_by_name(tmp_path, name, kind):
    path = written(tmp_path, name, VALUES)
    path.write_bytes(damages(path.read_bytes())[kind])
    with pytest.raises(VoxelError) as error:
        read_image(path)
    assert path.name in str(error.value) and len(str(error.value)) < 600


@pytest.mark.parametrize("kind", damages(b" " * 1000))
@pytest.mark.parametrize("suffix", ["png", "bmp"])
def test_damaged_pictures_are_refused_by_name(tmp_path, suffix, kind):
    from PIL import Image

    path = tmp_path / f"section.{suffix}"
    Image.fromarray(VALUES[0]).save(path)
    path.write_bytes(damages(path.read_bytes())[kind])
    with pytest.raises(VoxelError, match=path.name):
        read_image(path)


def cut(folder):
    file = folder / "slice_9.tif"
    file.write_bytes(file.read_bytes()[:-30])


FOLDERS = {
    "empty": lambda f: [file.unlink() for file in f.iterdir()],
    "another size": lambda f: tiff(f / "slice_9.tif", VALUES[0, 1:]),
    "another type": lambda f: tiff(f / "slice_9.tif", VALUES[0].astype(np.uint16)),
    "two kinds": lambda f: np.save(f / "slice.npy", 0) or (f / "slice_9.tif").rename(f / "slice_9.png"),
    "a slice cut off": cut,
    "an empty slice": lambda f: (f / "slice_9.tif").write_bytes(b""),
    "a slice of zeros": lambda f: (f / "slice_9.tif").write_bytes(bytes(300)),
    "a stack among slices": lambda f: tiff(f / "slice_9.tif", VALUES),
    "stacks": lambda f: tiff(f / "slice_8.tif", VALUES),
    "a slice in colours": lambda f: tiff(
        f / "slice_9.tif", np.random.default_rng(0).integers(0, 255, (7, 9, 3)).astype(np.uint8), photometric="rgb"
    ),
    "text": lambda f: (f / "slice_8.tif").write_text("a text"),
}


@pytest.mark.parametrize("kind", FOLDERS)
def test_damaged_folders_are_refused_by_name(tmp_path, kind):
    tiff_slices(tmp_path / "scan", VALUES)
    FOLDERS[kind](tmp_path / "scan")
    with pytest.raises(VoxelError, match="scan"):
        read_image(tmp_path / "scan")


def test_a_missing_slice_is_said(tmp_path):
    tiff_slices(tmp_path / "scan", VALUES)
    (tmp_path / "scan" / "slice_10.tif").unlink()
    image = read_image(tmp_path / "scan")
    assert len(image.values) == 5 and image.warnings == (
        "scan: slice 10 is missing; those around are taken for neighbours",
    )


@pytest.mark.parametrize(
    ("save", "message"),
    [
        (lambda p: hdf5(p / "a.h5", VALUES.astype(np.complex64)), "name one"),
        (lambda p: nrrd(p / "a.nrrd", np.zeros((2, 2, 2, 2), np.uint8)), "4 dimensions"),
        (lambda p: tiff(p / "a.tif", np.zeros((2, 2, 5, 6), np.uint8)), "4 dimensions"),
        (lambda p: matlab(p / "a.mat", VALUES.astype(complex)), r"holds the arrays \['rock', 'note'\]; name one"),
    ],
)
def test_arrays_that_are_no_images(tmp_path, save, message):
    save(tmp_path)
    with pytest.raises(VoxelError, match=message):
        read_image(next(tmp_path.iterdir()))


def test_of_several_arrays_one_has_to_be_named(tmp_path):
    h5py = pytest.importorskip("h5py")
    from scipy import io

    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["grey/scan"], file["labels"] = VALUES + 1, VALUES
    io.savemat(tmp_path / "a.mat", {"scan": VALUES + 1, "labels": VALUES})
    for name in ("a.h5", "a.mat"):
        with pytest.raises(VoxelError, match=r"scan.*labels.*name one with the key 'array'|labels.*scan"):
            read_image(tmp_path / name)
        with pytest.raises(VoxelError, match="there is no 'rock'"):
            read_image(tmp_path / name, array="rock")
        assert np.array_equal(read_image(tmp_path / name, layout=Layout(array="labels", axes="zyx")).values, VALUES)


def test_whole_numbers_that_matlab_saved_as_doubles_are_labels(tmp_path):
    matlab(tmp_path / "a.mat", (VALUES > 90).astype(float))
    assert np.array_equal(read_image(tmp_path / "a.mat").values, VALUES > 90)


def test_headers_of_vti_that_ask_too_much(tmp_path):
    """A compressed array that says it has 4 thousand million blocks, and a document type with entities."""
    vti(tmp_path / "a.vti", VALUES, packed=True)
    data = (tmp_path / "a.vti").read_bytes()
    at = data.index(b"\n_") + 2
    (tmp_path / "a.vti").write_bytes(data[:at] + struct.pack("<I", 2**32 - 1) + data[at + 4 :])
    with pytest.raises(VoxelError, match="4294967295 blocks"):
        read_image(tmp_path / "a.vti")
    (tmp_path / "a.vti").write_bytes(data.replace(b"<VTKFile", b'<!DOCTYPE x [<!ENTITY a "b">]><VTKFile', 1))
    with pytest.raises(VoxelError, match="document type"):
        read_image(tmp_path / "a.vti")


def accident(rng, data):
    """Some bytes near the head of a file lost, changed or put in."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(0, min(len(data), 400)))
        kind = rng.integers(0, 4)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del data[at : at + int(rng.integers(1, 9))]
        elif kind == 2:
            data[at : at + 4] = b"\xff\xff\xff\xff"
        else:
            data[at:at] = b"9999999"
    return bytes(data)


@pytest.mark.parametrize("name", [n for n in DAMAGED if "h5" not in n and "hdf5" not in n and "73" not in n])
def test_accidents_give_an_image_or_a_clear_error(tmp_path, name):
    """Headers that ask for more than there is take no memory. (HDF5 is left to its library.)"""
    path = written(tmp_path, name, VALUES)
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    for _ in range(12):
        path.write_bytes(accident(rng, whole))
        try:
            image = read_image(path, grey=True)
        except VoxelError as error:
            assert "rock" in str(error) or path.name in str(error)
        else:
            assert image.values.ndim in (2, 3) and image.values.nbytes < 10**6


def lzw(path):
    from PIL import Image

    pages = [Image.fromarray(one) for one in VALUES]
    pages[0].save(path, compression="tiff_lzw", save_all=True, append_images=pages[1:])


def test_tiff_with_lzw(tmp_path):
    pytest.importorskip("imagecodecs")
    lzw(tmp_path / "a.tif")
    assert np.array_equal(read_image(tmp_path / "a.tif").values, VALUES)


def test_tiff_with_lzw_names_the_package_that_is_missing(tmp_path, monkeypatch):
    lzw(tmp_path / "a.tif")
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    monkeypatch.setitem(sys.modules, "h5py", None)
    for name in [name for name in sys.modules if name == "tifffile" or name.startswith("tifffile.")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(VoxelError, match=r"a.tif: is stored .*\(LZW, 8 bits a voxel\) .*pip install imagecodecs"):
        read_image(tmp_path / "a.tif")
    (tmp_path / "a.h5").write_bytes(b"any")
    with pytest.raises(VoxelError, match=r"a\.h5: the package h5py reads HDF5 files: pip install"):
        read_image(tmp_path / "a.h5")


def test_every_format_is_tested():
    tested = {f".{name.rpartition('.')[2]}" for name in [*BYTES, *OF_BYTES, "a.png", "a.bmp", "a.mhd"]}
    assert set(FORMATS) <= tested
