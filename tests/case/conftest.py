"""Every test of cases has a folder of its own, with the files that its cases name."""

import pytest


@pytest.fixture(autouse=True)
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("beads.npz", "beads.csv"):
        (tmp_path / name).touch()
    return tmp_path
