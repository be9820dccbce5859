"""npz files that any number of processes write together, each its rows of the arrays, and read, each its rows.

The arrays are stored as they are, so that the place of every byte is known before one is written, and the CRC that a
zip holds of an array follows from those of its rows. numpy.load reads such a file. Behind the arrays stands the digest
of all: each array is cut into `PARTS` parts, whole numbers of which are the slab of a process, and the digest is the
SHA-256 of the names, types and shapes and of the SHA-256 of every part. It does not depend on the number of processes,
none of which has to read the bytes of another.
"""

from __future__ import annotations

import errno
import hashlib
import io
import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..domain.communicator import current, on_any

PARTS = 1024  # of an array, as long as each other within a row; as many processes can share it
DIGEST = "sha256"
AT_ONCE = 1 << 28  # bytes of a call of MPI, which counts in 32 bits
POLYNOMIAL = 0xEDB88320  # of the CRC of a zip; the highest bit is the power 0


def slab(count: int) -> tuple[int, int]:
    """First of so many rows in the slab of this process, and of the next one's."""
    rank, size = current().rank, current().size
    return _begin(-(-PARTS * rank // size), count), _begin(-(-PARTS * (rank + 1) // size), count)


def in_slab_of(row: np.ndarray, count: int) -> np.ndarray:
    """Process (n,) in whose slab rows (n,) of so many are."""
    return row * PARTS // count * current().size // PARTS


def _begin(part: int, count: int) -> int:
    """First of so many rows in a part."""
    return -(-count * part // PARTS)


# --- writing --------------------------------------------------------------------------------------------------------


_Part = tuple[int, int, bytes]  # of rows of an array: their CRC, how many bytes they are, the digests of their parts


@dataclass(frozen=True)
class _Entry:
    """A file of the zip: its head is that of an npy file, its place that of the zip's header in front of it."""

    name: str
    head: bytes
    row: int  # bytes
    count: int  # of rows; a number is a row
    size: int  # bytes, with the head
    place: int

    @property
    def data(self) -> int:
        """Place of the first row."""
        return self.place + len(self.local(0)) + len(self.head)

    def local(self, crc: int) -> bytes:
        """The zip's header in front of it; sizes are in 64 bits."""
        name = f"{self.name}.npy".encode()
        return struct.pack("<IHHHHHIIIHH", 0x04034B50, 45, 0, 0, 0, 0x21, crc, 2**32 - 1, 2**32 - 1, len(name),
                           20) + name + struct.pack("<HHQQ", 1, 16, self.size, self.size)

    def listed(self, crc: int) -> bytes:
        """Its entry in the list at the end of the zip; whoever unpacks it may read and write it."""
        name = f"{self.name}.npy".encode()
        return struct.pack("<IHHHHHHIIIHHHHHII", 0x02014B50, 3 << 8 | 45, 45, 0, 0, 0, 0x21, crc, 2**32 - 1, 2**32 - 1,
                           len(name), 28, 0, 0, 0, 0o600 << 16, 2**32 - 1) + name + struct.pack(
                               "<HHQQQ", 1, 24, self.size, self.size, self.place)


def write(path: Path, arrays: Mapping[str, np.ndarray], counts: Mapping[str, int]) -> None:
    """Writes arrays, and their digest, into an npz. All processes call it together: of an array of `counts`, its rows
    on all processes, each gives its slab; any other is the same on all. An error of one is raised on all."""
    kinds = {name: (values.dtype, (counts[name], *values.shape[1:]) if name in counts else values.shape)
             for name, values in sorted(arrays.items())}
    entries, rank = _laid_out(kinds), current().rank
    firsts = {name: slab(count)[0] for name, count in counts.items()}
    with _opened(path) as put:
        def write_own() -> dict[str, _Part]:
            return {entry.name: _write_rows(put, entry, arrays[entry.name], firsts.get(entry.name, 0))
                    for entry in entries[:-1] if entry.name in counts or rank == 0}

        found = current().gather(on_any(write_own))
        on_any(lambda: None if found is None else _write_heads(put, entries, found))


def _laid_out(kinds: Mapping[str, tuple[np.dtype, tuple[int, ...]]]) -> list[_Entry]:
    """The entries of a file: arrays of some types and shapes, and their digest."""
    entries, place = [], 0
    for name, (kind, shape) in [*kinds.items(), (DIGEST, (np.dtype(np.uint8), (32,)))]:
        file = io.BytesIO()
        np.lib.format.write_array_header_1_0(file, {
            "descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": shape})
        head, row, count = file.getvalue(), *_rows(kind, shape)
        entries.append(_Entry(name, head, row, count, len(head) + row * count, place))
        place = entries[-1].data + row * count
    return entries


def _write_rows(put: Callable[[int, Any], None], entry: _Entry, values: np.ndarray, first: int) -> _Part:
    """Writes rows of an array from the first on."""
    data = _bytes(values)
    put(entry.data + first * entry.row, data)
    return zlib.crc32(data), len(data), _digests(data, first, entry.row, entry.count)


def _write_heads(put: Callable[[int, Any], None], entries: Sequence[_Entry],
                 found: Sequence[Mapping[str, _Part]]) -> None:
    """Writes what is not rows: heads, the digest and the list at the end, by what all processes have found."""
    *arrays, last = entries
    crcs = {}
    for entry in arrays:
        crc = zlib.crc32(entry.head)
        for part, length, _ in (of[entry.name] for of in found if entry.name in of):
            crc = crc_of_both(crc, part, length)
        crcs[entry.name] = crc
    digest = _digest({entry.name: (entry.head, b"".join(of[entry.name][2] for of in found if entry.name in of))
                      for entry in arrays})
    crcs[last.name] = zlib.crc32(last.head + digest)
    for entry in entries:
        put(entry.place, entry.local(crcs[entry.name]) + entry.head + (digest if entry is last else b""))
    place = last.data + len(digest)
    listed = b"".join(entry.listed(crcs[entry.name]) for entry in entries)
    end = place + len(listed)
    put(place, listed
        + struct.pack("<IQHHIIQQQQ", 0x06064B50, 44, 45, 45, 0, 0, len(entries), len(entries), len(listed), place)
        + struct.pack("<IIQI", 0x07064B50, 0, end, 1)
        + struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 2**16 - 1, 2**16 - 1, 2**32 - 1, 2**32 - 1, 0))


@contextmanager
def _opened(path: Path) -> Iterator[Callable[[int, Any], None]]:
    """Yields a function that writes bytes at a place of a file, the same one on all processes."""
    ranks = current()
    if ranks.size == 1:
        with open(path, "wb") as one:
            yield lambda place, data: (one.seek(place), one.write(data), None)[-1]
        return
    from mpi4py import MPI

    def told(call: Callable[[], Any]) -> Any:
        """The result of a call of MPI; its error as one of the system."""
        try:
            return call()
        except MPI.Exception as error:
            full = error.Get_error_class() in (MPI.ERR_NO_SPACE, MPI.ERR_QUOTA)
            raise OSError(errno.ENOSPC if full else errno.EIO, f"rank {ranks.rank} could not write: {error}",
                          str(path)) from None

    def put(place: int, data: Any) -> None:
        for begin in range(0, len(data), AT_ONCE):
            part, status = data[begin : begin + AT_ONCE], MPI.Status()
            told(lambda: file.Write_at(place + begin, [part, MPI.BYTE], status))  # noqa: B023 - called at once
            if status.Get_count(MPI.BYTE) < len(part):  # of a full disk some MPI tell so and not by an error
                raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)} for rank {ranks.rank}", str(path))

    raw = ranks.raw  # type: ignore[attr-defined]
    file = on_any(lambda: told(lambda: MPI.File.Open(raw, os.fspath(path), MPI.MODE_WRONLY | MPI.MODE_CREATE)))
    try:
        yield put
        on_any(lambda: told(file.Sync))
    finally:
        file.Close()


