"""The fluid at one time, what depends on its positions alone, and what a step returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..domain import reduce

if TYPE_CHECKING:
    from ..domain.neighbours import Neighbourhood
    from ..domain.null_space import ComponentMeans
    from ..operators.pair_weights import Operators
    from ..solvers.krylov import Convergence
    from .one_fluid import Terms


@dataclass(frozen=True)
class State:
    """Fluid particles at one time.

    x, u, u_old: (n, dim) m and m/s; p: (n,) pressure over the density of the first fluid, m2/s2; time: s; dt_old:
    length of the step before, s, 0 before the first. Of a scene that holds a superficial velocity, otherwise None:
    pressure_gradient: over the density of the first fluid, m/s2, that held it (`HeldVelocity`). Of two fluids,
    otherwise None: phi: (n,) signed distance to their interface, positive in the first one, m; volume: (n,) m^dim, the
    share of a particle in the volume of its connected part of a fluid (two_phase/kept_volumes.py). Of a drive in steps,
    otherwise None: pressure_gradient: as above, of this step; drive_step: (4,) which one, and what was seen of it
    (`drive_steps.begun`). Of several processes, otherwise None: number: (n,) int64 of the particles, which one process
    has in this order.
    """

    x: np.ndarray
    u: np.ndarray
    u_old: np.ndarray
    p: np.ndarray
    time: float = 0.0
    step: int = 0
    dt_old: float = 0.0
    pressure_gradient: float | None = None
    phi: np.ndarray | None = None
    drive_step: np.ndarray | None = None
    number: np.ndarray | None = None
    volume: np.ndarray | None = None


def phase_of(phi: np.ndarray) -> np.ndarray:
    """(n,) int8 fluid of particles, 0 or 1, from `State.phi` (n,), which is positive in the first fluid."""
    return (phi <= 0.0).astype(np.int8)


@dataclass(frozen=True)
class Configuration:
    """Everything that depends on the positions only.

    ops: Operators; neighbours: all of them, dummies included; means: of the connected parts of the fluid; halo: number
    of periodic images; terms: the operators with the densities and viscosities of the fluids, and the forces.
    """

    ops: Operators
    neighbours: Neighbourhood
    means: ComponentMeans
    halo: int
    terms: Terms

    @property
    def x(self) -> np.ndarray:
        """(n, dim) positions of the fluid particles, m."""
        return self.neighbours.x[: self.ops.n]


class Handover:
    """The configuration of a state, for the step that takes it over. The step reads it before it makes that of its end,
    and is the only one that holds it: with the weights of the pairs it is most of what a run of moving particles has in
    memory, and two of them at a time would be twice that. Whoever reads it afterwards keeps it beside this."""

    def __init__(self, config: Configuration):
        self._config: Configuration | None = config

    def look(self) -> Configuration:
        """The configuration, which is not to be kept."""
        assert self._config is not None  # taken by now
        return self._config

    def take(self) -> Configuration:
        """The configuration, which is not here any more."""
        config, self._config = self.look(), None
        return config


@dataclass(frozen=True)
class StepResult:
    """What a step made, and what it found on the way.

    state, config: after the step; dt: its length, s; divergence: (n,) of the new velocity, 1/s; stopped: particles that
    would have entered a wall and stayed where they were; solves: {system: Convergence of its hardest solve}; rebuilt:
    whether a hierarchy was built; volume_drift: root mean square deviation of the number of particles in blocks, or
    None where it is not controlled.
    """

    state: State
    config: Configuration
    dt: float
    divergence: np.ndarray
    stopped: int
    solves: dict[str, Convergence]
    rebuilt: bool
    volume_drift: float | None = None

    @property
    def max_divergence(self) -> float:
        """Largest divergence times the step: the part of its volume that a particle gains, at most."""
        return float(reduce.largest(np.abs(self.divergence))) * self.dt
