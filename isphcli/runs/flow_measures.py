"""Measures of a flow beside its permeability: tortuosity, speeds, wall shear, effective diffusivity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce
from ..geometry.extents import part_of_sample, sections
from ..geometry.protocol import sample_box
from ..geometry.wall_normals import wall_normals

if TYPE_CHECKING:
    from ..domain.lattice import Lattice
    from ..geometry.protocol import Geometry

SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)  # shares of the fluid, slowest first: the quantiles of the speed in the summary
# Wall distances over the spacing of the particles whose shear is that of the wall: one layer, so that all parts of a
# wall count alike, and none so near that the error of its speed is divided by a small distance
LAYER = (0.3, 1.3)


def tortuosity(velocity: np.ndarray, axis: int, part: np.ndarray | None = None) -> float | None:
    """Mean length of the paths of the fluid over that of the sample: mean speed over mean velocity along the axis
    (Koponen, Kataja and Timonen 1996, Phys. Rev. E 54, 406; Duda, Koza and Matyka 2011, Phys. Rev. E 84, 036319).

    velocity: (n, dim) m/s, of equal volumes; part: (n,) of each in the sample, None: all. None where nothing flows
    along the axis.
    """
    if not (reduce.number(velocity) if part is None else reduce.any_true(part > 0.0)):
        return None
    along = abs(float(reduce.mean(velocity[:, axis], part)))
    speed = float(reduce.mean(np.linalg.norm(velocity, axis=1), part))
    return speed / along if along > 1e-12 * speed else None


def speed_distribution(velocity: np.ndarray, part: np.ndarray,
                       cells: tuple[np.ndarray, np.ndarray, float] | None = None) -> dict[str, float] | None:
    """`mean` of the speed, m/s, and its quantiles `q05` to `q95`: the speed that this share of the fluid stays below.
    velocity: (n, dim) m/s, of equal volumes; part: (n,) of each in the sample: those of a half and more have a place
    among the quantiles; cells: means (m, dim) m/s over all cells, their parts (m,), and the volume of the fluid over
    that of a cell, by which the mean is an integral. None without fluid."""
    if not reduce.any_true(part >= 0.5):
        return None
    speed = np.linalg.norm(velocity, axis=1)
    quantiles = reduce.quantiles(speed[part >= 0.5], SHARES)
    if cells is None:
        mean = float(reduce.mean(speed, part))
    else:
        mean = float(reduce.dot(np.linalg.norm(cells[0], axis=1), cells[1])) / cells[2]
    return {"mean": mean, **{f"q{100 * s:02.0f}": float(q) for s, q in zip(SHARES, quantiles)}}


def wall_stress(geometry: Geometry, x: np.ndarray, velocity: np.ndarray, laplacian: np.ndarray,
                scale: tuple[float, float]) -> tuple[np.ndarray, np.ndarray] | None:
    """(positions (m, dim) m, shear stress (m,) Pa) of the particles beside walls.

    x, velocity: (n, dim) m, m/s; laplacian: (n, dim) of the velocity, 1/(m s); scale: spacing, m, and dynamic
    viscosity, Pa s. Of the particles within LAYER of a wall, tangential to it: with u(d) = s d + lap u d^2 / 2 the
    slope at the wall is s = u/d - lap u d/2, exact for parabolas. None where walls move or slip, or there is no such
    particle.
    """
    spacing, viscosity = scale
    if not geometry.has_solid or np.any(geometry.wall_speed) or np.any(geometry.slip_length > 0.0):
        return None
    distance = geometry.distance(x) / spacing
    near = (distance > LAYER[0]) & (distance <= LAYER[1])
    if not reduce.any_true(near):
        return None
    d, normal = distance[near, None] * spacing, wall_normals(geometry, x[near], spacing)
    slope = velocity[near] / d - 0.5 * d * laplacian[near]
    slope -= np.einsum("nk,nk->n", slope, normal)[:, None] * normal
    return x[near], viscosity * np.linalg.norm(slope, axis=1)


def wall_shear(stress: np.ndarray | None) -> dict[str, float] | None:
    """`mean`, `median` and `q95` of the shear stress (m,) of `wall_stress`, Pa; None without one."""
    if stress is None:
        return None
    median, high = reduce.quantiles(stress, (0.5, 0.95))
    return {"mean": float(reduce.mean(stress)), "median": float(median), "q95": float(high)}


def profile_rows(geometry: Geometry, x: np.ndarray, flow: tuple[np.ndarray, np.ndarray], axis: int, drop: float,
                 scale: tuple[float, float, float]) -> list[dict[str, float | None]]:
    """A dict per layer across an axis, from the lower end of the box on: its middle along the axis, m, mean pressure,
    Pa, None without fluid, and superficial velocity, m/s.

    x: (m, dim) m, of cells; flow: velocity (m, dim) m/s, mean over them, and pressure (n,) Pa of the first n; drop:
    over the box, Pa, that drives the flow: it falls along the axis beside the pressure of the particles; scale:
    thickness of a layer, m, volume of a particle, m^dim, and its extent along the axis, m (`Lattice.thick`): each layer
    has the part of it that lies within.
    """
    velocity, pressure = flow
    thickness, volume, thick = scale
    size, n = geometry.upper - geometry.lower, len(pressure)
    count = max(1, round(float(size[axis]) / thickness))
    ends = float(geometry.lower[axis]), float(geometry.upper[axis])
    layer, who, part = sections(x[:, axis], thick, ends, count, geometry.periodic[axis])
    flux = reduce.total_by(layer, part * velocity[who, axis], count) * (volume * count / float(np.prod(size)))
    layer, who, part = sections(x[:n, axis], thick, ends, count, False)  # the pressure is not periodic
    fall = drop * (x[:n, axis] - geometry.lower[axis]) / size[axis]
    number = reduce.total_by(layer, part, count)
    total = reduce.total_by(layer, part * (pressure - fall)[who], count)
    return [{"xyz"[axis]: float(geometry.lower[axis] + (k + 0.5) * size[axis] / count),
             "pressure": float(total[k] / number[k]) if number[k] else None, "superficial_velocity": float(flux[k])}
            for k in range(count)]


def effective_diffusivity(geometry: Geometry, x: np.ndarray, flux: np.ndarray, cells: float, lattice: Lattice,
                          axis: int) -> float:
    """Diffusivity of the sample over that of the fluid along an axis; the formation factor is its inverse.

    x: (n, dim) m; flux: (n, dim) of a unit gradient over the whole box (`flow.diffusion`); cells: volume of the fluid
    in the sample over that of a site of the lattice. Clear layers are resistances in series, which are subtracted.
    """
    lower, upper = sample_box(geometry)
    part = part_of_sample(geometry, x, lattice.thick)
    if not reduce.any_true(part > 0.0):
        return 0.0
    porosity = cells * lattice.site_volume / float(np.prod(upper - lower))
    mean = float(reduce.mean(flux[:, axis], part)) * porosity
    length, sample = float((geometry.upper - geometry.lower)[axis]), float((upper - lower)[axis])
    left = length - mean * (length - sample)  # of the drop, over the sample
    return mean * sample / left if left > 0.0 else 0.0
