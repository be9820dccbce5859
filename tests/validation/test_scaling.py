"""The model of many processes: its arithmetic against bricks of lattices, and what grows with what."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from isphcli.domain.cut import even_bricks
from isphcli.validation.scaling import Busiest, Counted, Cycle, Machine, Work, busiest, sent_in_a_step, step

WORK = Work(4e-6, 8e-6, 10.0, Counted((20.0, 1.0), (500.0, 8.0), (30.0, 1.0), 0.1))


@pytest.mark.slow
@pytest.mark.parametrize("count, periodic", [(2, (True, True, True)), (8, (True, True, True)),
                                             (16, (False, True, False))])
def test_remote_particles_and_neighbours_are_those_counted_on_a_lattice(count, periodic):
    """Sites within reach of a brick, images too, each once: exactly, where faces of bricks lie between planes."""
    lower, upper, spacing, reach = np.zeros(3), np.array([1.2, 1.0, 1.0]), 0.025, 0.05
    axes = [np.arange(0.5 * spacing, b, spacing) for b in upper]
    x = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    bricks = even_bricks(lower, upper, count)
    owner = np.full(len(x), -1)
    for k, (low, high) in enumerate(bricks):
        owner[((x >= low) & (x < high)).all(axis=1)] = k
    most = []
    for k, (low, high) in enumerate(bricks):
        seen = np.zeros(len(x), bool)
        for boxes in itertools.product(*((-1, 0, 1) if around else (0,) for around in periodic)):
            image = x + np.array(boxes) * upper
            seen |= ((image > low - reach) & (image < high + reach)).all(axis=1)
        remote = seen & (owner != k)
        most.append((remote.sum() / (owner == k).sum(), len(np.unique(owner[remote]))))
    near = busiest(lower, upper, count, reach, periodic)
    assert near.remote == pytest.approx(max(most)[0]) and near.neighbours == max(n for _, n in most)


def test_what_is_sent_follows_from_the_bricks():
    """A message a neighbour and exchange; bytes a remote particle; those of every iteration beside those of a step."""
    assert sent_in_a_step(WORK, Busiest(26, 0.5), 1000.0) == (30.0 * 26, 580.0 * 500, 40.0)


def test_one_process_sends_nothing_and_many_halve_the_work():
    machine, cycle, alone = Machine(), Cycle(), Busiest(0, 0.0)
    one = step(WORK, alone, 1e6, 1, machine, cycle)
    assert one.total == pytest.approx(12.0) and one.messages == one.sums == one.cycles == 0.0
    free = Machine(latency=0.0, bandwidth=np.inf)
    assert step(WORK, alone, 1e6, 64, free, cycle).total == pytest.approx(12.0 / 64)
    near = Busiest(26, 0.5)
    some = step(WORK, near, 1e6, 64, machine, cycle)
    assert some.assembling == pytest.approx(1.5 * 4.0 / 64) and some.total > 12.0 / 64


def test_what_grows_at_fixed_work_a_process():
    """Sums with the logarithm of the processes, cycles with that of the particles; all else stays."""
    near, machine = Busiest(26, 0.8), Machine()
    few, many = (step(WORK, near, 6000.0 * count, count, machine, Cycle()) for count in (512, 8192))
    assert (few.assembling, few.solving, few.messages) == pytest.approx((many.assembling, many.solving, many.messages))
    assert many.sums / few.sums == pytest.approx(13 / 9)
    levels = Cycle().levels
    assert many.cycles / few.cycles == pytest.approx(levels(6000 * 8192) / levels(6000 * 512))
    assert levels(9.0) == 1 and levels(9.0 * 215.0) == 4
    # of twice the latency what goes over it takes twice as long
    slow = step(WORK, near, 6000.0 * 512, 512, replace(machine, latency=2 * machine.latency), Cycle())
    assert slow.sums == pytest.approx(2 * few.sums) and slow.cycles == pytest.approx(2 * few.cycles)
