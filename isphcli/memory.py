"""What a scene needs of memory, what the machine has left, and a refusal before anything large is allocated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .particles import ParticleError

if TYPE_CHECKING:
    from .case import Case

PAIRS = {2: 2.72, 3: 3.46}  # neighbours over support^dim at one site a spacing^dim: 32 in 3D at 2.1
# Bytes of a pair by flow and walls. stokes: 10 of its row; navier_stokes, which holds two configurations at a time,
# from the peak of runs of 2026-11-22: 6.0 and, with walls, 11.3 kB a particle in 3D
BYTES_PAIR = {
    ("stokes", True): 10,
    ("stokes", False): 10,
    ("navier_stokes", True): 310,
    ("navier_stokes", False): 150,
}
# Of a pair, in matrices and hierarchies. stokes: with the rest 2.85 kB a particle of a full star; the peaks were
# 2.5 to 2.9 (sphere array of 64 and 96 spacings) and 2.6 kB (Berea cube)
BYTES_MATRIX = {"stokes": 40, "navier_stokes": 18}
BYTES_ROW = {"stokes": 250, "navier_stokes": 0}  # of a particle, beside its pairs
VECTORS = 25  # Krylov vectors of a usual steady solve; those of a long restart are allocated but never touched
BYTES_PARTICLE = 200  # positions, fields and work arrays of a particle of any kind
BYTES_VOXEL = 40  # of an image while its wall distance is computed
BYTES_PROGRAM = 2e8  # Python and its libraries


def neighbours(case: Case, dim: int) -> float:
    """Neighbours of a particle on the lattice of a case."""
    density = {"bcc": 2.0, "hexagonal": 2 / 3**0.5}.get(case.lattice_in(dim), 1.0)
    return PAIRS[dim] * density * case.support**dim


def estimate(case: Case, dim: int, walls: bool, fluid: float, dummies: float, voxels: float = 0) -> dict[str, float]:
    """Bytes by part at the peak of a run with so many fluid particles, dummies and voxels."""
    pairs = fluid * neighbours(case, dim)
    steady = case.flow == "stokes"
    vectors = min(case.solver.restart, VECTORS) * (dim + 1) if steady else case.solver.restart
    parts = {
        "program": BYTES_PROGRAM,
        "operators": pairs * BYTES_PAIR[case.flow, walls] + fluid * BYTES_ROW[case.flow],
        "matrices": pairs * BYTES_MATRIX[case.flow],
        "Krylov vectors": fluid * vectors * 8,
        "particles": (fluid + dummies) * BYTES_PARTICLE,
    }
    return parts | ({"image": voxels * BYTES_VOXEL} if voxels else {})


def refuse(need: float, what: str, fix: str) -> None:
    """Raises ParticleError where `need` bytes for `what` are more than the machine has left."""
    left = available()
    if left is not None and need > left:
        raise ParticleError(f"{what} need about {need / 1e9:.3g} GB of memory, {left / 1e9:.3g} GB are free; {fix}")


def available() -> float | None:
    """Bytes that can be had without swapping; None where the system does not tell (not Linux)."""
    try:
        with open("/proc/meminfo") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return float(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return None
