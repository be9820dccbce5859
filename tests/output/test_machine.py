"""Memory and versions of the machine that a run tells."""

import numpy as np

from isphcli.output.machine import peak_memory, versions


def test_peak_memory_and_versions():
    before = peak_memory()
    block = np.ones(int(2e7))  # 160 MB
    assert block.nbytes <= peak_memory() and before <= peak_memory()
    found = versions()
    assert found["numpy"] == np.__version__ and "isphcli" in found
