"""Memory and versions of the machine that a run tells."""

import subprocess
import sys

import numpy as np

from isphcli.output.machine import peak_memory, versions


def test_peak_memory_and_versions():
    before = peak_memory()
    block = np.ones(int(2e7))  # 160 MB
    assert block.nbytes <= peak_memory() and before <= peak_memory()
    found = versions()
    assert found["numpy"] == np.__version__ and "isphcli" in found


def test_the_peak_is_that_of_the_process_not_of_the_one_that_started_it():
    block = np.ones(60_000_000)  # 480 MB
    line = "from isphcli.output.machine import peak_memory; print(peak_memory())"
    child = subprocess.run([sys.executable, "-c", line], capture_output=True, text=True, check=True)
    assert int(child.stdout) < block.nbytes / 2
