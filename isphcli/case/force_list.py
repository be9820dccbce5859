"""The list of forces that a case may have beside its drive, `FORCES`: the name, constructor and checks of each.

A new force is its key in case/blocks.py and one entry of `FORCES`, with the functions that the entry names. All other
code uses the list: both flows, the check of the case, the limits of steps, and `terms` of summary.json. The drive
itself, that is uniform forces, held velocities and formulas of time, is read in case/forcing.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..flow.forces import Force

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry
    from .blocks import Case

Problems = Iterator[tuple[str, str, str]]  # (path of a key, what is wrong, what to do)


class Known(NamedTuple):
    """An entry of the list.

    name: of the term, as of `Force`; make: the force of a case in its geometry, None where the case has none; wrong:
    what must hold between the keys, of a case and its dimension, None before an image is read; without: why a case has
    none, for `isph validate --check-only`.
    """

    name: str
    make: Callable[[Case, Geometry], Force | None]
    wrong: Callable[[Case, int | None], Problems]
    without: str


def _microporous(case: Case, geometry: Geometry) -> Force | None:
    """Brinkman's drag -nu / k u of rock whose pores are too small to be resolved, of permeability k."""
    if not case.microporous:
        return None
    inverse = np.array([*(1.0 / rock.permeability for rock in case.microporous.values()), 0.0])  # the last: clear fluid
    words = ", ".join(f"{name} of {rock.permeability:g} m2" for name, rock in case.microporous.items())
    return Force(MICROPOROUS, words, resistance=lambda x: inverse[geometry.microporous(x)])


def _wrong_microporous(case: Case, dim: int | None) -> Problems:
    if not case.microporous:
        return
    if case.flow != "stokes":
        yield "microporous", "needs flow: stokes", "remove it, or solve for the steady flow"
    if case.measure:
        yield "measure", "knows no microporous rock, whose resistance to diffusion is not given", "remove it"
    for name, rock in case.microporous.items():
        if case.particles.spacing**2 / rock.permeability > MOST_DRAG:
            least = case.particles.spacing**2 / MOST_DRAG
            yield ("microporous", f"{name} is too tight for the spacing, which admits {least:.2g} m2 and more",
                   "call it solid, or take a smaller particles.spacing")
        if name in (*case.fluids, "solid"):
            yield "microporous", f"{name} is the name of a fluid or of solids", "give it another name"


def _plates(case: Case, geometry: Geometry) -> Force | None:
    """Drag -12 nu / depth^2 u of two plates, u the mean over their distance (Hele-Shaw 1898)."""
    depth = case.geometry.depth
    if depth is None:
        return None
    return Force(PLATES, f"{depth:g} m apart", resistance=lambda x: np.full(len(x), 12.0 / depth**2))


def _wrong_plates(case: Case, dim: int | None) -> Problems:
    if case.geometry.depth is not None and dim == 3:
        yield "geometry.depth", "is of a 2D scene", "remove it"


PLATES = "drag of two plates"
MICROPOROUS = "microporous drag"
# Square of the spacing over the permeability of microporous rock, at most. Blobs of 30 % of an image of 32^3 voxels
# took 17 iterations at 4, 27 at 40, 59 at 400, and at 4000 missed the tolerance after 800 (trials of 2026-11-29)
MOST_DRAG = 400.0
FORCES = (
    Known(MICROPOROUS, _microporous, _wrong_microporous, "no region is microporous"),
    Known(PLATES, _plates, _wrong_plates, "no geometry.depth"),
)  # fmt: skip


def forces_of(case: Case, geometry: Geometry) -> tuple[Force, ...]:
    """The forces that a case has, in the order of the list."""
    found = (known.make(case, geometry) for known in FORCES)
    return tuple(force for force in found if force is not None)


def wrong_with_forces(case: Case, dim: int | None) -> Problems:
    """Problems of the keys of the forces of a case; dim: of its scene, None before an image is read."""
    for known in FORCES:
        yield from known.wrong(case, dim)
