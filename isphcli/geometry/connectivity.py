"""Which parts of a labelled lattice of fluid are connected, and along which axes they lead through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ..domain.slabs import Slabs


@dataclass(frozen=True)
class Connectivity:
    """Connected fluid of a lattice; axes in the order x, y(, z)."""

    porosity: float  # fluid cells over all cells
    components: int
    percolates: tuple[bool, ...]  # per axis
    percolating_porosity: tuple[float, ...]  # per axis: cells of components percolating along it / all cells
    isolated_pockets: int  # closed pockets: components that percolate along none of the axes that count
    isolated_volume: float  # their cells times the cell volume
    isolated_share: float  # their cells over fluid cells (0 without fluid)
    largest_share: float  # cells of the largest component over fluid cells (0 without fluid)


def components(fluid: np.ndarray, periodic: tuple[bool, ...]) -> tuple[np.ndarray, int, np.ndarray]:
    """Face-connected components of a fluid mask, across periodic faces.

    fluid: bool [z, y, x] or [y, x]; periodic: per axis in the order x, y(, z).
    Returns (labels with 0 in solid and 1..n, n, percolates (n + 1, dim) bool with axes x, y(, z)).
    A component percolates along a periodic axis if a closed path in it winds round that axis, and along
    another axis if it touches both faces.
    """
    fluid = np.ascontiguousarray(fluid, dtype=bool)  # across the order of the memory labels take twice as long
    dim = fluid.ndim
    if len(periodic) != dim:
        raise ValueError(f"periodic has {len(periodic)} entries for an image of {dim} dimensions")
    raw, n_raw = ndimage.label(fluid)
    edges = _periodic_edges(raw, periodic)
    n, owner, winding = merge_periodic(n_raw, edges, dim)
    labels, owners = raw, np.concatenate([[0], owner + 1]).astype(raw.dtype)
    for layer in labels if len(edges) else ():  # in place: the labels are the largest array of an image
        layer[...] = owners[layer]
    percolates = np.zeros((n + 1, dim), dtype=bool)
    percolates[1:] = winding
    for axis in range(dim):
        if not periodic[axis]:
            first, last = np.take(labels, [0, -1], axis=dim - 1 - axis).swapaxes(0, dim - 1 - axis)
            percolates[np.intersect1d(first, last), axis] = True
    percolates[0] = False
    return labels, n, percolates


def connectivity_of(fluid: np.ndarray, periodic: tuple[bool, ...], cell_volume: float = 1.0,
                    open_axes: Sequence[int] | None = None, through: Sequence[int] | None = None) -> Connectivity:
    """Porosity, components, percolation and pockets of a fluid mask [z, y, x] or [y, x]; see `components`.

    open_axes: those along which fluid can leave, all without it: along others walls close the faces that a component
    touches, and it does not percolate. through: those along which a component has to percolate to be no closed pocket,
    the open ones without it.
    """
    fluid = np.asarray(fluid, dtype=bool)
    labels, n, percolates = components(fluid, periodic)
    if open_axes is not None:
        percolates[:, [axis for axis in range(fluid.ndim) if axis not in open_axes]] = False
    size = np.zeros(n + 1, dtype=np.int64)
    for layer in labels:  # np.bincount makes eight bytes of every cell
        size += np.bincount(layer.ravel(), minlength=n + 1)
    size[0] = 0
    isolated = np.logical_not((percolates if through is None else percolates[:, list(through)]).any(axis=1))
    isolated[0] = False
    if through is None and open_axes is not None and not len(open_axes):
        isolated[:] = False  # a box of walls is no pocket
    return Connectivity(
        porosity=float(size.sum() / max(fluid.size, 1)),
        components=n,
        percolates=tuple(bool(p) for p in np.ravel(percolates.any(axis=0))),
        percolating_porosity=tuple(float(s) for s in size @ percolates / max(fluid.size, 1)),
        isolated_pockets=int(isolated.sum()),
        isolated_volume=float(size[isolated].sum() * cell_volume),
        isolated_share=float(size[isolated].sum() / max(size.sum(), 1)),
        largest_share=float(size.max() / max(size.sum(), 1)),
    )


class SlabConnectivity:
    """`connectivity_of` of a mask [z, y, x] that is not periodic and is given slab by slab along z: of a slab only the
    sizes of its parts and its last layer are kept."""

    def __init__(self) -> None:
        self.count = self.cells = 0  # parts and cells so far
        self.sizes: list[np.ndarray] = []
        self.edges = [np.empty((0, 2), np.int64)]  # parts that touch across the faces of slabs
        self.faces: list[tuple[list[np.ndarray], list[np.ndarray]]] = [([], []), ([], []), ([], [])]  # of x, y, z
        self.last: np.ndarray | None = None

    def add(self, fluid: np.ndarray) -> None:
        """The next slab, bool [z, y, x]."""
        labels, n = ndimage.label(fluid)
        size = np.zeros(n + 1, np.int64)
        for layer in labels:
            size += np.bincount(layer.ravel(), minlength=n + 1)
        self.sizes.append(size[1:])
        ends = ((labels[:, :, 0], labels[:, :, -1]), (labels[:, 0], labels[:, -1]))
        for (lower, upper), (first, last) in zip(self.faces, ends):
            lower.append(self._numbers(first))
            upper.append(self._numbers(last))
        if self.last is None:
            self.faces[2][0].append(self._numbers(labels[0]))
        else:
            both = (self.last >= 0) & (labels[0] > 0)
            pairs = np.stack([self.last[both], labels[0][both].astype(np.int64) - 1 + self.count], axis=1)
            self.edges.append(np.unique(pairs, axis=0))
        self.last = np.where(labels[-1] > 0, labels[-1].astype(np.int64) - 1 + self.count, -1)
        self.count += n
        self.cells += fluid.size

    def _numbers(self, face: np.ndarray) -> np.ndarray:
        """Numbers among all parts of those on a face of the slab."""
        found = np.unique(face)
        return found[found > 0].astype(np.int64) - 1 + self.count

    def connectivity(self, cell_volume: float = 1.0) -> Connectivity:
        """Of all slabs; see `connectivity_of`."""
        assert self.last is not None
        self.faces[2][1].append(np.unique(self.last[self.last >= 0]))
        edges = np.concatenate(self.edges)
        graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(self.count, self.count))
        n, owner = connected_components(graph, directed=False) if self.count else (0, np.empty(0, int))
        size = np.bincount(owner, np.concatenate(self.sizes), n).astype(np.int64)
        percolates = np.zeros((n, 3), bool)
        for axis, ends in enumerate(self.faces):
            lower, upper = (owner[np.concatenate(found)] for found in ends)
            percolates[np.intersect1d(lower, upper), axis] = True
        isolated = ~percolates.any(axis=1)
        cells = max(self.cells, 1)
        return Connectivity(
            porosity=float(size.sum() / cells),
            components=int(n),
            percolates=tuple(bool(p) for p in np.ravel(percolates.any(axis=0))),
            percolating_porosity=tuple(float(s) for s in size @ percolates / cells),
            isolated_pockets=int(isolated.sum()),
            isolated_volume=float(size[isolated].sum() * cell_volume),
            isolated_share=float(size[isolated].sum() / max(size.sum(), 1)),
            largest_share=float(size.max(initial=0) / max(size.sum(), 1)),
        )


def percolating(fluid: np.ndarray, periodic: tuple[bool, ...], axis: int, slabs: Slabs | None = None) -> np.ndarray:
    """Mask (shape of fluid) of the fluid in components that percolate along the axis (0 x, 1 y, 2 z).

    fluid: bool [z, y, x] or [y, x]; slabs: how the processes share it, of which each has its layers [z, y, x]; without
    it one process has all."""
    if slabs is None:
        labels, _, percolates = components(fluid, periodic)
        return percolates[:, axis][labels]
    parts, owner, through = components_of_slabs(fluid, slabs, periodic)
    return np.append(through[owner, axis], False)[parts]


def components_of_slabs(fluid: np.ndarray, slabs: Slabs,
                        periodic: tuple[bool, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`components` of a mask, bool [z, y, x], of which each process has its layers: (numbers of the parts of the own
    layers, from 0, -1 in solid; owner: the component of each part; percolates (components, dim) bool)."""
    alone, dim = slabs.ranks.size == 1, len(periodic)
    layers = fluid if alone or dim == 2 else slabs.beside(fluid, 0, 1, periodic[2])[0]
    raw, count = ndimage.label(layers)
    own = raw[: len(fluid)]
    flat = (False,) * (3 - dim)
    links = _periodic_edges(own, (*periodic[:2], bool(periodic[2]) and alone) if dim == 3 else (*periodic, *flat))
    parts = raw - 1
    owner, percolates = join_slabs(parts, count, links, slabs, periodic)
    return parts[: len(fluid)], owner, percolates


