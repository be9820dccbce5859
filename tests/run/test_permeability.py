"""Permeabilities of several spacings, extrapolated."""

import numpy as np
import pytest

from isphcli.run.permeability import extrapolate


def test_extrapolation_recovers_a_power_law():
    h = np.array([1.0, 0.5, 0.25])
    limit, bar, order, sentence = extrapolate(h, 3.0 + 0.2 * h**1.7)
    assert limit == pytest.approx(3.0, rel=1e-8) and order == pytest.approx(1.7, rel=1e-6)
    assert bar == pytest.approx(0.2 * 0.25**1.7, rel=1e-6) and "observed" in sentence
    limit, bar, order, _ = extrapolate(h, [1.0, 2.0, 1.5])  # no trend: the finest value and the spread
    assert (limit, bar, order) == (1.5, 1.0, None)
