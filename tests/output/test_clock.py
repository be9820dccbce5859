"""Seconds of the parts of a run: none is counted twice."""

import math
import time

from isphcli.output.clock import Clock


def test_clock_counts_nothing_twice():
    clock = Clock()
    with clock("outer"):
        time.sleep(0.02)
        for _ in range(2):
            with clock("inner"):
                time.sleep(0.02)
    wall, cpu = clock.wall(), clock.cpu()
    assert list(wall) == ["outer", "inner", "other", "total"]
    assert 0.02 <= wall["outer"] < 0.04 <= wall["inner"]
    assert math.isclose(sum(wall.values()) - wall["total"], wall["total"], rel_tol=1e-9)
    assert cpu["total"] < 0.5 * wall["total"]  # sleeping costs no CPU
    clock.add("compile", 0.01, 0.0, taken_from="inner")
    assert math.isclose(clock.wall()["inner"], wall["inner"] - 0.01)