def join_slabs(parts: np.ndarray, count: int, links: np.ndarray, slabs: Slabs,
               periodic: tuple[bool, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Joins the parts of the fluid that each process finds in its layers: (owner (count,) the component of each own
    part, percolates (components, dim) bool, as of `components`).

    parts: [z, y, x] numbers of them, -1 in solid, of the own layers and of the one above, where there is one of another
    process; links: (m, 3) parts that touch across periodic faces: on the upper face, on the lower one, axis.
    """
    ranks, dim, n_own = slabs.ranks, len(periodic), slabs.own[1] - slabs.own[0]
    first = sum(ranks.collect(count)[: ranks.rank])
    numbers = np.where(parts >= 0, parts + first, -1) if first else parts
    joined, links = np.empty((0, 2), np.int64), links.astype(np.int64) + [first, first, 0]
    if ranks.size > 1 and dim == 3:  # the layer above has the numbers of its process too
        above = slabs.beside(numbers[:n_own], 0, 1, periodic[2])[0]
        pairs = np.stack([numbers[n_own:].ravel(), above[n_own:].ravel()], axis=1)
        pairs = np.unique(pairs[(pairs >= 0).all(axis=1)], axis=0)
        if slabs.own[1] < slabs.shape[0]:
            joined = pairs
        else:  # across the periodic face
            links = np.concatenate([links, np.column_stack([pairs, np.full(len(pairs), 2)])])
    found = ranks.collect((count, joined, np.unique(links, axis=0), _on_faces(numbers[:n_own], slabs, dim)))
    edges = np.concatenate([known[1] for known in found])
    raw = sum(known[0] for known in found)
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(raw, raw))
    inner, of_raw = connected_components(graph, directed=False) if raw else (0, np.empty(0, np.int64))
    links = np.concatenate([known[2] for known in found])
    links[:, :2] = of_raw[links[:, :2]]
    _, of_inner, winding = merge_periodic(inner, np.unique(links, axis=0), 3)
    owner, percolates = of_inner[of_raw], winding[:, :dim]
    for axis in range(dim):
        if not periodic[axis]:
            lower, upper = (owner[np.concatenate([known[3][axis][side] for known in found])] for side in (0, 1))
            percolates[np.intersect1d(lower, upper), axis] = True
    return owner[first : first + count], percolates


def _on_faces(numbers: np.ndarray, slabs: Slabs, dim: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Per axis x, y(, z) the parts on the lower and on the upper face of the whole; numbers: of the own layers, -1 in
    solid."""
    found = []
    for axis in range(dim):
        ends = [numbers[:1] if slabs.own[0] == 0 else numbers[:0],
                numbers[-1:] if slabs.own[1] == slabs.shape[0] else numbers[:0]] if axis == 2 else (
            [np.take(numbers, [end], axis=2 - axis) for end in (0, -1)])
        lower, upper = (np.unique(end[end >= 0]) for end in ends)
        found.append((lower, upper))
    return found


def _periodic_edges(raw: np.ndarray, periodic: tuple[bool, ...]) -> np.ndarray:
    """(m, 3) int: component on the upper face, the one it touches on the lower face, axis."""
    dim = raw.ndim
    edges = [np.empty((0, 3), dtype=np.int64)]
    for axis in range(dim):
        if periodic[axis]:
            upper = np.take(raw, -1, axis=dim - 1 - axis).ravel().astype(np.int64)
            lower = np.take(raw, 0, axis=dim - 1 - axis).ravel().astype(np.int64)
            both = (upper > 0) & (lower > 0)
            pairs = np.unique(np.stack([upper[both], lower[both]], axis=1), axis=0)
            edges.append(np.column_stack([pairs - 1, np.full(len(pairs), axis)]))
    return np.concatenate(edges)


def merge_periodic(n_raw: int, edges: np.ndarray, dim: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Join components by periodic edges: (n, owner (n_raw,), winding (n, dim) bool).

    Each raw component gets the periodic cell it lies in along a spanning tree; an edge that disagrees with
    the tree closes a path round the box.
    """
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n_raw, n_raw)).tocsr()
    n, owner = connected_components(graph, directed=False) if n_raw else (0, np.empty(0, dtype=np.int64))
    winding = np.zeros((n, dim), dtype=bool)
    if not len(edges):
        return n, owner, winding
    shift_of: dict[tuple[int, int], np.ndarray] = {}
    for upper, lower, axis in edges:
        step = np.zeros(dim, dtype=np.int64)
        step[axis] = 1
        shift_of[int(upper), int(lower)] = step
        shift_of.setdefault((int(lower), int(upper)), -step)
    cell = np.zeros((n_raw, dim), dtype=np.int64)
    for start in np.unique(owner[edges[:, 0]]):
        root = int(edges[owner[edges[:, 0]] == start][0, 0])
        order, parent = breadth_first_order(graph, root, directed=False)
        for node in order[1:]:
            cell[node] = cell[parent[node]] + shift_of[int(parent[node]), int(node)]
    step = np.zeros((len(edges), dim), dtype=np.int64)
    step[np.arange(len(edges)), edges[:, 2]] = 1
    loop = cell[edges[:, 0]] + step - cell[edges[:, 1]]
    np.logical_or.at(winding, owner[edges[:, 0]], loop != 0)
    return n, owner, winding
