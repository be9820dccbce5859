"""The result of a check of a case before it is run, and its text."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..case.blocks import AXES
from ..geometry.pore_sizes import ENOUGH_ACROSS

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..geometry.connectivity import Connectivity


@dataclass(frozen=True)
class Physics:
    """A part of the physics, whether the case uses it, and why."""

    name: str
    used: bool
    why: str


@dataclass(frozen=True)
class Throats:
    """Widths of the pores in spacings, at the points farthest from their walls.

    narrow, median: 10 % and half of the fluid lie in narrower pores; thin: share of the fluid where fewer than
    `ENOUGH_ACROSS` particles lie across (`distributions.png` has another share: of the volume that balls of fewer fill,
    `geometry.pore_sizes`); critical: per axis, the largest ball that passes along it, up to 0.7 spacings too small
    and hardly too large, for periodic axes only, because closed faces count as walls.
    """

    narrow: float
    median: float
    thin: float
    critical: dict[int, float]


@dataclass(frozen=True)
class Motion:
    """The speed of the fastest particle as a check expects it, m/s, t in s:

        start exp(-t / decay) + driven (1 - exp(-t / rise)) + always

    acceleration: of the fluid at the start, m/s2.
    """

    start: float = 0.0
    decay: float = math.inf
    driven: float = 0.0
    rise: float = 1.0
    always: float = 0.0
    acceleration: float = 0.0

    def speed(self, time: float) -> float:
        """At a time, s, m/s."""
        risen = -self.driven * math.expm1(-time / self.rise) if self.driven else 0.0
        return self.start * math.exp(-time / self.decay) + risen + self.always

    @property
    def largest(self) -> float:
        """The largest speed over time, m/s: at the start or at the end."""
        return max(self.start, self.driven) + self.always


@dataclass(frozen=True)
class Flow:
    """Estimates of the flow: velocity (m/s) and how it was found, Reynolds and capillary number; over time."""

    velocity: float
    source: str
    reynolds: float | None
    capillary: float | None
    motion: Motion


@dataclass(frozen=True)
class Steps:
    """Time-step limits by name in the fastest flow, s; the steps of the whole run, None where they are unknown; those
    at the start that are shorter than the limits; whether the run may end earlier; the limit that bounds most steps,
    "end" where a snapshot or the end was due."""

    limits: dict[str, float]
    count: float | None
    start: int = 0
    early: bool = False
    most: str = ""

    @property
    def binding(self) -> str:
        """The smallest limit."""
        return min(self.limits, key=lambda name: self.limits[name])


@dataclass(frozen=True)
class ShareOfRank:
    """The largest of `count` processes: its fluid particles, the remote ones that these see, bytes by part, and
    seconds."""

    count: int
    fluid: float
    remote: float
    memory: dict[str, float]
    seconds: float | None


@dataclass(frozen=True)
class SecondSolve:
    """The second solve of `refine: throats`: expected particles, and those with half the spacing everywhere; bytes and
    seconds of the expected ones."""

    particles: float
    most: float
    memory: float
    seconds: float


@dataclass
class CheckResult:
    """The result of a check of a case; lengths in m, axes in the order x, y(, z)."""

    case: Case
    dim: int
    physics: list[Physics]
    particles: dict[str, int]
    connectivity: Connectivity | None = None
    throats: Throats | None = None
    flow: Flow | None = None
    steps: Steps | None = None
    microporous: dict[str, float] = field(default_factory=dict)  # shares of the sample, by the names of the rocks
    spacings: list[float] = field(default_factory=list)  # m, those that are solved
    neighbours: float = 0.0
    memory: dict[str, float] = field(default_factory=dict)  # bytes, by part
    seconds: float | None = None  # one core
    second: SecondSolve | None = None  # part of memory and seconds
    ranks: ShareOfRank | None = None  # where it was asked for several processes
    inputs: tuple[tuple[str, str], ...] = ()  # what was read and how it was understood: (name, text)
    warnings: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    @property
    def can_run(self) -> bool:
        """Whether nothing stands against a run."""
        return not self.errors

    def text(self) -> str:
        """The report as it is printed."""
        return "\n".join(report_lines(self))


# -- text ------------------------------------------------------------------------------------------------


def report_lines(r: CheckResult) -> Iterator[str]:
    """The lines of `isph validate --check-only`, in order; of a case that is refused by its size only why."""
    case = r.case
    yield f"{case.path or 'case'}: {case.title}".rstrip(": ")
    if not r.physics:  # refused by its size
        yield from (_row("ERROR", text) for text in r.errors)
        yield _row("verdict", "cannot run")
        return
    yield from (_row(name, text) for name, text in r.inputs)
    used = [f"{t.name} ({t.why})" for t in r.physics if t.used]
    out = [f"{t.name} ({t.why})" for t in r.physics if not t.used]
    yield _row("uses", "; ".join(used))
    yield _row("leaves out", "; ".join(out))
    if r.particles:
        p = r.particles
        kind = f"{case.lattice_in(r.dim)}, spacing {case.particles.spacing:g} m, support {case.support:g}"
        yield _row("lattice", f"{r.dim}D {kind}, about {r.neighbours:.0f} neighbours")
        more = f"{p['dummy']} dummy, {p['left_out']} sites left out" if "dummy" in p else "dummies not counted"
        yield _row("particles", f"{p['fluid']} fluid, {more}")
    if r.connectivity is not None:
        yield from _pore_lines(r.connectivity, r.microporous, r.throats)
    if r.flow is not None:
        numbers = [f"about {r.flow.velocity:.2g} m/s ({r.flow.source})"]
        numbers += [f"Re {r.flow.reynolds:.2g}"] if r.flow.reynolds is not None else []
        numbers += [f"peak Ca {r.flow.capillary:.2g}"] if r.flow.capillary is not None else []
        yield _row("flow", ", ".join(numbers))
    if r.steps is not None:
        limits = ", ".join(f"{name} {dt:.2g} s" for name, dt in r.steps.limits.items())
        count = "steps: no telling"
        if r.steps.count is not None:
            about = "at most about" if r.steps.early else "about"
            count = f"{about} {whole(r.steps.count, 2)} steps, of which {r.steps.start} begin shorter"
        yield _row("time step", f"{limits}; smallest: {r.steps.binding}; {count}")
    if r.memory:
        parts = ", ".join(f"{name} {in_bytes(b)}" for name, b in r.memory.items())
        yield _row("memory", f"about {in_bytes(sum(r.memory.values()))} ({parts})")
        if r.seconds is not None:
            yield _row("time", f"about {_seconds(r.seconds)} on one core, without compilation and pictures")
    if r.case.refine == "auto" and r.spacings:
        told = ", ".join(f"{spacing:.4g}" for spacing in r.spacings)
        yield _row("refine", f"auto: spacings {told} m in the memory and time above, as free memory and refine_budget "
                             "let expect")
    if r.second is not None:
        second = r.second
        times = second.most / second.particles
        yield _row("refine", f"throats: a second solve, of about {whole(second.particles, 2)} particles in the memory "
                             f"and time above; where it loses its energy everywhere up to {whole(second.most, 2)}, "
                             f"{in_bytes(times * second.memory)} and {_seconds(times * second.seconds)}")
    if r.ranks is not None:
        each = f"{r.ranks.fluid:,.0f} fluid particles and about {r.ranks.remote:,.0f} remote ones"
        time = "" if r.ranks.seconds is None else f", {_seconds(r.ranks.seconds)}"
        yield _row("ranks", f"each of {r.ranks.count:,}: {each}, about {in_bytes(sum(r.ranks.memory.values()))}{time}")
    for text in r.warnings:
        yield _row("WARNING", text)
    for text in r.errors:
        yield _row("ERROR", text)
    yield _row("verdict", "can run" if r.can_run else "cannot run")


def _pore_lines(c: Connectivity, microporous: dict[str, float], widths: Throats | None) -> Iterator[str]:
    axes = AXES[: len(c.percolates)]
    through = [f"{a} ({100 * f:.2f} %)" for a, p, f in zip(axes, c.percolates, c.percolating_porosity) if p]
    rocks = "".join(f"microporous {name} {100 * share:.2f} %, " for name, share in microporous.items())
    closed = f" ({100 * c.isolated_share:.3g} % of the fluid)" if c.isolated_pockets else ""
    yield _row(
        "pores",
        f"porosity {100 * max(c.porosity - sum(microporous.values()), 0.0):.2f} %, {rocks}{c.components} connected, "
        f"{c.isolated_pockets} closed pockets{closed}; open along {', '.join(through) or 'no axis'}",
    )
    if widths is not None:
        critical = "".join(f"; narrowest along {AXES[a]} {w:.1f}" for a, w in widths.critical.items())
        yield _row(
            "throats",
            f"median {widths.median:.1f} particles wide, 10 % of the fluid in pores below {widths.narrow:.1f}, "
            f"{100 * widths.thin:.0f} % below {ENOUGH_ACROSS}{critical}",
        )


def _row(name: str, text: Any) -> str:
    return f"  {name:10}  {text}"


def whole(number: float, digits: int) -> str:
    """A whole number with so many digits that count: '8,600'."""
    return f"{int(float(f'{number:.{digits - 1}e}')):,}" if number >= 10**digits else f"{number:.0f}"


def in_bytes(number: float) -> str:
    """A number of bytes in words: '1.23 GB'."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.0f} B"


def _seconds(seconds: float) -> str:
    from ..output.progress import duration

    return duration(max(seconds, 0.1))
