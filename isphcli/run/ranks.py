"""Runs on several processes: what is refused, and what rank 0 has to know of the others."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..case.yaml import CaseError, Problem
from ..domain.communicator import current
from ..domain.exchange import NeighbourExchange
from ..output.machine import peak_memory

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..domain.lattice import Particles
    from ..references.result import Result

ONE = "run it in one process (isph run, without mpiexec; --threads takes the cores of one machine)"
BY_PERMEABILITY = ("permeability", "sphere_array", "cylinder_array")  # references that need no field of the flow


def refuse_what_is_not_distributed(case: Case) -> None:
    """Raises CaseError where several processes run a case that only one can."""
    if current().size == 1:
        return
    problems = []

    def bad(key: str, what: str, fix: str = ONE) -> None:
        problems.append(Problem(str(case.path), None, key, f"{what} on {current().size} processes", fix))

    if case.flow != "stokes":
        bad("flow", "particles that move are not distributed: no run")
    if case.particles.jitter > 0.0:
        bad("particles.jitter", "its random numbers depend on who owns a particle: no jitter",
            "leave it out, or " + ONE)
    if case.output.snapshots and case.output.format == "xdmf":
        bad("output.format", "no snapshots as HDF5 with XDMF", "leave it out (particles.pvd has the flow), or " + ONE)
    if case.output.grid is not None:
        bad("output.grid", "no snapshots on a grid", "leave it out (particles.pvd has the flow), or " + ONE)
    if case.geometry.voxels is not None and case.geometry.voxels.grey is not None and (
            case.geometry.voxels.grey.uncertainty):
        bad("geometry.voxels.grey.uncertainty", "no other thresholds", "leave it out, or " + ONE)
    if problems:
        raise CaseError(tuple(problems))


def entry(particles: Particles) -> dict[str, Any] | None:
    """Entry `ranks` of the summary: (least, most) of what the processes have; None of one process."""
    ranks = current()
    if ranks.size == 1 or particles.share is None:
        return None
    exchange = particles.share.exchange
    sent = exchange.sent if isinstance(exchange, NeighbourExchange) else 0
    of_all = np.array(ranks.collect((particles.n_fluid, exchange.remote, sent, peak_memory())))
    least, most = of_all.min(axis=0).tolist(), of_all.max(axis=0).tolist()
    names = ("fluid", "remote", "sent_bytes", "peak_memory_bytes")
    return {"count": ranks.size, **{name: [low, high] for name, low, high in zip(names, least, most)}}


def whole(case: Case, result: Result) -> Result:
    """The result that a reference is compared with: where it needs fields, those of all processes on rank 0, the one
    array of the length of the scene that a run has."""
    if current().size == 1 or case.reference is None or case.reference.kind in BY_PERMEABILITY:
        return result
    fields: dict[str, Any] = {}
    for name in ("x", "velocity", "cell_velocity", "pressure", "phase"):
        found = current().gather(getattr(result, name))
        fields[name] = getattr(result, name) if found is None else np.concatenate(found)
    return replace(result, **fields)
