"""Feeds bad inputs to the readers: what comes back must be a clean error or a valid object, soon and in little memory.

    PYTHONPATH=. python benchmarks/bad_inputs.py [--count 10000] [--seed 0] [--only KIND] [--keep DIR]

Kinds: case files (mutations of those in cases/ and of a few small ones, of two fluids as well; then read, written,
read again, checked as `isph validate --check-only` does, and their particles placed), images (npy, npz, mhd with raw,
mha; then labelled), the formats that libraries read (TIFF, raw, NRRD, HDF5, VTI, VTK, PNG, BMP, MATLAB, Palabos text),
lists and dumps of spheres, and restart files. A mutation flips, cuts, doubles or inserts bytes, or replaces a
word or number by one of a list of evil ones; some inputs are made evil from the start (huge, negative and overflowing
sizes, other types and byte orders, NaN, zip bombs, anchors), some are random bytes. All of it runs in one process whose
address space is limited to `LIMIT` more than it had; an alarm ends an input after `SECONDS`. Counted: clean errors
(those that the command line turns into exit code 2), valid objects, tracebacks (any other exception), memory errors,
hangs; and the peak memory. Exit code 1 if there are tracebacks, memory errors or hangs; the inputs that caused them are
kept.
"""

import argparse
import io
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections import Counter
from pathlib import Path

import numpy as np

from isphcli.case.expressions import ExpressionError
from isphcli.case.load import dump_case, read_case
from isphcli.case.yaml import CaseError
from isphcli.domain.lattice import ParticleError
from isphcli.flow.state import State
from isphcli.geometry.bodies import ShapeError
from isphcli.geometry.images.image import Layout, VoxelError
from isphcli.geometry.images.read import read_image
from isphcli.geometry.labels import apply_labels
from isphcli.output import restart
from isphcli.output.convert_images import write_image
from isphcli.preflight.check import check
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.place import place_case
from isphcli.scene.sphere_files import read_spheres

LIMIT = 1_500_000_000  # bytes of address space that the inputs may take
SECONDS = 20  # the largest image here has 100 million voxels
CLEAN = (CaseError, ExpressionError, VoxelError, ShapeError, ParticleError, restart.RestartError)
SITES = 300_000  # a lattice larger than that is valid, and too long to check ten thousand times

ROOT = Path(__file__).parent.parent
SMALL = """
geometry: {box: [1, 1], periodic: [x], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.25}, is: solid}]}
particles: {spacing: 0.1, lattice: hexagonal, jitter: 0.1}
fluids: {water: {density: 1000, viscosity: 1e-3}}
initial: {velocity: ["sin(2*pi*x)", "0"]}
drive: {body_force: [1, 0]}
time: {end: 1, cfl: 0.2}
output: {every: 0.1, fields: [velocity], restart_every: 10}
"""
TWO_FLUIDS = """
geometry:
  box: [1, 1]
  periodic: [x]
  fluid: water
  shapes:
    - {sphere: {centre: [0.5, 0.5], radius: 0.1}, is: solid}
    - {spheres: {random: 3, radius: 0.1, clearance: 0.05, seed: 1}, is: oil}
particles: {spacing: 0.1, jitter: 0.1}
fluids: {water: {density: 1000, viscosity: 1e-3}, oil: {density: 1, viscosity: 1e-5}}
interface: {tension: 0.07, contact_angle: 30, method: csf}
initial: {velocity: ["0", "sin(2*pi*x)"], flood: {fluid: oil, from: x_min, saturation: 0.2}}
drive: {pressure_drop: {x: 1}}
time: {end: 1, capillary: 0.5}
"""
FLOODED = """
geometry:
  voxels: {file: image.npy, labels: {solid: 1, oil: 0}, voxel_size: 1.0e-5, clear_layer: 2.0e-5}
particles: {spacing: 1.0e-5}
fluids: {oil: {density: 1000, viscosity: 1e-3}, water: {density: 500, viscosity: 1e-4}}
interface: {tension: 0.03, contact_angle: 120}
initial: {flood: {fluid: water, from: z_max, saturation: 0.3}}
drive: {body_force: [0, 0, -1]}
time: {end: 1}
"""
IMAGE_CASE = """
geometry:
  voxels: {file: image.npy, labels: {solid: 1, water: 0}, voxel_size: 1.0e-5, crop: [[0, 6], [0, 5], [0, 4]]}
  periodic: [x]
particles: {spacing: 1.0e-5, support: 2.1}
fluids: {water: {density: 1000, viscosity: 1e-3}}
flow: stokes
drive: {axes: [x]}
"""
EVIL = (
    "nan .nan inf -inf .inf 1e400 -1e400 1e-400 5e-324 1.8e308 -0.0 0 -1 1 2 1e30 5000 9999999 99999999999999999999 "
    "0x10 1_000 true no null ~ {} [] [[]] [1,2,3,4] {a: b} *a &a !!python/object:os.system !!binary solid x xyz "
    "-- --- ... | > "
    "' \" \t \x00 \ufeff \u2028 é 日本 ../../etc/passwd /dev/zero /dev/stdin . .. ~/x C:\\x sin(x) 9**9**9 "
    "__import__('os') x.__class__ (((((((((( 1/0 <<: ? :"
).split(" ")


