"""Means over the last part of a run: their standard errors hold, and noise is told as such."""

import numpy as np
import pytest

from isphcli.runs.late_means import late_mean, noise_of_the_drop


def rows(values, times=None):
    times = np.arange(1, len(values) + 1) if times is None else times
    return [{"time": float(t), "drop": value} for t, value in zip(times, values)]


def test_the_error_of_a_mean_is_the_standard_error_of_white_noise():
    """Of 400 runs of 800 steps: the means lie about the truth as far as their errors say, to 10 %; the scatter is that
    of the steps. 6 degrees of freedom of each error are right in the mean of its square."""
    random = np.random.default_rng(3)
    found = [late_mean(rows(7.0 + 2.0 * random.standard_normal(800)), "drop", 600.0) for _ in range(400)]
    means, errors = np.array([f.mean for f in found]), np.array([f.error for f in found])
    assert means.std() == pytest.approx(2.0 / np.sqrt(200), rel=0.1)
    assert np.sqrt((errors**2).mean()) == pytest.approx(means.std(), rel=0.1)
    assert np.mean([f.scatter for f in found]) == pytest.approx(2.0, rel=0.02)


def test_a_drift_is_no_noise_and_steps_count_by_their_length():
    """A line in steps of unequal length: the mean over the time, in which a step has the value of its end."""
    times = np.cumsum(np.tile([0.5, 1.5], 40))
    found = late_mean(rows(3.0 * times, times), "drop", 0.0)
    lengths = np.diff(times, prepend=0.0)
    assert found.mean == pytest.approx(3.0 * times @ lengths / times[-1])
    assert found.error < 1e-12 * found.mean and not found.is_noise and noise_of_the_drop(found) is None


def test_few_values_have_no_error():
    assert late_mean(rows([1.0] * 20), "drop", 13.0) is None  # seven values
    sparse = rows([None if k % 20 else 5.0 for k in range(800)])
    assert late_mean(sparse, "drop", 600.0).mean == pytest.approx(5.0)
    assert late_mean(sparse, "drop", 700.0) is None and late_mean(sparse, "other", 0.0) is None


@pytest.mark.parametrize("size, is_noise", [(0.5, False), (40.0, True)])
def test_a_drop_whose_steps_scatter_by_more_than_its_mean_is_noise(size, is_noise):
    random = np.random.default_rng(5)
    found = late_mean(rows(6e3 * (1.0 + size * random.standard_normal(400))), "drop", 300.0)
    said = noise_of_the_drop(found)
    assert found.is_noise == is_noise == (said is not None)
    if said:
        assert f"{found.mean:.3g} Pa +- {found.error:.2g}" in said
        assert "resolves throats" in said and "resolves throats" not in noise_of_the_drop(found, walls=False)
