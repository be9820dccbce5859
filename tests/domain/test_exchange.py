"""Of one process; remote particles are tested by tests/test_ranks.py, whose operators need them."""

import numpy as np

from isphcli.domain.exchange import NO_EXCHANGE


def test_one_process_has_no_remote_particles():
    values = np.arange(6.0).reshape(3, 2)
    assert NO_EXCHANGE.forward(values) is values and NO_EXCHANGE.remote == 0
    assert NO_EXCHANGE.numbers(3).tolist() == [0, 1, 2]
