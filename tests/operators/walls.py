"""Scenes between walls: particles, their table and their operators."""

import numpy as np

from isphcli.domain.halo import build_halo
from isphcli.domain.lattice import make_lattice
from isphcli.domain.neighbours import neighbourhood
from isphcli.geometry.shape_geometry import ShapeGeometry
from isphcli.operators.apply import divergence, laplacian
from isphcli.operators.crossings import WallStencils, WallTable, crossings
from isphcli.operators.wall_weights import build_wall_operators
from isphcli.scene.place import place

SUPPORTS = [2.1, 2.5, 3.0]


class Walled:
    """Particles of a geometry on a lattice, the table of positions, and operators with walls."""

    def __init__(self, geometry, spacing, ratio=2.1, kind=0, order=1, jitter=0.0, offset=None, lattice=None):
        dim, support = geometry.dim, ratio * spacing
        lattice = make_lattice(
            lattice or ("square" if dim == 2 else "cubic"),
            geometry.lower,
            geometry.upper,
            geometry.periodic,
            spacing,
            support,
            offset,
        )
        self.particles = place(geometry, lattice, support, jitter, spacing)
        p, self.n, self.spacing = self.particles, self.particles.n_fluid, spacing
        halo = build_halo(p.x, geometry.lower, geometry.upper, np.array(geometry.periodic), support)
        self.rows, owner = halo.positions(p.x), halo.owners(len(p.x))
        self.neighbours = neighbourhood(self.rows, owner, self.n, kind, support)
        slips = bool(np.any(geometry.slip_length > 0))
        normal = np.zeros((0, dim))
        if slips:
            step = 1e-4 * spacing * np.eye(dim)
            normal = np.stack(
                [geometry.distance(self.rows + s) - geometry.distance(self.rows - s) for s in step], 1
            )
            normal /= np.linalg.norm(normal, axis=1)[:, None]
        table = WallTable(
            owner < self.n,
            geometry.distance(p.x)[owner],
            geometry.wall(p.x)[owner],
            geometry.wall_velocity,
            geometry.slip_length,
            normal,
            geometry.wall_spin if geometry.wall_spin is not None else np.zeros((0, dim, dim)),
        )
        self.table, self.owner = table, owner
        self.links = crossings(geometry, self.neighbours, table)
        self.volume = np.full(len(p.x), p.site_volume)
        self.ops = build_wall_operators(WallStencils(self.neighbours, table, self.links, self.volume), order)

    @property
    def x(self):
        return self.particles.x[: self.n]

    def lap(self, u):
        return laplacian(self.ops, u) + self.ops.walls.laplacian(u)

    def div(self, u):
        return divergence(self.ops, u) + self.ops.walls.divergence(u)


def channel(dim, width, length=1.0, **kw):
    """Walls at y = 0 and y = width, periodic along the others."""
    upper = np.full(dim, length)
    upper[1] = width
    return ShapeGeometry(np.zeros(dim), upper, [a != 1 for a in range(dim)], **kw)


def along_x(f, dim):
    u = np.zeros((len(f), dim))
    u[:, 0] = f
    return u
