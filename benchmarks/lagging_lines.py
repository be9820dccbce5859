"""What a contact line that stays behind its drop does to the drop: the force of tension along the wall, and whether a
drop that is set in motion on a wall comes to rest.

usage: python benchmarks/lagging_lines.py [DIM [ANGLE ...]]     (2 or 3, degrees through the fluid around; 2 60 90 120)
    KICK and END of the environment: velocity at the start, 0.01, and end of the run, 4

A drop of the volume of half a ball of 5 spacings in radius, at its contact angle, on one of two plates 10 spacings
apart, density and tension 1, viscosity 0.03 in and around it. Its interface is drawn exactly.

force: where the front of the drop stays behind in the row of particles at the wall by a part e of a spacing, the force
of tension along the wall, to the front, less that of the exact drop, over e times the tension (in 3D times the diameter
too). Tension acts on the fluid along the wall as the angle at the line says, whatever shape the interface has, so that
none is right; what is above zero pushes the drop on.
velocity: of the drop, which begins with that of a parabola over the height, largest KICK, at t = 1, 2, ... over that at
the start; and the capillary number of the largest speed at the end. Without tension it would fall by a quarter in 1.
"""

import math
import os
import sys
from dataclasses import replace

import numpy as np
import yaml
from measuring import load_case  # noqa: F401  sets the number of threads before numba is there

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare
from isphcli.two_phase.interface import reach_of

ACROSS, MU, LAG = 10, 0.03, 0.02  # lag in spacings
KICK, END = float(os.environ.get("KICK", "0.01")), float(os.environ.get("END", "4"))


class Drop:
    """The scene of a contact angle, degrees through the fluid around, and its exact shape."""

    def __init__(self, dim, angle):
        fluids = {name: {"density": 1, "viscosity": MU} for name in ("around", "drop")}
        body = {"sphere": {"centre": [1.0, 0.0, 1.0][:dim], "radius": 0.5}, "is": "drop"}
        text = yaml.safe_dump({
            "geometry": {"box": [2.0, 1.0, 2.0][:dim], "periodic": ["x", "z"][: dim - 1], "fluid": "around",
                         "shapes": [body]},
            "particles": {"spacing": 1.0 / ACROSS}, "fluids": fluids,
            "interface": {"tension": 1, "contact_angle": angle}, "time": {"end": END, "capillary": 4}}, sort_keys=False)
        self.case = read_case(text.encode(), "case.yaml")
        self.geometry = build_geometry(self.case)
        self.state, self.stepper, self.particles = prepare(self.case, self.geometry, Clock())
        within = math.radians(180.0 - angle)
        cos = math.cos(within)
        if dim == 3:
            self.radius = (0.25 / ((2.0 + cos) * (1.0 - cos) ** 2)) ** (1.0 / 3.0)
        else:
            self.radius = math.sqrt(math.pi / 8.0 / (within - math.sin(within) * cos))
        self.centre = np.array([1.0, -self.radius * cos, 1.0])[:dim]

    def phi(self, behind=0.0):
        """Signed distances (n,) to the drop, whose places are `behind` (n,) along x, m."""
        x = self.state.x - self.centre
        x[:, 0] += behind
        reach = reach_of(self.stepper.reach, self.stepper.spacing)
        return np.clip(np.linalg.norm(x, axis=1) - self.radius, -reach, reach)

    def force(self, phi):
        """Of tension along x on the front half of the box, N (in 2D N/m)."""
        config = self.stepper.configure(self.state.x, phi=phi)
        front = self.state.x[:, 0] > 1.0
        return config.ops.volume[front] @ config.terms.jump_acceleration[front, 0]

    def velocities(self):
        """(times, velocity of the drop over that at the start, last Ca of the largest speed) after a kick."""
        x, u = self.state.x, np.zeros_like(self.state.x)
        u[:, 0] = 4.0 * KICK * x[:, 1] * (1.0 - x[:, 1])
        state = replace(self.state, phi=self.phi(), u=u, u_old=u.copy())
        times, found, last = [0.0], [u[state.phi < 0.0, 0].mean()], 0.0
        advance = self.stepper.advance

        def noting(*asked):
            nonlocal last
            done = advance(*asked)
            if done.state.time >= len(times):
                times.append(done.state.time)
                found.append(done.state.u[done.state.phi < 0.0, 0].mean())
            last = MU * np.linalg.norm(done.state.u, axis=1).max()
            return done

        self.stepper.advance = noting
        volume = float(np.prod(self.geometry.upper - self.geometry.lower))
        loop = TimeLoop(self.case, self.stepper, self.particles.site_volume, volume)
        nothing = lambda *_: None  # noqa: E731
        loop.run(state, self.stepper.ready(state), nothing, nothing, nothing)
        return times, np.array(found) / found[0], last


def main(dim="2", *angles):
    print("| dim | angle | force | velocity at t = 1, 2, ... | Ca at the end |\n|---|---|---|---|---|")
    for angle in map(float, angles or (60, 90, 120)):
        drop = Drop(int(dim), angle)
        x, dx = drop.state.x, drop.stepper.spacing
        behind = np.where((x[:, 1] < dx) & (x[:, 0] > 1.0), LAG * dx, 0.0)
        force = (drop.force(drop.phi(behind)) - drop.force(drop.phi())) / LAG
        if dim == "3":
            force /= 2.0 * drop.radius * math.sin(math.radians(angle))
        _, velocity, last = drop.velocities()
        print(f"| {dim} | {angle:g} | {force:+.2f} | {', '.join(f'{v:+.2f}' for v in velocity[1:])} | {last:.1e} |",
              flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
