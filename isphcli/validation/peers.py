"""Errors and CPU seconds of other codes, `data/peers.csv`, and which of them a case may be compared with.

A row is comparable where the kind of reference, the measured error and every parameter agree within
`CLOSE`. `parameters` is `name=value;name=value`; `?` stands for a value that was not recorded, an empty
`cpu_seconds` for a time that was not.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..case.blocks import Case

TABLE = Path(__file__).parents[1] / "data" / "peers.csv"
CLOSE = 0.01  # relative difference of parameters that count as equal


@dataclass(frozen=True)
class Peer:
    """One measured run of another code; error as in `compare`, parameters None where not recorded."""

    code: str
    version: str
    kind: str
    parameters: Mapping[str, float | None]
    points: int
    error_name: str
    error: float
    cpu_seconds: float | None
    source: str
    command: str
    machine: str


def load_peers(path: Path = TABLE) -> list[Peer]:
    """All rows of the table."""
    with open(path, newline="", encoding="utf-8") as file:
        return [_peer(row) for row in csv.DictReader(file)]


def _peer(row: dict[str, str]) -> Peer:
    text = dict(part.split("=") for part in row["parameters"].split(";"))
    parameters = {name: None if value == "?" else float(value) for name, value in text.items()}
    return Peer(
        code=row["code"], version=row["version"], kind=row["kind"], parameters=parameters,
        points=int(row["points"]), error_name=row["error_name"], error=float(row["error"]),
        cpu_seconds=float(row["cpu_seconds"]) if row["cpu_seconds"] else None,
        source=row["source"], command=row["command"], machine=row["machine"],
    )  # fmt: skip


def parameters_of(case: Case) -> dict[str, float]:
    """Parameters that a peer must share with a case: Reynolds number U L / nu, time U t / L, jitter; solid fraction."""
    reference = case.reference
    if reference is None:
        return {}
    found = {name: float(v) for name, v in reference.parameters.items() if isinstance(v, (int, float))}
    speed, box, time = found.get("speed"), case.geometry.box, case.time
    if reference.kind.startswith("taylor_green") and speed and box:
        nu = found.get("nu", case.fluids[case.fluid_names[0]].nu)
        found |= {"reynolds": speed * box[0] / nu, "jitter": case.particles.jitter}
        if time is not None and time.end is not None:
            found["time"] = speed * time.end / box[0]
    return found


def difference(case: Case, peer: Peer) -> str | None:
    """Why a peer of the same kind is not comparable with a case; empty where it is, None for another kind."""
    if case.reference is None or peer.kind != case.reference.kind:
        return None
    ours = parameters_of(case)
    parts = []
    for name, theirs in peer.parameters.items():
        mine = ours.get(name)
        if theirs is None:
            parts.append(f"its {name} was not recorded")
        elif mine is None or abs(theirs - mine) > CLOSE * max(abs(theirs), abs(mine)):
            parts.append(f"{name} {theirs:g}" + ("" if mine is None else f" against {mine:g}"))
    return ", ".join(parts)


def peers_of(case: Case) -> list[tuple[Peer, str]]:
    """Peers of the kind of a case, each with why it is not comparable (empty where it is)."""
    found = [(peer, difference(case, peer)) for peer in load_peers()]
    return [(peer, why) for peer, why in found if why is not None]
