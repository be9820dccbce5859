"""Two fluids on several processes: after 20 steps every particle is where it is on one, of the same fluid, and what is
measured is the same. Where and how they run: see `test_ranks.py`."""

import json

import numpy as np
import pytest

from isphcli.flow.state import phase_of
from tests import test_moving_ranks
from tests.test_moving_ranks import CLOSE, SEVERAL_OF_TWO, assert_same_state, rows, state
from tests.test_ranks import pytestmark  # noqa: F401 - pytest reads pytestmark

found = test_moving_ranks.found  # a fixture
SCENES = [(ranks, name) for (_, ranks), names in SEVERAL_OF_TWO.items() for name in names]
ONES = {"step", "limit", "rebuilt", "iterations_velocity", "iterations_pressure", "residual_velocity",
        "residual_pressure", "divergence"}  # not of the flow, or compared apart


@pytest.mark.parametrize("ranks, name", SCENES)
def test_particles_and_fluids_are_those_of_one_process(found, ranks, name):
    one, other = found() / name, found("auto", ranks) / name
    assert_same_state(one, other)
    assert np.array_equal(phase_of(state(one)["phi"]), phase_of(state(other)["phi"]))


@pytest.mark.parametrize("ranks, name", SCENES)
def test_measures_are_those_of_one_process(found, ranks, name):
    """Every column of the history and of the profiles: volumes, centres, angles, jumps, energies, saturations; parts of
    the fluids, fronts and steps of a drive exactly."""
    one, other = found() / name, found("auto", ranks) / name
    close = 100 * CLOSE
    for file in ("history.csv", "profiles.csv", "curve.csv"):
        assert (one / file).exists() == (other / file).exists()
        if not (one / file).exists():
            continue
        first, second = rows(one, file), rows(other, file)
        assert len(first) == len(second) and first[0].keys() == second[0].keys()
        for key in first[0].keys() - ONES:
            assert [row[key] == "" for row in second] == [row[key] == "" for row in first]
            expected, measured = ([float(row[key]) for row in table if row[key]] for table in (first, second))
            least = close * max(map(abs, expected), default=0.0)
            if key.startswith(("velocity", "mean_velocity", "superficial_velocity")):  # sums that may vanish
                # and a cell between two particles that are equally near may take the other one's
                least = 2 * close * np.abs(state(one)["u"]).max()
            elif key == "capillary_number":  # of such a sum
                least = close * max(float(row["peak_capillary_number"]) for row in first)
            assert measured == pytest.approx(expected, rel=close, abs=least), key
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in (one, other)]
    parts = [{key: value for key, value in summary["two_fluids"].items() if key.startswith(("ganglia", "trapped"))}
             for summary in summaries]
    assert parts[0] == parts[1] and len(parts[0]) >= 2


def test_bubbles_and_drops_are_cut(found):
    """Otherwise the tests above test no interface between processes: of each scene some fluid 0 and some of fluid 1
    lie with both, and several parts are in sight of the cut."""
    from isphcli.output.files import read_vtu

    for name in ("drop", "half_drop", "bubbles", "drainage"):
        folder = found("auto", 2) / name / "snapshots"
        pieces = [read_vtu(folder / f"particles_000020_{rank:05d}.vtu")[1] for rank in (0, 1)]
        assert all(set(np.unique(fields["phase"])) == {0, 1} for fields in pieces)
