"""Snapshots of either format are read alike."""

import numpy as np
import pytest

from isphcli.output.files import Series
from isphcli.output.snapshots import read_series, read_snapshot
from isphcli.output.xdmf import XdmfSeries


@pytest.mark.parametrize("kind", [Series, XdmfSeries])
def test_what_was_written_is_read(tmp_path, kind):
    if kind is XdmfSeries:
        pytest.importorskip("h5py")
    x, p = np.random.default_rng(0).random((9, 3)), np.arange(9.0)
    assert read_series(tmp_path) == []
    series = kind(tmp_path)
    for step in (0, 5):
        series.write(step, 0.5 * step, x + step, {"pressure": p})
    (first, _), (time, file) = read_series(tmp_path)
    assert (first, time) == (0.0, 2.5)
    found, fields = read_snapshot(tmp_path / file)
    assert np.array_equal(found, x + 5) and np.array_equal(fields["pressure"], p)