def crc_of_both(first: int, second: int, length: int) -> int:
    """CRC of two strings of bytes, the one behind the other, by their CRCs and how long the second one is: the CRC is
    a polynomial over the numbers 0 and 1, which so many zeros more multiply by x^(8 length)."""
    power, square = 1 << 31, 1 << 23  # x^0 and x^8
    while length:
        if length & 1:
            power = _product(power, square)
        square, length = _product(square, square), length >> 1
    return _product(power, first) ^ second


def _product(a: int, b: int) -> int:
    """Product of two polynomials, less multiples of that of the CRC."""
    found = 0
    for power in range(32):
        if a >> (31 - power) & 1:
            found ^= b
        b = b >> 1 ^ (POLYNOMIAL if b & 1 else 0)
    return found


# --- the digest -----------------------------------------------------------------------------------------------------


def _bytes(values: np.ndarray) -> memoryview:
    return np.ascontiguousarray(values).reshape(-1).view(np.uint8).data


def _rows(kind: np.dtype, shape: tuple[int, ...]) -> tuple[int, int]:
    """Bytes of a row of an array, and how many rows it has; a number is a row."""
    return kind.itemsize * math.prod(shape[1:]), shape[0] if shape else 1


def _digests(data: memoryview, first: int, row: int, count: int) -> bytes:
    """SHA-256 of every part of an array, one after the other, that lies in these bytes: rows from the first on, each of
    `row` bytes, of so many in all. With fewer rows than parts there are parts of none, which have no digest."""
    begins = sorted({_begin(part, count) for part in range(PARTS)})
    last, found = first * row + len(data), []
    for begin, end in zip(begins, [*begins[1:], count]):
        if first <= begin < end and end * row <= last:
            found.append(hashlib.sha256(data[(begin - first) * row : (end - first) * row]).digest())
    return b"".join(found)


