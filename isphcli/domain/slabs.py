"""`Slabs`: an array [z, y, x] whose layers along z the processes share, such as the voxels of an image.

What runs along the lines of an array, such as a Fourier transform or the filter of a spline, is done on whole lines:
those along x and y lie within a slab, for those along z the processes give each other parts of their layers, so that
each has all layers of a part of the lines. The values are those of one process, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .communicator import Alone, Communicator, current
from .exchange import swap


class Slabs:
    """How the processes share an array of a shape [z, y, x]. ends: (size + 1,) the first layer of each process, and the
    number of layers; without it they are shared evenly. Each may have none.

    All processes call the methods together; `values` are the own layers [own z, y, x], of any type.
    """

    def __init__(self, shape: Sequence[int], ends: np.ndarray | None = None, ranks: Communicator | None = None):
        self.ranks = current() if ranks is None else ranks
        self.shape = tuple(map(int, shape))
        size = self.ranks.size
        self.ends = np.arange(size + 1) * self.shape[0] // size if ends is None else ends
        self._columns = np.arange(size + 1) * self.shape[1] // size  # of the lines along z that each process gets

    @staticmethod
    def whole(shape: Sequence[int]) -> Slabs:
        """Of an array that this process has alone."""
        return Slabs(shape, ranks=Alone())

    @property
    def own(self) -> tuple[int, int]:
        """The first of the own layers, and the one behind the last."""
        return int(self.ends[self.ranks.rank]), int(self.ends[self.ranks.rank + 1])

    @property
    def columns(self) -> slice:
        """The part along y of `turned` values."""
        return slice(int(self._columns[self.ranks.rank]), int(self._columns[self.ranks.rank + 1]))

    def within(self, first: int, end: int) -> Slabs:
        """The layers from `first` to before `end`, each with the process that has it."""
        return Slabs((end - first, *self.shape[1:]), np.clip(self.ends, first, end) - first, self.ranks)

    def part(self, values: np.ndarray, ranges: tuple[slice, ...]) -> tuple[np.ndarray, Slabs]:
        """The own layers of a part [z, y, x] of the array, and how the processes share it."""
        first, end, _ = ranges[0].indices(self.shape[0])
        low, high = (min(max(layer, first), end) - self.own[0] for layer in self.own)
        found = values[max(low, 0) : max(high, 0), ranges[1], ranges[2]]
        inner = self.within(first, end)
        return found, Slabs((end - first, *found.shape[1:]), inner.ends, self.ranks)

    def grown(self, widths: Sequence[tuple[int, int]]) -> Slabs:
        """With so many more cells before and behind along z, y, x; layers beside the ends belong to the first and the
        last process."""
        ends = self.ends + widths[0][0]
        ends[0], ends[-1] = 0, ends[-1] + widths[0][1]
        return Slabs([n + sum(more) for n, more in zip(self.shape, widths)], ends, self.ranks)

    def padded(self, values: np.ndarray, widths: Sequence[tuple[int, int]], fill: float) -> np.ndarray:
        """The own layers with so many more cells, of the value `fill`: those of `grown`."""
        first, last = self.ranks.rank == 0, self.ranks.rank == self.ranks.size - 1
        along = (widths[0][0] if first else 0, widths[0][1] if last else 0)
        return np.pad(values, [along, *widths[1:]], constant_values=fill)

    def along(self, values: np.ndarray, axis: int, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """What a function makes of whole lines along an axis of the array; it keeps the shape."""
        return self.back(function(self.turned(values))) if axis == 0 else function(values)

    def turned(self, values: np.ndarray) -> np.ndarray:
        """All layers [z, own y, x], of the lines along z that this process gets."""
        if self.ranks.size == 1:
            return values
        assert values.shape[1] == self.shape[1], "of another array: what processes give and take would not fit"
        out = np.empty((self.shape[0], self.columns.stop - self.columns.start, values.shape[2]), values.dtype)
        self._swap([values[:, a:b] for a, b in zip(self._columns, self._columns[1:])],
                   [out[a:b] for a, b in zip(self.ends, self.ends[1:])])
        return out

    def back(self, values: np.ndarray) -> np.ndarray:
        """The inverse of `turned`."""
        if self.ranks.size == 1:
            return values
        first, end = self.own
        out = np.empty((end - first, self.shape[1], values.shape[2]), values.dtype)
        self._swap([values[a:b] for a, b in zip(self.ends, self.ends[1:])],
                   [out[:, a:b] for a, b in zip(self._columns, self._columns[1:])])
        return out

    def box(self, values: np.ndarray, first: Sequence[int], end: Sequence[int]) -> np.ndarray:
        """The cells from `first` to before `end` (z, y, x) of all processes; beyond the faces the array repeats."""
        wanted = self.ranks.collect((tuple(map(int, first)), tuple(map(int, end))))
        low, high = self.own
        give = []
        for begin, stop in wanted:
            z, y, x = (np.mod(np.arange(a, b), n) for a, b, n in zip(begin, stop, self.shape))
            z = z[(z >= low) & (z < high)] - low
            give.append(values[np.ix_(z, y, x)])
        begin, stop = wanted[self.ranks.rank]
        if self.ranks.size == 1:
            return give[0]
        out = np.empty(tuple(b - a for a, b in zip(begin, stop)), values.dtype)
        owner = np.searchsorted(self.ends, np.mod(np.arange(begin[0], stop[0]), self.shape[0]), side="right") - 1
        places = [np.flatnonzero(owner == k) for k in range(self.ranks.size)]
        take = [np.empty((len(place), *out.shape[1:]), out.dtype) for place in places]
        self._swap(give, take)
        for place, come in zip(places, take):
            out[place] = come
        return out

    def beside(self, values: np.ndarray, below: int, above: int, repeats: bool) -> tuple[np.ndarray, int]:
        """(the own layers with so many layers of others below and above them, the layer that is the first of these,
        < 0 beyond the face); of a single layer no others. repeats: the layers beyond the faces are those of the other
        side; else there are none."""
        low, high = self.own
        first, end = (low - below, high + above) if self.shape[0] > 1 else (low, high)
        if not repeats:
            first, end = max(first, 0), min(end, self.shape[0])
        if low == high:
            first = end = low
        return self.box(values, (first, 0, 0), (end, *self.shape[1:])), first

    def _swap(self, give: Sequence[np.ndarray], take: Sequence[np.ndarray]) -> None:
        """Gives an array to each process and takes one of each, of known shapes."""
        ranks = self.ranks
        sent = [np.ascontiguousarray(part) for part in give]
        come = [part if part.flags.c_contiguous else np.empty(part.shape, part.dtype) for part in take]
        others = [k for k in range(ranks.size) if k != ranks.rank]
        swap(ranks.raw, [(k, sent[k]) for k in others if sent[k].size],  # type: ignore[attr-defined]
             [(k, come[k]) for k in others if come[k].size])
        come[ranks.rank][...] = sent[ranks.rank]
        for part, found in zip(take, come):
            if found is not part:
                part[...] = found


@dataclass(frozen=True)
class Shared:
    """An array that the processes share. values: the own layers [own z, y, x]."""

    values: np.ndarray
    slabs: Slabs
