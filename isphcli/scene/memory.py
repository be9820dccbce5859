"""The memory that a scene needs and that the machine has left; a scene too large is refused before it is allocated."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..domain.communicator import current
from ..domain.lattice import MOST, ParticleError

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.protocol import Geometry

PAIRS = {2: 2.72, 3: 3.46}  # neighbours over support^dim at one site a spacing^dim: 32 in 3D at 2.1
# Bytes per pair by flow and walls. stokes: 10 of its row; navier_stokes, with BYTES_MATRIX, from the peaks of three
# steps less BYTES_PROGRAM: 2.4 kB per particle of a cube without walls, 4.2 to 4.8 beside walls
# (benchmarks/moving_memory.py, 2026-12-01)
BYTES_PAIR = {
    ("stokes", True): 10,
    ("stokes", False): 10,
    ("navier_stokes", True): 106,
    ("navier_stokes", False): 33,
}
# Bytes per neighbour of moving particles, also behind a wall or a dummy: its row and its column
BYTES_NEIGHBOUR = 8
# Bytes per pair in matrices and hierarchies. stokes: with the rest 1.7 kB per particle off walls; the peaks were 1.68
# (sphere array of 64 spacings), 1.92 (Berea 128^3, 46 iterations) and 2.28 kB (bead pack, 56): benchmarks/memory.py,
# 2026-11-29
BYTES_MATRIX = {"stokes": 14, "navier_stokes": 12}
# Bytes per pair where PETSc solves: hypre stores the matrix that PyAMG's cycle computes from pairs. An eighth of table
# 1 of the paper and Berea 64^3 on two processes held 0.70 and 0.39 GB each (benchmarks/memory.py, 2026-11-30)
BYTES_PETSC = 26
# Bytes per pair that a second fluid adds to moving particles, by walls: weighted operators, transposed stress, normals.
# Of 3D cubes of 50 spacings with a drop of ten times the density and viscosity a particle takes 7.6 kB, beside walls
# 11.4 (scene "drop" of benchmarks/step_cost.py, 2026-12-01; 6.9 and 10.2 are said); in rock 8.2, for which 9.4 are said
BYTES_SECOND_FLUID = {False: 130, True: 160}
BYTES_ROW = {"stokes": 350, "navier_stokes": 0}  # bytes per particle, beside its pairs
# Krylov vectors of a steady solve: 18 to 30 in wide pores, 46 to 56 in rock and packs of beads; those of a long restart
# are allocated but never touched
VECTORS = 40
# Krylov vectors that a refusal may ask to make do with, at least. With 10 a 64^3 corner of Berea takes 28 iterations
# for 26, the coarsest pack of beads 125 for 82 (docs/performance.md, memory of a steady solve)
FEWEST = 10
# Bytes per particle of the second solve of `refine: throats`, own and remote ones, most of them of its pairs, beside
# what the first solve takes: 4.8 kB of 148,100 in a 64^3 corner of Berea, whose peak is 1.13 GB (isph run
# cases/berea.yaml with that crop, refine=throats and without pictures, at 653967bb, 2026-11-30)
BYTES_TWO_SPACINGS = 5_000
BYTES_PARTICLE = 200  # bytes per particle of any kind: positions, fields and work arrays
# Bytes per voxel while a geometry is built, from the peaks of random bodies of 64^3 to 192^3 voxels at 47588b5: labels
# 39 to 44 (of which 32 to 35 stay), grey values 36 to 48 (sharpened too), `wall_distance: stairs` 19 to 23
BYTES_VOXEL = 40
# Bytes of Python and its libraries: peaks of runs of 64 and 1024 particles without pictures (cases/couette.yaml and
# taylor_green_2d.yaml, 2026-11-30)
BYTES_PROGRAM = 2.3e8
SAMPLE = 10_000  # random points at which the fluid of a lattice, and round particles, is counted before it is placed
CROP = "take a part with geometry.voxels.crop, or a coarser image (isph convert-voxels --downsample)"


def too_large(case: Case) -> str:
    """What to do about a scene that does not fit."""
    image = ", or a part of the image with geometry.voxels.crop" if case.geometry.voxels is not None else ""
    listed = isinstance(case.refine, tuple) and bool(case.refine)  # auto and throats go by particles.spacing
    return f"take a larger particles.spacing{' and refine' if listed else ''}{image}"


def density(case: Case, dim: int) -> float:
    """Sites of the lattice of a case in a volume of spacing^dim."""
    return {"bcc": 2.0, "hexagonal": 2 / 3**0.5}.get(case.lattice_in(dim), 1.0)


def neighbours(case: Case, dim: int) -> float:
    """Neighbours of a particle on the lattice of a case."""
    return PAIRS[dim] * density(case, dim) * case.support**dim


def neighbours_held(case: Case, geometry: Geometry, x: np.ndarray, spacing: float) -> float:
    """Of the neighbours that fluid particles x (n, dim) of a spacing, m, would have in a box full of fluid, the share
    whose weights are held: those that are fluid; of moving particles those of them that no wall hides. (The bytes of
    steady flow were measured per fluid neighbour.)"""
    if not geometry.has_solid or not len(x):
        return 1.0
    reach, rng = case.support * spacing, np.random.default_rng(0)
    chosen = x[rng.integers(len(x), size=SAMPLE)]
    offset = rng.normal(size=chosen.shape)
    offset *= (reach * rng.random(len(chosen)) ** (1 / geometry.dim) / np.linalg.norm(offset, axis=1))[:, None]
    held = geometry.phase(chosen + offset) >= 0
    if case.flow != "stokes":
        held[held] = geometry.crossing(chosen[held], (chosen + offset)[held]) >= 1.0
    return float(held.mean())


def estimate(case: Case, dim: int, walls: bool, fluid: float, dummies: float, two: bool = False,
             share: float = 1.0) -> dict[str, float]:
    """Bytes by part at the peak of a run with so many fluid particles and dummies, without its image.

    two: particles of two fluids that differ or have an interface; share: see `neighbours_held`. Of all other neighbours
    moving particles store row and column only: BYTES_NEIGHBOUR.
    """
    steady = case.flow == "stokes"
    pairs = fluid * neighbours(case, dim) * share
    petsc = steady and (case.solver.engine == "petsc" or current().size > 1)
    vectors = min(case.solver.restart, VECTORS) * (dim + 1) if steady else case.solver.restart
    parts = {
        "program": BYTES_PROGRAM,
        "operators": pairs * BYTES_PAIR[case.flow, walls] + fluid * BYTES_ROW[case.flow] + (
            0.0 if steady else fluid * neighbours(case, dim) * BYTES_NEIGHBOUR),
        "matrices": pairs * (BYTES_PETSC if petsc else BYTES_MATRIX[case.flow]),
        "Krylov vectors": fluid * vectors * (4 if steady else 8),
        "particles": (fluid + dummies) * BYTES_PARTICLE,
    }
    if two and not steady:
        parts["second fluid"] = pairs * BYTES_SECOND_FLUID[walls]
    return parts


def refuse_lattice(case: Case, geometry: Geometry, spacing: float) -> None:
    """Raises ParticleError where the particles of a lattice that is still to be placed will not fit.

    The fluid is counted at SAMPLE points of the box: to place 1e9 sites takes minutes and all the memory.
    """
    if geometry.voxel_size is not None and geometry.labels is None:  # an image by parts: `refuse_pores` has counted
        return
    size = geometry.upper - geometry.lower
    sites = float(np.prod(size / spacing))
    if not 100 * SAMPLE <= sites < 10.0**MOST:  # quickly placed, or refused in any case: box and spacing do not fit
        return
    points = geometry.lower + np.random.default_rng(0).random((SAMPLE, geometry.dim)) * size
    phase = geometry.phase(points)
    fluid = sites * float((phase >= 0).mean())
    share = neighbours_held(case, geometry, points[phase >= 0], spacing)
    need = estimate(case, geometry.dim, geometry.has_solid, fluid, 0, two=len(np.unique(phase[phase >= 0])) > 1,
                    share=share)
    need = {part: of_this_machine(size) for part, size in need.items()}
    refuse_flow(case, need, f"about {fluid:.3g} fluid particles")


def of_this_machine(need: float) -> float:
    """Bytes that the processes on this machine need, of those that all processes of a scene need."""
    return need * current().here / current().size


def refuse_image(case: Case) -> None:
    """Raises ParticleError where the wall distances of an image will not fit, by its header: before it is read."""
    from ..geometry.images.read import image_shape
    from .image_file import layout_of

    spec = case.geometry.voxels
    assert spec is not None
    shape = image_shape(spec.file, layout=layout_of(spec))
    if shape is None:  # the reader of the file reports what is wrong with it
        return
    voxels = math.prod(shape)
    if spec.crop is not None:
        voxels = min(voxels, math.prod(max(end - first, 0) for first, end in spec.crop))
    voxels *= 2 ** len(case.geometry.mirror)
    refuse(of_this_machine(voxels * BYTES_VOXEL), f"{spec.file}: the wall distances of {voxels:,} voxels", CROP)


def refuse_pores(case: Case, dim: int, voxel_size: np.ndarray, voxels: tuple[int, int], two: bool) -> None:
    """Raises ParticleError where the particles in the pores of an image will not fit: before its wall distances.

    voxel_size: m, one or one per axis; voxels: numbers of all, and of those of fluid, clear layers included; two: they
    hold two fluids.
    """
    spacing = min(case.spacings) if case.flow == "stokes" else case.particles.spacing
    sizes = np.broadcast_to(voxel_size[:dim] if len(voxel_size) > 1 else voxel_size, (dim,))
    particles = float(np.prod(sizes / spacing)) * density(case, dim)  # of a voxel of pore
    sites = voxels[0] * particles
    if not 100 * SAMPLE <= sites < 10.0**MOST:  # as in refuse_lattice
        return
    fluid = voxels[1] * particles
    need = {**estimate(case, dim, True, fluid, 0, two=two), "image": voxels[0] * BYTES_VOXEL}
    need = {part: of_this_machine(size) for part, size in need.items()}
    refuse_flow(case, need, f"about {fluid:.3g} fluid particles")


def refuse_flow(case: Case, need: dict[str, float], what: str) -> None:
    """Raises ParticleError where the bytes of `estimate`, of all processes on this machine, are more than it has left.

    A steady solve can do with fewer Krylov vectors. It does not choose them by the memory that happens to be free, by
    which its last digits would depend on other programs: the message says how many fit.
    """
    fix, left = too_large(case), available()
    vectors = need["Krylov vectors"]  # none of a process that has no particles, and where no sampled site is fluid
    if case.flow == "stokes" and vectors > 0.0:
        held = min(case.solver.restart, VECTORS)
        fit = math.floor(held * (1.0 - (sum(need.values()) - left) / vectors))
        if FEWEST <= fit < held:
            fix = f"take solver.restart {fit} (fewer Krylov vectors, more iterations), or {fix.removeprefix('take ')}"
    refuse(sum(need.values()), what, fix, left)


def refuse(need: float, what: str, fix: str, left: float | None = None) -> None:
    """Raises ParticleError where `need` bytes for `what` are more than the machine has left (`left`, asked without)."""
    left = available() if left is None else left
    if need > left:
        raise ParticleError(f"{what} need about {need / 1e9:.3g} GB of memory, {left / 1e9:.3g} GB are free; {fix}")


def available() -> float:
    """Bytes that can be had without swapping."""
    import psutil

    return float(psutil.virtual_memory().available)
