"""The worst particles of a step that failed."""

import numpy as np

from isphcli.output.files import read_vtu
from isphcli.output.worst import write_worst


def test_worst_particles_without_a_number_are_written(tmp_path):
    """A residual that is not finite is the worst of all."""
    path = write_worst(tmp_path / "worst.vtu", np.arange(6.0).reshape(3, 2), np.array([1, np.nan, -np.inf]))
    found = read_vtu(path)[1]
    assert found["particle"].tolist() == [1, 2, 0] and np.isfinite(found["violation"]).all()
