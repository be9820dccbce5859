"""An image beside the cases that name one."""

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = np.zeros((8, 8, 20), np.uint8)
    values[:, 6:] = 1
    np.save("rock.npy", values)
    return tmp_path
