"""Which engine a run gets."""

import sys

import pytest

from isphcli.domain.communicator import RanksError
from isphcli.solvers import engine


def test_one_process_needs_no_petsc(monkeypatch):
    monkeypatch.setitem(sys.modules, "petsc4py", None)
    monkeypatch.delitem(sys.modules, "isphcli.solvers.petsc", raising=False)
    assert engine.engine_of("auto") is engine.ONE_PROCESS
    with pytest.raises(RanksError, match="petsc4py is not there") as caught:
        engine.engine_of("petsc")
    assert all(way in str(caught.value) for way in ("apt-get install", "isphcli[mpi]", "modules of MPI"))
