"""Bodies whose permeability is known, as images: for walls_from_labels.py and scanner.py, which import it.

`RandomBody`: a periodic Gaussian random field with the covariance exp(-r^2 / (2 correlation^2)), fluid where it is
below its quantile `porosity`. It is a sum of waves, so that it is known exactly between the voxels. Its truth is k of
the field sampled twice finer than the voxels, with three particles a voxel. `Spheres`: a simple cubic array at a place
between the voxels, truth of Zick and Homsy 1982. Lengths are voxels, of 1 m.
"""

import os
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

from isphcli.case.forcing import drives
from isphcli.case.load import load_case
from isphcli.geometry.iso_surface import IsoSurfaceGeometry
from isphcli.output.clock import Clock
from isphcli.references.arrays import sphere_array_permeability
from isphcli.run.steady import build_scene, solve_axis

CASE = load_case(Path(__file__).parents[1] / "cases" / "grey_blobs.yaml")
ROUND = (True, True, True)
FINER = 4  # cells a voxel of which partial volumes are counted


@dataclass(frozen=True)
class RandomBody:
    """n^3 voxels; correlation in voxels; porosity: share of the fluid."""

    correlation: float
    porosity: float
    seed: int
    n: int = 20

    @property
    def name(self):
        return f"random, {self.correlation:g} voxels, porosity {self.porosity:.2f}, seed {self.seed}"

    def field(self, up=1):
        """Field [z, y, x], > 0 in fluid, on the centres of `up` cells a voxel and side."""
        n, rng = self.n, np.random.default_rng(self.seed)
        q = np.fft.fftfreq(n)
        square = q[:, None, None] ** 2 + q[:, None] ** 2 + q**2
        modes = np.fft.fftn(rng.standard_normal((n,) * 3)) * np.exp(-((np.pi * self.correlation) ** 2) * square)
        modes[(np.abs(q) == 0.5), :, :] = modes[:, np.abs(q) == 0.5, :] = modes[:, :, np.abs(q) == 0.5] = 0.0
        place = (np.arange(n * up) + 0.5) / up - 0.5  # of the centres, from that of the first voxel
        wave = np.exp(2j * np.pi * np.outer(place, q))
        field = np.einsum("abc,za,yb,xc->zyx", modes, wave, wave, wave, optimize=True).real / n**3
        coarse = np.fft.ifftn(modes).real
        return ((np.quantile(coarse, self.porosity) - field) / coarse.std()).astype(np.float32)

    def truth(self):
        fine = self.field(2)
        return permeability(IsoSurfaceGeometry(labels_of(fine), fine, 0.5, ROUND), 3)


@dataclass(frozen=True)
class Spheres:
    """One solid sphere of a simple cubic array of a solid fraction, `n` voxels a cell, its centre between voxels."""

    fraction: float
    n: int

    @property
    def name(self):
        return f"spheres, fraction {self.fraction:g}, {self.n} voxels a cell"

    def field(self, up=1):
        place = (np.arange(self.n * up) + 0.5) / up
        radius = self.n * (3.0 * self.fraction / (4.0 * np.pi)) ** (1.0 / 3.0)
        z, y, x = np.meshgrid(*(np.abs(place - self.n / 2.0 - c) for c in (0.13, -0.21, 0.34)), indexing="ij")
        # across the faces of the cell the next sphere is nearer
        square = sum(np.minimum(a, self.n - a) ** 2 for a in (z, y, x))
        return (np.sqrt(square) - radius).astype(np.float32)

    def truth(self):
        return sphere_array_permeability(self.fraction, float(self.n))


def labels_of(field):
    return np.where(field > 0, np.int8(0), np.int8(-1))


def partial_volumes(body):
    """Share of fluid in the voxels of a body, as a field from -1 (solid) to 1."""
    n, up = body.n, FINER
    fine = np.where(body.field(up) > 0, np.float32(1), np.float32(-1))
    return fine.reshape(n, up, n, up, n, up).mean(axis=(1, 3, 5))


def permeability(geometry, per_voxel):
    """k along x, in square voxels, with `per_voxel` particles a voxel of 1 m."""
    (axis, force), *_ = drives(CASE, geometry)
    clock = Clock()
    scene = build_scene(CASE, geometry, 1.0 / per_voxel, clock, (0,))
    return solve_axis(CASE, scene, axis, force, clock).permeability[0]
