"""Operators of scenes with walls: dummies, wall data of every row, crossings. Imported only where there are solids."""

import numpy as np

from .coupling import adjoin, balance, crowding
from .halo import build_halo
from .neighbours import find_pairs
from .operators import particle_volumes
from .walls import WallTable, build_wall_operators, crossings


class WallScene:
    """Dummies of a scene and their wall data, which never change.

    geometry: Geometry; dummies: (n_dummy, dim) m; support: m; kind: kernel number; site_volume: m^dim;
    line: contact_angle.SlipAtLine or None.
    """

    def __init__(self, geometry, dummies, support, kind, site_volume, line=None):
        self.geometry, self.dummies = geometry, dummies
        self.support, self.kind, self.site_volume = support, kind, site_volume
        self.dummy_distance = geometry.distance(dummies)
        self.dummy_wall = geometry.wall(dummies)
        self.line = line
        self.slips = line is not None or bool(np.any(geometry.slip_length > 0.0))
        self.dummy_normal = self._normals(dummies) if self.slips else None

    def configure(self, x):
        """(Operators, table of positions, pairs, Halo) of fluid positions x (n, dim)."""
        table, owner, pairs, walls, fraction, volume, images = self.stars(x)
        few, still = crowding(pairs.start, pairs.index, fraction, owner)
        ops = build_wall_operators(table, pairs, fraction, owner, volume, walls, self.kind, self.support, 2, few, still)
        if few is None:
            balance(ops, table, np.diff(pairs.start))
        else:
            adjoin(ops, table)
        return ops, table, pairs, images

    def stars(self, x, fixed=False):
        """What operators are built from: (table of positions, owners, pairs, WallTable, crossings, volumes, Halo).

        fixed: the particles sit on their lattice and will stay there: every volume is that of a site.
        """
        geometry, n = self.geometry, len(x)
        owned = np.concatenate([x, self.dummies])
        images = build_halo(owned, geometry.lower, geometry.upper, np.array(geometry.periodic), self.support)
        table, owner = images.positions(owned), images.owners(len(owned))
        pairs = find_pairs(table, n, self.support)
        wall, velocity = np.concatenate([geometry.wall(x), self.dummy_wall])[owner], geometry.wall_velocity
        slip_length, spin = geometry.slip_length, geometry.wall_spin
        if self.line is not None:
            wall, velocity, slip_length, spin = self.line.wall_table(geometry, wall, pairs, owner)
        walls = WallTable(
            owner < n,
            np.concatenate([geometry.distance(x), self.dummy_distance])[owner],
            wall,
            velocity,
            slip_length,
            np.concatenate([self._normals(x), self.dummy_normal])[owner] if self.slips else np.zeros((0, x.shape[1])),
            spin,
        )
        fraction = crossings(geometry, table, pairs, walls)
        volume = np.full(len(owned), self.site_volume)
        if not fixed:
            volume[:n] = particle_volumes(table, pairs, self.kind, self.support)
        return table, owner, pairs, walls, fraction, volume, images

    def clamp_wall_distance(self, x, displacement, dr, nearest):
        """The shift dr (n, dim) or None, with what keeps particles from coming nearer to a wall than `nearest`.

        x: (n, dim) positions; displacement: (n, dim) with the flow; nearest: number or (n,), m.
        A particle that starts nearer does not approach further. The flow along a no-slip wall never presses a particle
        against it; shifting and round-off of the velocity do, and the correction tensors of a particle on the wall are
        lopsided.
        """
        ahead = x + displacement if dr is None else x + displacement + dr
        distance = self.geometry.distance(ahead)
        rows = np.flatnonzero(distance < nearest)
        if len(rows) == 0:
            return dr
        if np.ndim(nearest):
            nearest = nearest[rows]
        least = np.minimum(np.maximum(self.geometry.distance(x[rows]), 0.0), nearest)
        missing = np.maximum(least - distance[rows], 0.0)
        dr = np.zeros_like(x) if dr is None else dr
        dr[rows] += missing[:, None] * self._normals(ahead[rows])
        return dr

    def _normals(self, x):
        return wall_normals(self.geometry, x, self.support)


def wall_normals(geometry, x, scale):
    """Unit normals into the fluid at x (n, dim), from central differences of the wall distance over 1e-3 of `scale`, m;
    zero where it is flat."""
    h = 1e-3 * scale
    normal = np.empty_like(x)
    for k in range(x.shape[1]):
        step = np.zeros(x.shape[1])
        step[k] = h
        normal[:, k] = geometry.distance(x + step) - geometry.distance(x - step)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0.0, length, 1.0)
