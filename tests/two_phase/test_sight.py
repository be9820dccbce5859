"""What the fit of the distance sees beyond the support of the operators."""

import numpy as np
import pytest

from isphcli.two_phase.interface import find_interface
from isphcli.two_phase.sight import Sight
from tests.two_phase.scenes import scene

BEHIND = """
geometry:
  box: [2, 1, 0.5]
  periodic: [x, y, z]
  fluid: b
  shapes:
    - {{half_space: {{point: [1, 0, 0], normal: [1, 0, 0]}}, is: a}}
    - {{box: {{lower: [0.2, {lower}, -1], upper: [1.8, {upper}, 2]}}, is: solid}}
particles: {{spacing: 0.1, jitter: 0.2, seed: 3}}
fluids: {{a: {{density: 1, viscosity: 1}}, b: {{density: 1, viscosity: 1}}}}
interface: {{tension: 1}}
time: {{end: 1}}
"""


def pairs_of(neighbours):
    """{(particle, place of its neighbour)} of a Neighbourhood."""
    particle = np.repeat(np.arange(neighbours.n), np.diff(neighbours.start))
    return {(i, *np.round(neighbours.x[row], 9)) for i, row in zip(particle, neighbours.row)}


@pytest.mark.slow
def test_farther_neighbours_are_those_in_sight_that_know_their_distance():
    """Beside a wall a spacing thick in a periodic box: all pairs of particles that know their distance within 2.8
    spacings, images included, but those whose way leads through the wall, found by its two faces."""
    _, geometry, state, stepper, _ = scene(BEHIND.format(lower=0.45, upper=0.55))
    config = stepper.configure(state.x, phi=state.phi)
    known = np.abs(state.phi) < 0.999 * np.abs(state.phi).max()
    assert 50 < known.sum() < 0.8 * len(known)
    sight = Sight(0.28, geometry)
    seen, everyone = sight.neighbours(config.ops, config.neighbours, known)
    expected, x = set(), state.x
    shifts = [np.array([a, b, c]) * [2, 1, 0.5] for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)]
    for shift in shifts:
        for i in np.flatnonzero(known):
            near = np.flatnonzero(known & (((x + shift - x[i]) ** 2).sum(axis=1) < 0.28**2))
            for j in near:
                if (i != j or shift.any()) and (geometry.crossing(x[[i]], x[[j]] + shift) >= 1.0).all():
                    expected.add((i, *np.round(x[j] + shift, 9)))
    assert pairs_of(seen) == expected
    assert (everyone.column >= len(x)).any() and len(everyone.column) > len(seen.column)
    # sight within the support of the operators changes nothing
    ops, near = Sight(0.2, geometry).neighbours(config.ops, config.neighbours, known)
    assert ops is config.ops.neighbours and near is config.neighbours


def test_roughness_in_space_is_seen_as_roughness():
    """White noise of a hundredth of a spacing on a flat interface: the fit over 2.8 spacings keeps half of it, as it
    does in the plane, and that over the 2.1 of the operators, ten unknowns for hardly more neighbours, 0.8; the
    curvature is twice as rough."""
    text = """
geometry: {box: [1.6, 0.8, 0.8], periodic: [x, y, z], fluid: b,
           shapes: [{half_space: {point: [0.8, 0, 0], normal: [1, 0, 0]}, is: a}]}
particles: {spacing: 0.1}
fluids: {a: {density: 1, viscosity: 1}, b: {density: 1, viscosity: 1}}
interface: {tension: 1}
time: {end: 1}
"""
    _, _, state, stepper, _ = scene(text)
    config, near = stepper.configure(state.x, phi=state.phi), np.abs(state.phi) < 0.1
    rough = 1e-3 * np.random.default_rng(0).normal(size=len(near))
    kept, curvature = [], []
    for sight in (None, stepper.fluids.sight):
        smooth, noisy = (find_interface(config.ops, config.neighbours, state.phi + more, 0.1, sight=sight)
                         for more in (0.0, rough))
        kept.append(np.std((noisy.fit.value - smooth.fit.value)[near]) / 1e-3)
        curvature.append(np.std(noisy.curvature[near]))
    assert kept[0] > 0.75 and kept[1] < 0.6
    assert curvature[1] < 0.6 * curvature[0]
