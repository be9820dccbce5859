"""Reads the snapshots of a run, of either format."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from .files import read_pvd, read_vtu
from .xdmf import read_h5


def read_series(directory: str | os.PathLike, name: str = "particles") -> list[tuple[float, str]]:
    """(time, file relative to the folder) of each snapshot of a series, of either format; empty without one."""
    folder = Path(directory)
    if (folder / f"{name}.pvd").is_file():
        return read_pvd(folder / f"{name}.pvd")
    if (folder / f"{name}.xdmf").is_file():
        grids = ElementTree.parse(folder / f"{name}.xdmf").iter("Grid")
        return [(float(when.get("Value", "nan")), file.rpartition(":")[0]) for grid in grids
                if (when := grid.find("Time")) is not None
                for file in [next((i.text or "").strip() for i in grid.iter("DataItem") if i.get("Format") == "HDF")]]
    return []


def read_snapshot(path: str | os.PathLike) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (n, 3) and fields of a snapshot of particles, VTU or HDF5."""
    if Path(path).suffix == ".h5":
        return read_h5(path)
    return read_vtu(path)
