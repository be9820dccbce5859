"""Moving flow between clear layers: what is held and what is counted, wherever the ends of the sample lie.

    PYTHONPATH=. python benchmarks/ends_of_samples.py

A channel of half the height with flat ends, 4 particles across. At the start its ends lie between two layers of
particles, a quarter of a layer off, or on them. Printed are the porosity of summary.json (0.5); over the flux that is
asked, of the first step and of the last half of the steps to a steady drop, that of the clear layers farther than half
a layer from the rock and that of the channel; and the drop, Pa. Then porosity and drop of steady flow.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.runs.run import run_case
from isphcli.runs.time_loop import TimeLoop
from isphcli.scene.build_geometry import build_geometry
from isphcli.scene.prepare import prepare

SPACING, ASKED, DENSITY, VISCOSITY = 0.125, 0.1, 2.0, 0.5
CASE = """
geometry:
  voxels: {{file: channel.npy, labels: {{solid: 1, water: 0}}, voxel_size: 0.0625, clear_layer: {clear}}}
  periodic: [y]
particles: {{spacing: {spacing}, offset: [{offset}, 0]}}
fluids: {{water: {{density: {density}, viscosity: {viscosity}}}}}
{flow}
output: {{directory: out, plots: false, snapshots: false}}
"""
HELD = f"drive: {{superficial_velocity: {{x: {ASKED}}}}}\ntime: {{steady: 1.0e-3, end: 10, max_steps: STEPS}}"


def case_of(folder, clear, offset, flow):
    """The case of a channel in a folder."""
    text = CASE.format(clear=clear, spacing=SPACING, offset=offset, density=DENSITY, viscosity=VISCOSITY, flow=flow)
    return read_case(text.encode(), folder / "case.yaml", (f"output.directory={folder / 'out'}",))


def within(along, lower, upper):
    """Parts (n,) of the extents of particles that lie between two places."""
    both = np.minimum(along + SPACING / 2, upper) - np.maximum(along - SPACING / 2, lower)
    return np.clip(both / SPACING, 0.0, 1.0)


def fluxes(case):
    """Rows of (flux of the clear layers, flux of the channel, drop) of the steps of a case."""
    geometry, rows = build_geometry(case), []
    state, stepper, particles = prepare(case, geometry, Clock())
    (lower, _), (upper, _) = geometry.sample_lower, geometry.sample_upper

    def measure(state, _):
        along, u = state.x[:, 0], state.u[:, 0]
        far = 1.0 - within(along, lower - SPACING / 2, upper + SPACING / 2)
        channel = SPACING**2 * (within(along, lower, upper) @ u) / ((upper - lower) * geometry.upper[1])
        rows.append((far @ u / far.sum() / ASKED, channel / ASKED, stepper.held_velocity.drop(state)))
        return {}

    loop = TimeLoop(case, stepper, particles.site_volume, float(np.prod(geometry.upper - geometry.lower)), measure)
    loop.run(state, stepper.ready(state), *[lambda *_: None] * 3)
    return np.array(rows)


def main():
    """Prints the table."""
    print("clear, offset   porosity   clear layers, channel: first step   late            drop     steady flow")
    with TemporaryDirectory() as name:
        folder, image = Path(name), np.ones((16, 16), np.uint8)
        image[4:12] = 0
        np.save(folder / "channel.npy", image)
        for clear, offset in ((0.25, 0.0), (0.25, 0.25), (0.3125, 0.0), (0.25, 0.5)):
            flow = HELD.replace("STEPS", "1")
            short = run_case(case_of(folder, clear, offset, flow), quiet=True, overwrite=True)
            steady = run_case(case_of(folder, clear, offset, "flow: stokes\ndrive: {axes: [x]}"), quiet=True,
                              overwrite=True)
            rows = fluxes(case_of(folder, clear, offset, HELD.replace("STEPS", "100000")))
            first, late = rows[0], rows[len(rows) // 2:].mean(axis=0)
            drop = VISCOSITY * ASKED * 1.0 / steady["permeability"]
            print(f"{clear:6g} {offset:6g}   {short['porosity']:.4f}     {first[0]:.3f} {first[1]:.3f}"
                  f"                        {late[0]:.3f} {late[1]:.3f}     {late[2]:.2f}     "
                  f"{steady['porosity']:.4f} {drop:.2f}", flush=True)


if __name__ == "__main__":
    main()
