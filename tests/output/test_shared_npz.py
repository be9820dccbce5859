"""npz files that several processes write: what numpy reads of them, their checksums, and slabs of rows."""

import zipfile
import zlib

import numpy as np
import pytest

from isphcli.output import shared_npz
from tests.domain.several import on_threads

SIZES = [1, 2, 3, 8]


@pytest.mark.parametrize("sizes", [(1, 1), (0, 3), (5, 0), (17, 1000), (1000, 70_001)])
def test_a_crc_follows_from_those_of_two_parts(sizes):
    first, second = (np.random.default_rng(size).bytes(size) for size in sizes)
    assert shared_npz.crc_of_both(zlib.crc32(first), zlib.crc32(second), len(second)) == zlib.crc32(first + second)


@pytest.mark.parametrize("count", [1, 5, 1023, 1024, 5000])
@pytest.mark.parametrize("size", SIZES)
def test_slabs_hold_every_row_once_and_whole_parts(size, count):
    """The process of a row is the one in whose slab it is; the digests of the slabs are those of the whole array."""
    data = memoryview(np.random.default_rng(0).bytes(8 * count))

    def own(ranks):
        first, end = shared_npz.slab(count)
        rows = np.flatnonzero(shared_npz.in_slab_of(np.arange(count), count) == ranks.rank)
        return first, end, rows, shared_npz._digests(data[8 * first : 8 * end], first, 8, count)

    found = on_threads(size, own)
    assert [first for first, *_ in found] == [0, *(end for _, end, *_ in found[:-1])] and found[-1][1] == count
    for first, end, rows, _ in found:
        assert rows.tolist() == list(range(first, end))
    assert b"".join(digests for *_, digests in found) == shared_npz._digests(data, 0, 8, count)


def test_numpy_and_zip_read_what_is_written(tmp_path):
    """Every array with its type and shape, and a zip whose checksums are right, which the file keeps beside the digest
    of its own."""
    arrays = {"x": np.random.default_rng(1).random((7, 3)), "none": np.zeros((0, 2)), "step": np.array(7),
              "meta": np.frombuffer(b"text", np.uint8)}
    shared_npz.write(tmp_path / "r.npz", arrays, {})
    with zipfile.ZipFile(tmp_path / "r.npz") as archive:
        assert archive.testzip() is None
    with np.load(tmp_path / "r.npz", allow_pickle=False) as file:
        assert set(file.files) == {*arrays, shared_npz.DIGEST}
        for name, values in arrays.items():
            assert file[name].dtype == values.dtype and np.array_equal(file[name], values)
    found, whole = shared_npz.read(tmp_path / "r.npz")
    assert whole and found.keys() == arrays.keys() and found["step"].shape == ()
    data = bytearray((tmp_path / "r.npz").read_bytes())
    data[data.index(arrays["x"].tobytes()) + 100] ^= 1
    (tmp_path / "r.npz").write_bytes(data)
    assert not shared_npz.read(tmp_path / "r.npz")[1]


@pytest.mark.parametrize("size", SIZES)
def test_slabs_are_written_to_the_same_bytes_and_read(size, tmp_path, monkeypatch):
    """With files of each process's own in the place of MPI's: the bytes do not depend on the number of processes."""
    x = np.random.default_rng(2).random((11, 2))
    on_threads(1, lambda _: shared_npz.write(tmp_path / "one.npz", {"x": x, "step": np.array(3)}, {}))
    (tmp_path / "r.npz").touch()

    class Opened:
        def __enter__(self):
            self.file = open(tmp_path / "r.npz", "r+b")
            return lambda place, data: (self.file.seek(place), self.file.write(data), self.file.flush())

        def __exit__(self, *_):
            self.file.close()

    monkeypatch.setattr(shared_npz, "_opened", lambda _: Opened())

    def write_and_read(ranks):
        first, end = shared_npz.slab(len(x))
        shared_npz.write(tmp_path / "r.npz", {"x": x[first:end], "step": np.array(3)}, {"x": len(x)})
        ranks.first(None)  # the file is whole
        return shared_npz.read(tmp_path / "r.npz", ["x"])

    found = on_threads(size, write_and_read)
    assert (tmp_path / "r.npz").read_bytes() == (tmp_path / "one.npz").read_bytes()
    assert all(whole and arrays["step"] == 3 for arrays, whole in found)
    assert np.array_equal(np.concatenate([arrays["x"] for arrays, _ in found]), x)
