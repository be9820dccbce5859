"""Dummies and their wall data, and from positions to operators with walls. Imported only where there are solids."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..domain import reduce
from ..domain.cut import Share
from ..domain.exchange import NO_EXCHANGE
from ..domain.halo import Halo, build_halo
from ..domain.neighbours import Neighbourhood, find_pairs, neighbourhood
from ..geometry.wall_normals import wall_normals
from .crossings import WallStencils, WallTable, crossings
from .div_grad import adjoint_divergence
from .moments import particle_volumes
from .narrow_pores import classify_neighbourhoods
from .pair_weights import Operators
from .wall_weights import build_wall_operators

if TYPE_CHECKING:
    from ..geometry.protocol import Geometry


class WallChange(Protocol):
    """What makes the walls of a configuration other than those of the geometry (contact_angle.SlipAtLine)."""

    def at(self, phi: np.ndarray) -> WallChange:
        """The change for particles of signed distances phi (n,) to the interface, m."""

    def wall_table(self, geometry: Geometry, wall: np.ndarray, neighbours: Neighbourhood,
                   particles: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """(wall (n_rows,), velocity, slip length and spin of the walls) of the nearest walls (n_rows,); particles: how
        many there are before the dummies."""


class WallScene:
    """Dummies of a scene and their wall data, which never change.

    geometry: Geometry; dummies: (n_dummy, dim) m; support: m; kind: kernel number; site_volume: m^dim;
    line: what changes walls near a contact line, or None.
    """

    def __init__(self, geometry: Geometry, dummies: np.ndarray, support: float, kind: int, site_volume: float,
                 line: WallChange | None = None):
        self.geometry, self.dummies = geometry, dummies
        self.support, self.kind, self.site_volume = support, kind, site_volume
        self.dummy_distance, self.dummy_wall = geometry.nearest(dummies)
        self.line = line
        self.slips = line is not None or bool(np.any(geometry.slip_length > 0.0))
        self.dummy_normal = self._normals(dummies) if self.slips else None

    def moving_at(self, wall_velocity: np.ndarray) -> WallScene:
        """The same scene with its walls at other velocities, (n_walls, dim) m/s."""
        other = copy.copy(self)
        other.geometry = copy.copy(self.geometry)
        other.geometry.wall_velocity = wall_velocity
        return other

    def with_interface(self, phi: np.ndarray) -> WallScene:
        """The same scene with its contact lines where the signed distances phi (n,), m, to the interface vanish."""
        assert self.line is not None
        other = copy.copy(self)
        other.line = self.line.at(phi)
        return other

    def configure(self, x: np.ndarray, share: Share | None = None,
                  reach: float = 0.0) -> tuple[Operators, Neighbourhood, Halo]:
        """Operators, all neighbours and periodic images of fluid positions x (n, dim). share, reach: see `stencils`."""
        stencils, images = self.stencils(x, share=share, reach=reach)
        neighbours, exchange = stencils.neighbours, NO_EXCHANGE if share is None else share.exchange
        ops = build_wall_operators(stencils, 2, classify_neighbourhoods(stencils, exchange), exchange)
        adjoint_divergence(ops)
        return ops, neighbours, images

    def stencils(self, x: np.ndarray, fixed: bool = False, share: Share | None = None,
                 reach: float = 0.0) -> tuple[WallStencils, Halo]:
        """What operators are built from, and the periodic images.

        fixed: the particles sit on their lattice and will stay there: every volume is that of a site. share: of this
        process, where there are several; its remote particles come behind x in the table, without rows of their own.
        reach: how far any particle sees, m, where that is farther than the support: up to there images are needed.
        """
        geometry, own = self.geometry, len(x)
        if share is not None:
            x = np.concatenate([x, share.ghosts])
        n = len(x)
        owned = np.concatenate([x, self.dummies])
        images = build_halo(owned, geometry.lower, geometry.upper, np.array(geometry.periodic),
                            max(reach, self.support),
                            None if share is None else (share.lower, share.upper))
        table, owner = images.positions(owned), images.owners(len(owned))
        if fixed:
            pairs = find_pairs(table, own, self.support)
            neighbours = Neighbourhood(pairs.start, pairs.index, pairs.index, table, owner, self.kind, self.support)
        else:
            neighbours = neighbourhood(table, owner, own, self.kind, self.support)
        distance, wall = geometry.nearest(x)
        wall, velocity = np.concatenate([wall, self.dummy_wall])[owner], geometry.wall_velocity
        slip_length, spin = geometry.slip_length, geometry.wall_spin
        if self.line is not None:
            wall, velocity, slip_length, spin = self.line.wall_table(geometry, wall, neighbours, n)
        walls = WallTable(
            owner < n,
            np.concatenate([distance, self.dummy_distance])[owner],
            wall,
            velocity,
            slip_length,
            np.concatenate([self._normals(x), self.dummy_normal])[owner] if self.slips else np.zeros((0, x.shape[1])),
            np.zeros((0, x.shape[1], x.shape[1])) if spin is None else spin,
        )
        links = crossings(geometry, neighbours, walls)
        volume = np.full(len(table) if fixed else len(owned), self.site_volume)
        if not fixed:
            volume[:n] = particle_volumes(neighbours) if share is None else share.exchange.forward(
                particle_volumes(neighbours))
        return WallStencils(neighbours, walls, links, volume), images

    def clamp_wall_distance(self, x: np.ndarray, displacement: np.ndarray, dr: np.ndarray | None,
                            nearest: float | np.ndarray) -> np.ndarray | None:
        """The shift dr (n, dim) or None, with what keeps particles from coming nearer to a wall than `nearest`.

        x: (n, dim) positions; displacement: (n, dim) with the flow; nearest: number or (n,), m.
        A particle that starts nearer does not approach further. The flow along a no-slip wall never presses a particle
        against it; shifting and round-off of the velocity do, and the correction tensors of a particle on the wall are
        lopsided.
        """
        ahead = x + displacement if dr is None else x + displacement + dr
        distance = self.geometry.distance(ahead)
        close = distance < nearest
        if not reduce.any_true(close):  # of any process: all carry fields by shifts, or none
            return dr
        rows = np.flatnonzero(close)
        if isinstance(nearest, np.ndarray):
            nearest = nearest[rows]
        least = np.minimum(np.maximum(self.geometry.distance(x[rows]), 0.0), nearest)
        missing = np.maximum(least - distance[rows], 0.0)
        dr = np.zeros_like(x) if dr is None else dr
        dr[rows] += missing[:, None] * self._normals(ahead[rows])
        return dr

    def _normals(self, x: np.ndarray) -> np.ndarray:
        return wall_normals(self.geometry, x, self.support)