def mutated(rng, data, times=None):
    """Bytes with some accidents."""
    data = bytearray(data)
    for _ in range(times or rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(data) + 1)
        end = min(len(data), at + rng.choice((1, 1, 2, 8, 64)))
        kind = rng.randrange(6)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[at:end]
        elif kind == 2:
            data[at:at] = data[at:end] * rng.choice((1, 2, 50))
        elif kind == 3:
            data[at:at] = rng.randbytes(rng.choice((1, 4, 30)))
        elif kind == 4:
            del data[at:]
        else:
            data[at:end] = rng.choice(EVIL).encode()
    return bytes(data)


def evil_words(rng, text):
    """Text with some of its words and numbers replaced, lines doubled or indented."""
    for _ in range(rng.choice((1, 1, 2, 5))):
        words = list(re.finditer(r"[\w.+-]+", text))
        word = rng.choice(words)
        other = rng.choice(EVIL) if rng.random() < 0.7 else rng.choice(words).group()
        text = text[: word.start()] + other + text[word.end() :]
    lines = text.splitlines()
    if rng.random() < 0.2:
        k = rng.randrange(len(lines))
        lines[k:k] = [rng.choice((lines[k], "\t" + lines[k], "  " + lines[k], rng.choice(lines)))]
    return "\n".join(lines)


def bomb(rng):
    """YAML that grows: anchors that name each other, deep nesting, long keys."""
    n = rng.choice((10, 1000, 100_000))
    return rng.choice((
        "a0: &a0 [x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)),
        "[" * n, "{a: " * n, "- " * n, "a: " * n, "? " * n, "k" * n + ": 1", "a: '" + "x" * n + "'",
        "".join(f"k{k}: 1\n" for k in range(n)), "fluids: {" + ", ".join(f"f{k}: 1" for k in range(n)) + "}",
        "x: " + "9" * n, "x: !!int " + "9" * n, "&" * n, "!" * n, "%YAML 9.9\n---\n",
    )).encode()


