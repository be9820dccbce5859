"""When a step goes wrong: the limits that it must keep, what is tried again, and how a run ends. All of it is here.

1. A linear solve that misses its tolerance is repeated with a new hierarchy (the kept one may be stale), then with
   two cycles of it a call and twice the Krylov vectors and iterations (`kept_hierarchies.RETRY_FACTOR`). A system
   solved with its diagonal alone gets a hierarchy.
2. A step of which a solve has failed, or that breaks one of the `Bounds`, is repeated with half its length and new
   hierarchies, up to HALVINGS times.
3. RunError, exit code 3: the step, the system and its true residual or the limit and its value, and what to try. The
   run leaves the worst particles (worst.vtu) and a restart file of the last good state.

A steady solve (`flow: stokes`) that misses its tolerance is tried again as `StokesSystem.solve` tells, and ends with a
SolveError, exit code 3, and the particles of the largest residuals.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .files import write_vtu

WORST = 50  # particles in worst.vtu
NAME = "worst.vtu"


def write_worst(path: Path, x: np.ndarray, violation: np.ndarray | None, **fields: np.ndarray) -> Path | None:
    """Writes the WORST particles of a step or solve that failed as a VTU; returns its path.

    x: (n, dim) m; violation: (n,) how bad each is, or None where nothing is known: then nothing is written, and None is
    returned; fields: further (n,) or (n, dim) values. Raises NotFiniteError where a field is not finite.
    """
    if violation is None:
        return None
    largest = np.finfo(float).max
    amount = np.nan_to_num(np.abs(violation), nan=largest, posinf=largest)
    rows = np.argsort(-amount, kind="stable")[:WORST]
    chosen = {name: values[rows] for name, values in fields.items()}
    write_vtu(path, x[rows], {**chosen, "particle": rows, "violation": amount[rows]})
    return path
