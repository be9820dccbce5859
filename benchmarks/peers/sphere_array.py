"""What the scripts of the sphere array share: its geometry, the published drag, and the rows that they print."""

import math
import sys
from collections.abc import Callable
from importlib.metadata import version

DRAG = {0.216: 7.442, 0.45: 28.1}  # K of Zick and Homsy (1982), table 2: {solid fraction: drag over that of Stokes}


def radius_of(fraction: float) -> float:
    """Of the sphere in a cell of side 1."""
    return (3 * fraction / (4 * math.pi)) ** (1 / 3)


def print_rows(code: str, permeability: Callable[[float, int], tuple[float, float]]) -> None:
    """Prints a row of isphcli/data/peers.csv for each solid fraction and number of cells of the command line.

    code: name of the package; permeability: of a solid fraction and a number of cells along a side, k over the square
    of the cell and the CPU seconds that it took.
    """
    for fraction, drag in DRAG.items():
        exact = 1 / (6 * math.pi * radius_of(fraction) * drag)
        for cells in map(int, sys.argv[1:] or (16, 32)):
            k, seconds = permeability(fraction, cells)
            print(f"{code},{version(code)},sphere_array,fraction={fraction},{cells},permeability_relative,"
                  f"{k / exact - 1:.4g},{seconds:.3g}", flush=True)  # fmt: skip
