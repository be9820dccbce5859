# ruff: noqa: RUF009  (a dataclass default that is a call is what `key` is for; it makes a `field`)
"""A case: everything that a user can ask for, its reader and its writer.

The blocks are declared in `case_blocks`. A `None` that the case itself can decide (`support`, `lattice`,
`output.directory`, ...) is filled in by `load_case`; the properties of `Case` decide it for cases that were
made in Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from .case_blocks import (
    AXES,
    FIELDS,
    FLOWS,
    LATTICES,
    REFERENCE_KINDS,
    SOLID,
    SUPPORT,
    SUPPORT_MOVING_2D,
    SUPPORT_TENSION_2D,
    Drive,
    Fluid,
    Initial,
    Interface,
    Lattice,
    Output,
    Reference,
    Scene,
    Shape,
    Solver,
    Time,
    Voxels,
    Wall,
)
from .case_reader import Reader, Table, key, keys_of
from .case_yaml import MAX_BYTES, CaseError, Problem, Report, Where, override, parse

__all__ = [
    "AXES",
    "FIELDS",
    "REFERENCE_KINDS",
    "SOLID",
    "Case",
    "CaseError",
    "Drive",
    "Fluid",
    "Initial",
    "Interface",
    "Lattice",
    "Output",
    "Problem",
    "Reference",
    "Scene",
    "Shape",
    "Solver",
    "Table",
    "Time",
    "Voxels",
    "Wall",
    "dump_case",
    "load_case",
    "read_case",
]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case: everything that was asked for."""

    title: str = key("free text", default="")
    geometry: Scene = key("where there is fluid and where there is solid")
    particles: Lattice = key("resolution and arrangement of the particles")
    fluids: Table[Fluid] = key("name: properties of the fluid, one block each")
    interface: Interface | None = key("surface tension, with two fluids", default=None)
    drive: Drive | None = key("what makes the fluid move", default=None)
    initial: Initial | None = key("the state at time zero. Without it: at rest", default=None)
    flow: str = key(
        "navier_stokes: moving particles, in time; stokes: steady creeping flow on the fixed lattice",
        default="navier_stokes",
        choices=FLOWS,
    )
    time: Time | None = key("how long and in which steps (navier_stokes)", default=None)
    solver: Solver = key("the linear solvers", default=Solver())
    refine: tuple[float, ...] = key(
        "further spacings at which the same case is solved, to extrapolate (stokes)",
        default=(),
        unit="m",
        above=0,
        unique=True,
    )
    output: Output = key("what the run leaves behind", default=Output())
    reference: Reference | None = key("what `isph validate` compares with", default=None)

    path: Path | None = field(default=None, compare=False)
    """The file that the case was read from."""

    @property
    def dim(self) -> int | None:
        """2 or 3; None for an image, which has to be read first."""
        return None if self.geometry.box is None else len(self.geometry.box)

    @property
    def fluid_names(self) -> tuple[str, ...]:
        """In case order: `phase` of a particle is the index into them."""
        return tuple(self.fluids)

    @property
    def support(self) -> float:
        """Support radius over the spacing."""
        if self.particles.support is not None:
            return self.particles.support
        if self.flow == "navier_stokes" and self.dim == 2:
            return SUPPORT_MOVING_2D if self.interface is None else SUPPORT_TENSION_2D
        return SUPPORT

    @property
    def wall_distance(self) -> str:
        """How the wall distance is found: smooth or stairs of an image, exact of shapes."""
        return self.geometry.wall_distance or ("smooth" if self.geometry.voxels else "exact")

    def lattice_in(self, dim: int) -> str:
        """The arrangement of the particles of a scene with `dim` dimensions."""
        return self.particles.lattice or LATTICES[dim][0]

    def completed(self) -> Case:
        """The same case with all that it can decide by itself filled in."""
        geometry, particles = self.geometry, self.particles
        geometry = replace(geometry, wall_distance=self.wall_distance)
        particles = replace(particles, support=self.support)
        if self.dim:
            origin = geometry.origin or (0.0,) * self.dim
            geometry = replace(geometry, origin=origin, fluid=geometry.fluid or self.fluid_names[0])
            particles = replace(particles, lattice=self.lattice_in(self.dim))
        directory = self.output.directory or Path("out", self.path.stem if self.path else "case").absolute()
        return replace(
            self, geometry=geometry, particles=particles, output=replace(self.output, directory=directory)
        )


def load_case(path: str | Path, overrides: Sequence[str] = ()) -> Case:
    """Read a case file, with the `key.sub=value` of each `--set` put in.

    Raises `CaseError` with everything that is wrong with it.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise CaseError((Problem(str(path), None, "", f"cannot be read: {reason}"),)) from None
    return read_case(data, path, overrides)


def read_case(data: bytes, path: str | Path, overrides: Sequence[str] = ()) -> Case:
    """As `load_case`, from the bytes of the file; `path` is for messages and relative paths."""
    from .case_checks import check_case

    report = Report()
    root = parse(data, Where(str(path), 1), report)
    if root is not None:
        for text in overrides:
            override(root, text, report)
        source = Path(path).absolute()
        reader = Reader(source.parent, report)
        case = reader.read(Case, root)
        if case is not None:
            check_case(case, report, reader.places)
    report.raise_if_any()
    return replace(case, path=source).completed()


def dump_case(case: Case) -> str:
    """The case as YAML, defaults filled in and what is absent left out; `load_case` reads it back."""
    return yaml.safe_dump(
        plain(case), sort_keys=False, allow_unicode=True, default_flow_style=None, width=110
    )


def plain(value: Any) -> Any:
    """Dataclasses, tables and tuples as the dicts and lists that YAML knows, without what is None."""
    if is_dataclass(value):
        cls: Any = type(value)
        attributes = {k.name: getattr(value, k.attribute) for k in keys_of(cls).values()}
        return {name: plain(v) for name, v in attributes.items() if v is not None}
    if isinstance(value, Table):
        return {name: plain(v) for name, v in value.items()}
    if isinstance(value, tuple):
        return [plain(v) for v in value]
    return str(value) if isinstance(value, Path) else value
