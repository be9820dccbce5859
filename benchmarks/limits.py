"""What good runs and runs that blow up reach of the limits in isphcli/flow/step_limits.py, at several shiftings.

    PYTHONPATH=. python benchmarks/limits.py [--shifting 0.1 0.3] [--free]

--free: without the limits, for at most 300 steps. Columns: largest root mean square speed over what the step before
allows, largest divergence times dt, smallest and largest volume over that of a site, steps, and how it ended. Steps
that were refused and repeated with half their length do not count.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from dataclasses import replace
from pathlib import Path

import numpy as np

from isphcli.flow.step_limits import Bounds, RunError
from isphcli.validation import stress

CASES = Path(__file__).parent.parent / "cases"
VORTEX_100 = ("particles.spacing=0.04", "particles.jitter=0")


def together(state):
    """The second particle on the first one."""
    x = state.x.copy()
    x[1] = x[0]
    return replace(state, x=x)


def case(name, *sets):
    """The text of a case of cases/, and its overrides."""
    return (CASES / f"{name}.yaml").read_text(), sets


LOW, HIGH = "fluids.water.viscosity=1", "fluids.water.viscosity=1e-3"
SCENES = {
    "Couette": case("couette"),
    "cavity Re 100, 16 across": case("lid_driven_cavity", "particles.spacing=0.0625", "time.end=4"),
    "vortex Re 2 pi": case("taylor_green_2d"),
    "vortex 3D, 12 across": case("taylor_green_3d", "particles.spacing=0.0833"),
    "vortex Re 100 from 20 % jitter": case("taylor_green_2d_re100", "particles.spacing=0.04"),
    "vortex Re 100 from 50 % jitter": case("taylor_green_2d_re100", "particles.spacing=0.04", "particles.jitter=0.5"),
    "vortex Re 100 from a lattice": case("taylor_green_2d_re100", *VORTEX_100),
    "vortex Re 100, cfl 1": case("taylor_green_2d_re100", "particles.spacing=0.04", "time.cfl=1"),
    "vortex, two coincident particles": (stress.VORTEX, ("particles.jitter=0", "time.end=0.5"), together),
    "disk array, creeping": (stress.DISK, ("time.max_steps=200",)),
    "disk array, Re 1e3": (stress.DISK, (HIGH, "time.end=5", "time.max_steps=200")),
    "sphere array": (stress.SPHERES, ("time.max_steps=100",)),
    "sphere array, bcc, Re 1e3": (stress.SPHERES, (HIGH, "particles.lattice=bcc", "time.max_steps=100")),
    "orifice one particle wide": (stress.ORIFICE, ("particles.spacing=0.1", "time.end=2")),
    "orifice two particles wide": (stress.ORIFICE, ("time.end=2",)),
    "orifice two particles wide, creeping": (stress.ORIFICE, (LOW, "time.end=2")),
    "cavity Re 1e3, 10 across": (stress.CAVITY, (HIGH, "time.end=6")),
    "cavity Re 1e3, 20 across": (stress.CAVITY, (HIGH, "time.end=4", "particles.spacing=0.05")),
    "cavity Re 1e3, 32 across": (stress.CAVITY, (HIGH, "time.end=4", "particles.spacing=0.03125")),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shifting", type=float, nargs="+", default=[0.1, 0.3])
    parser.add_argument("--free", action="store_true")
    asked = parser.parse_args()
    real, seen = Bounds.check, []

    def check(self, old, found):
        new, dt = found.state, found.dt
        density = found.config.terms.density
        volume = found.config.ops.volume[: len(new.x)] / self.site_volume
        force = self.force if self.largest_force is None else self.largest_force(new.time)
        with np.errstate(all="ignore"):
            allowed = self.speed(old.u, density) + force * dt + self.other
            growth = self.speed(new.u, density) / allowed if allowed > 0.0 else 0.0
        if not asked.free:
            real(self, old, found)
        seen.append((growth, np.abs(found.divergence).max() * dt, volume.min(), volume.max()))

    Bounds.check = check
    print(f"{'':38}{'shifting':>9}{'growth':>9}{'div dt':>9}{'volume':>13}{'steps':>7}  outcome")
    for name, (text, sets, *change) in SCENES.items():
        for amount in asked.shifting:
            seen.clear()
            more = [f"particles.shifting={amount}", *(["time.max_steps=300"] if asked.free else [])]
            try:
                run = stress.stepped(text, *sets, *more, change=change[0] if change else None)
                outcome = run.loop.outcome
            except RunError as error:
                outcome = str(error).split(";")[0][:60]
            if not seen:  # the first step failed
                print(f"{name:38}{amount:9g}  {outcome}", flush=True)
                continue
            growth, divergence, low, high = np.array(seen).T
            print(f"{name:38}{amount:9g}{growth.max():9.4g}{divergence.max():9.2g}{low.min():7.2f}{high.max():6.2f}"
                  f"{len(seen):7}  {outcome}", flush=True)


if __name__ == "__main__":
    main()