class Cases:
    def __init__(self, folder):
        self.folder = folder
        found = [p.read_bytes() for p in sorted((ROOT / "cases").glob("*.yaml"))]
        small = [text.encode() for text in (SMALL, IMAGE_CASE, TWO_FLUIDS, FLOODED)]
        self.seeds = [*found, *small * (len(found) // 2)]
        (folder / "data").mkdir()
        for name in ("square_duct_8.npy", "two_tubes.npy"):  # the others are large: cases that ask for them are refused
            shutil.copy(ROOT / "cases" / "data" / name, folder / "data")
        np.save(folder / "image.npy", np.random.default_rng(0).integers(0, 2, (4, 5, 6), dtype=np.uint8))

    def make(self, rng):
        kind = rng.randrange(10)
        if kind == 0:
            return "yaml", rng.randbytes(rng.choice((0, 1, 10, 200)))
        if kind == 1:
            return "yaml", bomb(rng)
        seed = rng.choice(self.seeds)
        return "yaml", mutated(rng, seed) if kind < 5 else evil_words(rng, seed.decode()).encode()

    def use(self, path):
        case = read_case(path.read_bytes(), self.folder / "case.yaml")
        assert read_case(dump_case(case).encode(), self.folder / "case.yaml") == case
        if case.geometry.box is not None:
            spacing = min((case.particles.spacing, *case.refine))
            support = case.support * spacing
            if np.prod([(edge + 2 * support) / spacing for edge in case.geometry.box]) > SITES:
                return
        geometry = build_geometry(case)
        found = check(case, geometry)
        found.text()
        if found.can_run:
            place_case(case, geometry, case.particles.spacing)


class Images:
    def __init__(self, folder):
        self.folder = folder
        values = np.random.default_rng(0).integers(0, 3, (4, 5, 6), dtype=np.uint8)
        self.seeds = []
        for suffix in ("npy", "npz", "mhd", "mha"):
            write_image(folder / f"seed.{suffix}", values, (1e-6, 1e-6, 2e-6))
            self.seeds.append((suffix, (folder / f"seed.{suffix}").read_bytes()))
        self.raw = (folder / "seed.raw").read_bytes()

    def make(self, rng):
        kind = rng.randrange(10)
        if kind == 0:
            suffix = rng.choice(("npy", "npz", "mhd", "mha"))
            magic = {"npy": b"\x93NUMPY\x01\x00", "npz": b"PK\x03\x04"}.get(suffix, b"ObjectType = Image\n")
            return suffix, rng.choice((b"", magic)) + rng.randbytes(rng.choice((0, 1, 60, 3000)))
        if kind <= 2:
            return "npy", self._npy(rng)
        if kind == 3:
            return "npz", self._npz(rng)
        if kind <= 5:
            return self._meta(rng)
        suffix, data = rng.choice(self.seeds)
        return suffix, mutated(rng, data)

    def _npy(self, rng):
        """Any header before any data."""
        descr = rng.choice(("|u1", "<u1", "<i4", ">i4", "<i8", ">u2", "<f8", ">f4", "<f2", "|b1", "|O", "<c16", "<U8",
                            "|S3", "<M8[s]", "|V4", "<f16", "u1,i4", "x", ""))
        shape = rng.choice(("(4, 5, 6)", "(120,)", "()", "(0, 3)", "(-4, -30)", "(10**9, 10**9)", "(99999999999, 9)",
                            "(1, 1, 1, 4, 5, 6)", "(4, 5.0, 6)", "('a',)", "4", "(1,) * 99", "(2, 60)", "(True, 120)"))
        header = f"{{'descr': {descr!r}, 'fortran_order': {rng.choice((True, False, 1))}, 'shape': {shape}, }}"
        header = header.encode().ljust(rng.choice((118, 60_000)))
        if rng.random() < 0.2:
            header = mutated(rng, header)
        version = rng.choice((b"\x01\x00", b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x00"))
        size = len(header) if rng.random() < 0.8 else rng.choice((0, 65_535))
        length = min(size, 65_535).to_bytes(2, "little") if version == b"\x01\x00" else size.to_bytes(4, "little")
        data = rng.choice((self._numbers(rng), rng.randbytes(rng.choice((0, 120, 480, 960)))))
        return b"\x93NUMPY" + version + length + header + data

    def _numbers(self, rng):
        dtype = rng.choice(("<f8", ">f4", "<i4", ">i8", "u1"))
        values = rng.choice((np.nan, np.inf, -1.0, 0.0, 300.0, -1e300, 0.5))
        with np.errstate(all="ignore"):
            return np.full(120, values).astype(dtype).tobytes()

    def _npz(self, rng):
        """Archives of anything; zip bombs; sizes that are not true."""
        file, packing = io.BytesIO(), (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_LZMA)
        with zipfile.ZipFile(file, "w", rng.choice(packing)) as z:
            for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
                name = rng.choice(("image.npy", "a.npy", "voxel_size.npy", "../../x.npy", "a", "/etc/x.npy", ".npy"))
                bytes_ = rng.choice((self._npy(rng), self.seeds[0][1], rng.randbytes(50)))
                if rng.random() < 0.1:  # 100 MB of zeros in 100 kB
                    shape = rng.choice(((100, 1000, 1000), (10**5, 10**3), (99, 1000, 1000)))
                    head = io.BytesIO()
                    np.lib.format.write_array_header_1_0(
                        head, {"descr": "|u1", "fortran_order": False, "shape": shape})
                    bytes_ = head.getvalue() + b"\0" * 10**8
                z.writestr(name, bytes_)
        data = file.getvalue()
        return mutated(rng, data) if rng.random() < 0.5 else data

    def _meta(self, rng):
        suffix = rng.choice(("mhd", "mha"))
        local = suffix == "mha" or rng.random() < 0.2
        lines = {
            "ObjectType": "Image", "NDims": rng.choice(("3", "3", "2", "-1", "nan", "99999999999999999999")),
            "BinaryData": rng.choice(("True", "False", "x")),
            "BinaryDataByteOrderMSB": rng.choice(("True", "False")),
            "CompressedData": rng.choice(("False", "False", "True")),
            "HeaderSize": rng.choice(("0", "0", "-1", "-5", "10", "99999999999", "x")),
            "ElementSpacing": rng.choice(("1 1 1", "nan 1 1", "0 1 1", "-1 1 1", "1", "1e400 1 1", "a b c")),
            "DimSize": rng.choice(("6 5 4", "6 5 4", "-6 -5 4", "6 5", "0 5 4", "1000000 1000000 1000000", "6.0 5 4",
                                   "99999999999999999999 2 2", "2147483648 2 2", " ".join("1" * 300))),
            "ElementType": rng.choice(("MET_UCHAR", "MET_UCHAR", "MET_FLOAT", "MET_DOUBLE", "MET_SHORT", "MET_X")),
            "ElementNumberOfChannels": rng.choice(("1", "3")),
            "ElementDataFile": "LOCAL" if local else rng.choice(
                ("seed.raw", "seed.raw", "nothing.raw", "/dev/zero", ".", "../seed.raw", "LIST", "s%03d.raw 1 9",
                 "a\0b", "x" * 5000)),
        }
        for key in rng.sample(sorted(lines), rng.choice((0, 0, 1, 3))):
            del lines[key]
        text = "".join(f"{k} = {v}\n" for k, v in lines.items()).encode()
        if rng.random() < 0.3:
            text = mutated(rng, text)
        data = rng.choice((self.raw, zlib.compress(self.raw), self._numbers(rng), b"", zlib.compress(b"\0" * 10**7)))
        return suffix, text + data if local else text

    def use(self, path):
        for grey in (False, True):
            found = read_image(path, grey=grey)
            assert found.values.ndim in (2, 3) and found.values.size
            assert found.values.dtype.kind != "f" or not np.isnan(found.values).any()
        values = np.unique(found.values.ravel()[:10_000])
        if found.values.dtype.kind in "bu":
            labels = {"solid": int(values[0]), "water": [int(v) for v in values[1:]]}
            apply_labels(found.values, labels, ["water"], path)


class Formats(Images):
    """The formats that libraries read: TIFF, raw, NRRD, HDF5, VTI, VTK, PNG, BMP, MATLAB and Palabos text."""

    def __init__(self, folder):
        import h5py
        import meshio  # noqa: F401  # what others of the package bring along counts as memory before
        import tifffile
        from PIL import Image
        from scipy import io as matlab

        from isphcli.output.grid import Grid, write_vti

        values = np.random.default_rng(0).integers(0, 3, (4, 5, 6), dtype=np.uint8)
        at = folder / "formats"
        at.mkdir()
        write_image(at / "a.tif", values, (1e-6, 1e-6, 2e-6))
        tifffile.imwrite(at / "b.tif", values.astype(np.uint16), compression="zlib", bigtiff=True)
        write_image(at / "a.nrrd", values, (1e-6, 1e-6, 2e-6))
        with h5py.File(at / "a.h5", "w") as file:
            file.create_dataset("image", data=values, chunks=(2, 5, 6), compression="gzip")
        write_vti(at / "a.vti", Grid(np.zeros(3), np.full(3, 1e-6), {"solid": values}))
        head = ("# vtk DataFile Version 3.0\nrock\nBINARY\nDATASET STRUCTURED_POINTS\nDIMENSIONS 6 5 4\nORIGIN 0 0 0\n"
                "SPACING 1e-6 1e-6 1e-6\nPOINT_DATA 120\nSCALARS rock unsigned_char 1\nLOOKUP_TABLE default\n")
        (at / "a.vtk").write_bytes(head.encode() + values.tobytes())
        for suffix in ("png", "bmp"):
            Image.fromarray(values.repeat(8, 1).repeat(8, 2)[0]).save(at / f"a.{suffix}")
        matlab.savemat(at / "a.mat", {"rock": values})
        (at / "a.dat").write_text(" ".join(map(str, values.ravel())))
        self.seeds = [(path.suffix[1:], path.read_bytes()) for path in sorted(at.iterdir())]
        self.raw = values.tobytes()

    def make(self, rng):
        suffix, data = rng.choice([*self.seeds, ("raw", self.raw)])
        if rng.random() < 0.1:
            return suffix, data[: rng.choice((0, 4, 16))] + rng.randbytes(rng.choice((0, 60, 3000)))
        if suffix in ("nrrd", "vti", "vtk", "dat") and rng.random() < 0.5:
            return suffix, evil_words(rng, data.decode("latin-1")).encode("latin-1", "replace")
        return suffix, mutated(rng, data)

    def use(self, path):
        if path.suffix == ".raw":
            read_image(path, layout=Layout(shape=(6, 5, 4)))
        else:
            super().use(path)


class Dumps:
    """Dumps of LAMMPS and LIGGGHTS."""

    def __init__(self, folder):
        rows = "".join(f"{k} 1 {k}.5 2e-3 -3.25 {k + 1}\n" for k in range(20))
        self.seed = ("ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n20\nITEM: BOX BOUNDS pp pp pp\n0 25\n-1 1\n-4 0\n"
                     f"ITEM: ATOMS id type x y z radius\n{rows}").encode()

    def make(self, rng):
        return "dump", mutated(rng, self.seed) if rng.random() < 0.5 else evil_words(rng, self.seed.decode()).encode()

    def use(self, path):
        centres, radii = read_spheres(path)
        assert np.isfinite(centres).all() and (np.asarray(radii) > 0).all()


class Spheres:
    def __init__(self, folder):
        self.seed = b"x,y,z,radius\n" + b"".join(b"%d.5,2e-3,-3.25,%d\n" % (k, k + 1) for k in range(20))

    def make(self, rng):
        if rng.random() < 0.1:
            return "csv", rng.randbytes(rng.choice((0, 10, 500)))
        seed = self.seed
        return "csv", mutated(rng, seed) if rng.random() < 0.5 else evil_words(rng, seed.decode()).encode()

    def use(self, path):
        centres, radii = read_spheres(path)
        assert np.isfinite(centres).all() and (np.asarray(radii) > 0).all()


class Restarts:
    def __init__(self, folder):
        rng = np.random.default_rng(0)
        self.state = State(rng.random((5, 2)), rng.random((5, 2)), rng.random((5, 2)), rng.random(5), 0.5, 3, 0.1)
        restart.save(folder / "seed.npz", restart.Saved(self.state, {"pressure": (self.state, 0.1, 3)}, ((0.1, 0.2),)))
        self.seed = (folder / "seed.npz").read_bytes()

    def make(self, rng):
        return "npz", mutated(rng, self.seed) if rng.random() < 0.9 else rng.randbytes(rng.choice((0, 10, 500)))

    def use(self, path):
        assert np.array_equal(restart.load(path, self.state).state.x, self.state.x)


KINDS = {"cases": (Cases, 5), "images": (Images, 4), "formats": (Formats, 4), "spheres": (Spheres, 1),
         "dumps": (Dumps, 1), "restarts": (Restarts, 1)}


class Hang(BaseException):
    """The alarm of an input."""


def ring(*_):
    raise Hang


def peak():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=KINDS)
    parser.add_argument("--keep", type=Path, help="where inputs that fail are kept")
    asked = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="isph-bad-"))
    kinds = {name: value for name, value in KINDS.items() if asked.only in (None, name)}
    makers = {name: cls(folder) for name, (cls, _) in kinds.items()}
    names, weights = list(kinds), [weight for _, weight in kinds.values()]
    os.chdir(folder)
    (folder / "warm.yaml").write_text(SMALL)
    makers.get("cases") and makers["cases"].use(folder / "warm.yaml")  # compiles and imports
    now = int(re.search(r"VmSize:\s+(\d+)", Path("/proc/self/status").read_text(encoding="utf-8"))[1]) * 1024
    resource.setrlimit(resource.RLIMIT_AS, (now + LIMIT, now + LIMIT))
    signal.signal(signal.SIGALRM, ring)
    warnings.filterwarnings("ignore", "Duplicate name")  # of the archives that are made here
    rng, count, slowest, before, start = random.Random(asked.seed), Counter(), (0.0, ""), peak(), time.monotonic()
    for k in range(asked.count):
        name = rng.choices(names, weights)[0]
        suffix, data = makers[name].make(rng)
        path = folder / f"input.{suffix}"
        path.write_bytes(data)
        begun = time.monotonic()
        try:
            signal.setitimer(signal.ITIMER_REAL, SECONDS)
            makers[name].use(path)
            outcome = "valid objects"
        except CLEAN:
            outcome = "clean errors"
        except Hang:
            outcome, text = "hangs", traceback.format_exc(limit=6)
        except MemoryError:
            outcome, text = "memory errors", traceback.format_exc(limit=-4)
        except BaseException:
            outcome, text = "tracebacks", traceback.format_exc(limit=-4)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        if outcome not in ("valid objects", "clean errors"):
            print(f"\ninput {k} of seed {asked.seed}, {name}: {outcome}\n{text}", flush=True)
            if asked.keep:
                asked.keep.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, asked.keep / f"{k}.{suffix}")
        slowest = max(slowest, (time.monotonic() - begun, f"input {k}, {name}"))
        count[name, outcome] += 1
    shutil.rmtree(folder)
    outcomes = ("clean errors", "valid objects", "tracebacks", "memory errors", "hangs")
    print(f"{'':10}" + "".join(f"{o:>15}" for o in outcomes))
    for name in (*names, "all"):
        print(f"{name:10}" + "".join(
            f"{sum(n for (m, q), n in count.items() if q == o and name in (m, 'all')):>15}" for o in outcomes))
    print(f"{time.monotonic() - start:.0f} s, slowest {slowest[0]:.2f} s ({slowest[1]}); "
          f"memory {before / 1e6:.0f} MB before, peak {peak() / 1e6:.0f} MB")
    return any(n for (_, o), n in count.items() if o in outcomes[2:])


if __name__ == "__main__":
    sys.exit(main())
