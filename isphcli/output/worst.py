"""The worst particles of a step or solve that failed, as a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .files import write_vtu

WORST = 50  # particles in worst.vtu
NAME = "worst.vtu"


def write_worst(path: Path, x: np.ndarray, violation: np.ndarray | None, **fields: np.ndarray) -> Path | None:
    """Writes the WORST particles of a step or solve that failed as a VTU; returns its path.

    x: (n, dim) m; violation: (n,) size by which the worst are chosen, or None where it is unknown: then nothing is
    written, and None is returned; fields: further (n,) or (n, dim) values. Raises NotFiniteError where a field is not
    finite.
    """
    if violation is None:
        return None
    largest = np.finfo(float).max
    amount = np.nan_to_num(np.abs(violation), nan=largest, posinf=largest)
    rows = np.argsort(-amount, kind="stable")[:WORST]
    chosen = {name: values[rows] for name, values in fields.items()}
    write_vtu(path, x[rows], {**chosen, "particle": rows, "violation": amount[rows]})
    return path
