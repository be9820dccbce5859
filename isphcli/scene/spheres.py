"""Many spheres: placing them at random, and warnings on those of a file."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..domain.halo import build_halo
from ..geometry.bodies import ROUND_OFF, ShapeError, Spheres, count_overlaps, nearest_image
from ..geometry.shape_geometry import ShapeGeometry

TRIES = 2000  # random places tried for each sphere before there is said to be no room
MOST_TRIES = 2_000_000  # for all of them: some seconds
DENSEST = {2: 0.907, 3: 0.741}  # share of space that equal balls can fill at all


def random_spheres(
    geometry: ShapeGeometry, count: int, radius: float, clearance: float = 0.0, seed: int = 0
) -> Spheres:
    """Balls of a radius at random places in the box, no two nearer than `clearance`, nor any to a wall, m.

    Raises ShapeError where not all of them find room.
    """
    rng = np.random.default_rng(seed)
    box, size = geometry.upper - geometry.lower, 2.0 * radius + clearance
    with np.errstate(over="ignore"):
        share = count * np.pi / (2 * geometry.dim) * float(np.prod(size / box))  # of balls with half their clearance
    if share > DENSEST[geometry.dim]:
        raise ShapeError(f"{count} spheres of radius {radius:g} would fill {100 * share:.3g} % of the box with their "
                         f"clearance, and no more than {100 * DENSEST[geometry.dim]:.0f} % can be; ask for fewer or "
                         f"smaller ones")
    centres = np.empty((count, geometry.dim))
    placed = 0
    for _ in range(min(TRIES, max(1, MOST_TRIES // count))):
        places = geometry.lower + rng.random((count, geometry.dim)) * box
        places = places[geometry.distance(places) >= radius + clearance]
        if placed:  # most of those that are too near are found at once
            images = build_halo(centres[:placed], geometry.lower, geometry.upper, np.array(geometry.periodic), size)
            places = places[cKDTree(images.positions(centres[:placed])).query(places)[0] >= size * (1.0 - 1e-9)]
        for place in places:
            apart = np.linalg.norm(nearest_image(centres[:placed] - place, geometry.period), axis=1)
            if (apart >= size).all():
                centres[placed] = place
                placed += 1
                if placed == count:
                    return Spheres(centres, radius)
    raise ShapeError(
        f"only {placed} of {count} spheres of radius {radius:g} found room at random; ask for fewer or smaller ones"
    )


LARGE = 10.0  # radius over the smallest period: a ball has 8000 images then, so lengths must be in another unit


def sphere_findings(
    body: Spheres, lower: np.ndarray, upper: np.ndarray, period: np.ndarray, name: str
) -> tuple[list[str], list[str]]:
    """(facts, warnings) on balls against their box: those outside, wrapped or left out, and those that overlap.

    lower, upper: (dim,) corners, m; period: (dim,) m, infinite along closed axes. Raises ShapeError for balls far
    larger than a periodic box.
    """
    centres = np.atleast_2d(np.asarray(body.centres, float))
    radii = np.broadcast_to(np.asarray(body.radii, float), len(centres))
    facts, odd = [], []
    count, size = len(centres), upper - lower
    if radii.max() > LARGE * period.min():
        raise ShapeError(f"{name}: a radius of {radii.max():g} m in a periodic box of {period.min():g} m; check the "
                         "unit: lengths are in m unless the header names another (x_mm)")  # fmt: skip
    beyond = np.maximum(lower - centres, centres - upper)  # of the centre, along each axis
    closed = ~np.isfinite(period)
    out = (beyond[:, closed] >= radii[:, None]).any(axis=1)
    wrapped = (beyond[:, ~closed] > ROUND_OFF * size[~closed]).any(axis=1) & ~out
    far = ((beyond - radii[:, None] >= 0.0)[:, ~closed]).any(axis=1) & ~out
    if out.any():
        odd.append(f"{name}: {out.sum()} of {count} spheres lie outside the box and are left out; check lengths "
                   "and origin")  # fmt: skip
    if wrapped.any():
        text = f"{wrapped.sum()} of {count} spheres have their centre outside the box and are wrapped into it"
        most = float((beyond / size)[:, ~closed].max())
        if far.any():
            odd.append(f"{name}: {text}, {far.sum()} of them from wholly outside (up to {most:.3g} box lengths); "
                       "check lengths and origin")  # fmt: skip
        else:
            facts.append(text)
    kept = np.flatnonzero(~out)
    pairs, copies, most = count_overlaps(centres[kept], radii[kept], period) if len(kept) > 1 else (0, 0, 0.0)
    if copies:
        facts.append(f"{copies} spheres repeat another one, or its periodic image; they count once")
    if pairs:
        odd.append(f"{name}: {pairs} pairs of spheres overlap, by up to {100 * most:.0f} % of the smaller radius; "
                   "what they share counts once")  # fmt: skip
    return facts, odd
