"""Reads the snapshots of a run, of either format."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from .files import read_pvd, read_vtu
from .xdmf import listed, read_h5


def read_series(directory: str | os.PathLike, name: str = "particles") -> list[tuple[float, str]]:
    """(time, file relative to the folder) of each snapshot of a series, of either format; empty without one."""
    folder = Path(directory)
    if (folder / f"{name}.pvd").is_file():
        return read_pvd(folder / f"{name}.pvd")
    if (folder / f"{name}.xdmf").is_file():
        return [(time, file) for time, file, _ in listed(folder / f"{name}.xdmf")]
    return []


def read_snapshot(path: str | os.PathLike) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) and fields of a snapshot of particles, VTU or HDF5."""
    if Path(path).suffix == ".h5":
        return read_h5(path)
    return read_vtu(path)