def _digest(parts: Mapping[str, tuple[bytes, bytes]]) -> bytes:
    """SHA-256 over the names of arrays, the heads of their npy files, which have types and shapes, and the digests of
    their parts."""
    total = hashlib.sha256()
    for name in sorted(parts):
        head, digests = parts[name]
        total.update(name.encode() + b"\0" + head + digests)
    return total.digest()


# --- reading --------------------------------------------------------------------------------------------------------


def read(path: Path, in_slabs: Collection[str] = (), left_out: Callable[[str], bool] = lambda name: False
         ) -> tuple[dict[str, np.ndarray], bool]:
    """The arrays of a file that `write` has written, and whether its digest is right. All processes call it together,
    and get of the arrays `in_slabs` their slab, of those `left_out` nothing, all others whole.

    Raises what zipfile and numpy raise for broken bytes, or ValueError.
    """
    ranks, claimed = current(), b""
    arrays, heads, parts = dict[str, np.ndarray](), dict[str, bytes](), dict[str, bytes]()
    with open(path, "rb") as file, zipfile.ZipFile(file) as archive:
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            head, kind, shape, place = _head(file, info)
            row, count = _rows(kind, shape)
            first, end = slab(count) if name in in_slabs else (0, count)
            values = np.empty((end - first, *shape[1:]), kind)
            file.seek(place + first * row)
            if file.readinto(_bytes(values)) < values.nbytes:
                raise ValueError(f"{info.filename} has an end too early")
            if name == DIGEST:
                claimed = values.tobytes()
                continue
            heads[name] = head
            if name in in_slabs or ranks.rank == 0:
                parts[name] = _digests(_bytes(values), first, row, count)
            if not left_out(name):
                arrays[name] = values if shape else values.reshape(())
    found = ranks.gather(parts)
    right = found is not None and claimed == _digest({
        name: (head, b"".join(of.get(name, b"") for of in found)) for name, head in heads.items()})
    return arrays, bool(ranks.first(right))


def _head(file: BinaryIO, info: zipfile.ZipInfo) -> tuple[bytes, np.dtype, tuple[int, ...], int]:
    """Of an entry: the head of its npy file, type and shape by it, and the place of the first row. Raises ValueError
    where the bytes are not as many as it says."""
    try:
        file.seek(info.header_offset + 26)
        name, extra = struct.unpack("<HH", file.read(4))
        begin = file.seek(info.header_offset + 30 + name + extra)
        version = np.lib.format.read_magic(file)
        of = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, kind = of(file)
        place = file.tell()
    except (struct.error, tokenize.TokenError) as problem:  # numpy lets the second one through
        raise ValueError(f"{info.filename}: {problem}") from None
    file.seek(begin)
    stored = info.compress_type == zipfile.ZIP_STORED and not fortran and not kind.hasobject
    if not stored or info.file_size != place - begin + math.prod(_rows(kind, shape)):
        raise ValueError(f"{info.filename} is not stored as it is")
    return file.read(place - begin), kind, shape, place
