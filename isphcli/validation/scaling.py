"""A model of a step on as many processes as the paper had: particles, messages and seconds of each.

This program has only run on the cores of a desk machine. In the model the particles of a process, the remote ones that
it sees and the messages between processes follow from the bricks of the cut (`domain/cut.py`); the number of values
sent in a step was counted in runs of 1 to 8 processes (`benchmarks/scaling.py`), and the time of a particle was
measured in one; latency, bandwidth, the messages of the multigrid cycle and the collective sums are assumed (`Machine`,
`Cycle`). tests/validation/test_scaling.py compares the arithmetic with bricks of real cuts, tests/test_moving_ranks.py
with what runs of several processes count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..domain.cut import even_bricks

SAMPLE = 64  # bricks of which the busiest is looked for, where there are more: the others are like them


@dataclass(frozen=True)
class Machine:
    """The cost of messages on a machine like that of the paper, with cores as fast as those of the measurements.

    latency: s, of a message, all of it paid one after the other; bandwidth: bytes/s of one process. A Cray XE6 with
    Gemini routers has 0.7 to 1.4 us and more than 6 GB/s a node were measured (A. J. van der Steen, Overview of recent
    supercomputers, 2010); we take 2 us with the software of MPI, and share a node between its 24 cores.
    """

    latency: float = 2.0e-6
    bandwidth: float = 6.0e9 / 24

    def sums(self, processes: int) -> float:
        """s of a sum over all processes: up and down a tree."""
        return 2.0 * math.ceil(math.log2(max(processes, 2))) * self.latency if processes > 1 else 0.0


@dataclass(frozen=True)
class Cycle:
    """A cycle of algebraic multigrid between processes: nothing of hypre's messages was counted.

    ratio: of the rows of a level over those of the next; coarsest: rows of the last one, which is solved at once;
    exchanges: of values with the neighbours on a level, of two sweeps, a residual, a restriction and a prolongation;
    spread: neighbours of a process on a level over those of its particles, since rows of coarse levels reach farther;
    set_up: exchanges on a level when a hierarchy is built, over those of a cycle.
    """

    ratio: float = 6.0
    coarsest: float = 9.0
    exchanges: float = 5.0
    spread: float = 2.0
    set_up: float = 10.0

    def levels(self, rows: float) -> int:
        """How many levels so many rows have."""
        return 1 + math.ceil(math.log(max(rows / self.coarsest, 1.0)) / math.log(self.ratio))

    def seconds(self, rows: float, neighbours: float, machine: Machine) -> float:
        """s of the messages of a cycle, latency alone: the data between levels are few."""
        return self.levels(rows) * self.exchanges * self.spread * neighbours * machine.latency


@dataclass(frozen=True)
class Counted:
    """Messages of a process, (of a step without its iterations, of an iteration) each, as counted by
    `benchmarks/scaling.py`.

    exchanges: of values with every neighbour; sent: bytes of these per remote particle; collectives: sums and the like
    over all processes; set_ups: times that a hierarchy is built in a step.
    """

    exchanges: tuple[float, float]
    sent: tuple[float, float]
    collectives: tuple[float, float]
    set_ups: float


# `benchmarks/scaling.py FOLDER weak 1 2` at commit 38b910c, 2026-11-30 (docs/clusters.md): past spheres in a step of
# 14.3 iterations 57.3 messages to the one neighbour, 1068 bytes per remote particle and 114 collectives, with each more
# iteration 3.1, 49 and 4.9; of drops 49.3, 847 and 153 with 8.3 iterations, then 2.0, 30 and 4.2. Hierarchies: assumed,
# one in ten steps; runs that are under way build fewer, the first steps more.
ONE_FLUID = Counted((12.3, 3.14), (364.0, 49.1), (43.3, 4.93), 0.1)
TWO_FLUIDS = Counted((33.0, 1.96), (595.0, 30.2), (118.2, 4.18), 0.1)


@dataclass(frozen=True)
class Work:
    """Measured cost of a step on one process, CPU s per particle, of assembling and solving; iterations: of all its
    solves; counted: messages of several processes."""

    assembling: float
    solving: float
    iterations: float
    counted: Counted


@dataclass(frozen=True)
class Busiest:
    """Largest values of any process: processes that it exchanges with, and remote particles over own ones."""

    neighbours: int
    remote: float


@dataclass(frozen=True)
class Step:
    """s of a step: of the own and remote particles, and of what is sent for either."""

    assembling: float
    solving: float
    messages: float
    sums: float
    cycles: float

    @property
    def total(self) -> float:
        """s of all parts: computing and messages do not overlap in the model."""
        return self.assembling + self.solving + self.messages + self.sums + self.cycles


def busiest(lower: np.ndarray, upper: np.ndarray, count: int, reach: float, periodic: Sequence[bool]) -> Busiest:
    """Of the bricks of so many processes in a box, corners (dim,) m, that fluid fills evenly. reach: how far particles
    see, m."""
    bricks = even_bricks(lower, upper, count)
    edges = bricks[:, 1] - bricks[:, 0]
    size = np.where(periodic, np.array(upper, float) - np.array(lower, float), 0.0)
    found = []
    for k in np.unique(np.linspace(0, count - 1, min(count, SAMPLE)).astype(int)):
        seen = np.zeros_like(edges)  # of each axis of each brick how much is seen, images too: once where twice
        for boxes in (-1, 0, 1):
            low, high = bricks[k, 0] - reach + boxes * size, bricks[k, 1] + reach + boxes * size
            part = np.maximum(np.minimum(bricks[:, 1], high) - np.maximum(bricks[:, 0], low), 0.0)
            seen += np.where((boxes == 0) | (size > 0.0), part, 0.0)
        volume = np.minimum(seen, edges).prod(axis=1)
        volume[k] = 0.0
        found.append(Busiest(int((volume > 0.0).sum()), float(volume.sum() / edges[k].prod())))
    return Busiest(max(each.neighbours for each in found), max(each.remote for each in found))


def sent_in_a_step(work: Work, near: Busiest, own: float) -> tuple[float, float, float]:
    """(messages, bytes, collectives) of a process in a step. own: its particles."""
    counted = work.counted
    exchanges, sent, collectives = (of_step + work.iterations * of_iteration for of_step, of_iteration in (
        counted.exchanges, counted.sent, counted.collectives))
    return exchanges * near.neighbours, sent * near.remote * own, collectives


def step(work: Work, near: Busiest, particles: float, processes: int, machine: Machine = Machine(),
         cycle: Cycle = Cycle()) -> Step:
    """A step of so many particles in all. Assembling is taken to cost as much of remote particles as of own ones, which
    is too much: they have no rows. Solves have rows of own particles only."""
    own = particles / processes
    assembling, solving = own * (1.0 + near.remote) * work.assembling, own * work.solving
    if processes == 1:
        return Step(assembling, solving, 0.0, 0.0, 0.0)
    messages, sent, collectives = sent_in_a_step(work, near, own)
    krylov = 2.0 * work.iterations  # sums of PETSc's GMRES: one for the products with the basis, one for the norm
    one = cycle.seconds(particles, near.neighbours, machine)
    return Step(assembling, solving, messages * machine.latency + sent / machine.bandwidth,
                (collectives + krylov) * machine.sums(processes),
                (work.iterations + cycle.set_up * work.counted.set_ups) * one)
