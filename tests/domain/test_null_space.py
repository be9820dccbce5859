"""The projection that takes the constants of all components out of a vector (eq. 26)."""

import numpy as np
import pytest

from isphcli.domain.null_space import ComponentMeans


def test_component_means():
    labels = np.array([0, 1, 0, 2, 1])
    v = np.array([1.0, 10.0, 3.0, 7.0, 20.0])
    assert ComponentMeans(labels).remove(v).tolist() == [-1.0, -5.0, 1.0, 0.0, 5.0]
    assert ComponentMeans(np.zeros(5, int)).remove(v).sum() == pytest.approx(0.0, abs=1e-14)
    assert v[0] == 1.0
