"""What `test_moving_ranks.py` and `test_two_fluid_ranks.py` run on several processes: mpiexec -n N python -m
tests.moving_ranks OUT ENGINE NAMES; without mpiexec, on one. Each of the scenes NAME,NAME,..., or all, makes its steps
and leaves its files in OUT/<name>; the restart file has the particles in the same order however many processes there
are.

mpiexec -n N python -m tests.moving_ranks goes_on FOLDER...: ten more steps from the restart files in these folders.
"""

import gc
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests import ranks

STEPS = 20
PACK = """
geometry:
  box: [2.0e-3, 2.8e-3, 2.0e-3]
  origin: [-1.0e-3, -1.4e-3, -1.0e-3]
  periodic: [y]
  shapes: [{spheres: {file: beads.csv, radius: 2.5e-4}, is: solid}]
particles: {spacing: 2.1e-4}
fluids: {water: {density: 1000, viscosity: 1.0e-3}}
drive: {body_force: [0, 1.06, 0]}
time: {end: 1}
"""  # 111 beads of 2.4 spacings: narrow pores, dead ends, parts of one particle
THIN = """
geometry: {box: [2, 0.4, 0.4], periodic: [x, y, z]}
particles: {spacing: 0.1, keep_volume: 10}
fluids: {water: {density: 1, viscosity: 0.1}}
initial: {velocity: ["sin(pi*x)", "0.3*cos(pi*x)", "0.2*sin(pi*x)"]}
time: {end: 1}
"""  # thinner than two supports: a particle is seen through several sides
HELD = """
geometry:
  box: [1.0, 0.6]
  periodic: [x]
  shapes: [{sphere: {centre: [0.47, 0.3], radius: 0.15}, is: solid}]
particles: {spacing: 0.05}
fluids: {water: {density: 1, viscosity: 0.1}}
drive: {superficial_velocity: {x: 0.1}}
time: {end: 9}
"""
# a row of four particles: some of three processes have none
FEW = ranks.FEW.replace("flow: stokes\ndrive: {axes: [x]}", "drive: {body_force: [1, 0, 0]}\ntime: {end: 9}")
FILES = {
    "vortices": ("taylor_green_2d_re100", ["particles.spacing=0.05", "time.end=9"]),
    "viscous": ("taylor_green_2d", ["time={end: 9, step: 0.02}"]),  # hierarchies of velocities too
    "vortices_3d": ("taylor_green_3d", ["particles.spacing=0.1", "time={end: 9, step: 0.004}", "reference=null"]),
    "cavity": ("lid_driven_cavity", ["particles.spacing=0.0625"]),
    "couette": ("couette", ["geometry.walls.y_min={slip_length: 1.0e-4}"]),
    "image": ("berea", ["geometry.voxels.crop=[[0,10],[0,10],[0,10]]", "geometry.wall_distance=stairs", "refine=null",
                        "flow=navier_stokes", "drive={body_force: [10, 0, 0]}",
                        "time={end: 1}", "reference=null"]),
}
NAMES = [*FILES, "pack", "thin", "held", "few"]
DROP = """
geometry:
  box: [1.0, 0.8]
  periodic: [x, y]
  fluid: outside
  shapes: [{box: {lower: [0.23, 0.17], upper: [0.67, 0.56]}, is: drop}]
particles: {spacing: 0.05}
fluids:
  drop: {density: 1, viscosity: 0.5}
  outside: {density: 5, viscosity: 0.05}
interface: {tension: 1}
time: {end: 9, capillary: 1}
"""  # a square becomes round: both ratios, the pressure of particles that change their fluid
HALF_DROP = """
geometry:
  box: [1.0, 0.6]
  periodic: [x]
  fluid: outside
  shapes: [{box: {lower: [0.27, -0.1], upper: [0.67, 0.3]}, is: drop}]
particles: {spacing: 0.05}
fluids:
  drop: {density: 1, viscosity: 0.002}
  outside: {density: 1, viscosity: 0.001}
interface: {tension: 1, contact_angle: 60, slip_length: 0.02}
time: {end: 9}
"""  # slips at its contact lines, one on each process; viscosity is added
STRIPES = """
geometry:
  box: [1.0, 0.5]
  periodic: [x, y]
  fluid: water
  shapes: [{box: {lower: [0.13, -1], upper: [0.62, 2]}, is: dyed}]
particles: {spacing: 0.05, jitter: 0.1}
fluids: {water: {density: 1, viscosity: 0.1}, dyed: {density: 1, viscosity: 0.1}}
initial: {velocity: ["1 + sin(2*pi*x)*cos(4*pi*y)", "-0.5*cos(2*pi*x)*sin(4*pi*y)"]}
time: {end: 9}
"""  # fluids that differ in name only
THIN_LAYERS = """
geometry:
  box: [1.0, 0.1]
  periodic: [x, y]
  fluid: light
  shapes: [{box: {lower: [0.33, -1], upper: [0.71, 2]}, is: heavy}]
particles: {spacing: 0.05, jitter: 0.2}
fluids: {light: {density: 1, viscosity: 0.01}, heavy: {density: 3, viscosity: 0.02}}
interface: {tension: 0.5}
initial: {velocity: ["0.3", 0]}
drive: {pressure_drop: {x: 2}}
time: {end: 9}
"""  # no wider than a support: pieces of the interface are seen from several sides
FEW_OF_TWO = """
geometry:
  box: [0.4, 1.0, 1.0]
  periodic: [x, y, z]
  fluid: a
  shapes:
    - {box: {lower: [0.12, -1, -1], upper: [0.27, 2, 2]}, is: b}
    - {box: {lower: [-1, 0.0, 0.0], upper: [2, 0.1, 0.1]}, outside: true, is: solid}
particles: {spacing: 0.1}
fluids: {a: {density: 1, viscosity: 1}, b: {density: 2, viscosity: 0.5}}
interface: {tension: 0.1, contact_angle: 70}
drive: {body_force: [1, 0, 0]}
time: {end: 9}
"""  # a row of four particles: some of three processes have none
TWO_FLUIDS = {
    "bubbles": ("co2_bubbles", ["geometry.box=[2.2e-3, 2.2e-3, 1.28e-3]", "geometry.shapes.0.cylinder.radius=1.1e-3",
                                "geometry.shapes.1.spheres.random=8", "interface.contact_angle=40"]),
    # across the cut, which is that of the longest axis
    "drainage": ("berea_drainage", ["geometry.voxels.crop=[[0,12],[0,12],[0,12]]", "geometry.wall_distance=stairs",
                                    "initial.flood={fluid: co2, from: y_min, saturation: 0.4}"]),
    "slit": ("slit_drainage", ["drive.steps.duration=2.0e-6", "drive.steps.window=5.0e-7"]),
}
NAMES_OF_TWO = ["drop", "csf", "half_drop", "stripes", "thin_layers", "few_of_two", *TWO_FLUIDS]


def cases(folder):
    from isphcli.case.load import load_case, read_case
    from tests.paths import CASES

    for name, (file, overrides) in (FILES | TWO_FLUIDS).items():
        yield name, load_case(CASES / f"{file}.yaml", tuple(overrides))
    yield "pack", read_case(PACK.encode(), str(folder / "pack.yaml"))
    csf = DROP.replace("tension: 1", "tension: 1, method: csf").replace("spacing: 0.05", "spacing: 0.05, jitter: 0.1")
    texts = {"thin": THIN, "held": HELD, "few": FEW, "drop": DROP, "csf": csf, "half_drop": HALF_DROP,
             "stripes": STRIPES, "thin_layers": THIN_LAYERS, "few_of_two": FEW_OF_TWO}
    for name, text in texts.items():
        yield name, read_case(text.encode(), f"{name}.yaml")


def write_beads(folder):
    from tests.paths import CASES

    centres = np.loadtxt(CASES / "data/bead_centres.csv", delimiter=",", skiprows=1)
    inside = (np.abs(centres) < [1.25e-3, 1e-3, 1.25e-3]).all(axis=1)
    np.savetxt(folder / "beads.csv", centres[inside], delimiter=",", header="x_m,y_m,z_m", comments="")


def main(folder, engine, names):
    from isphcli import api
    from isphcli.domain.communicator import join, on_first
    from isphcli.flow import step
    from isphcli.output.environment import launched

    join(launched())
    usual = step.UNIT_RESPONSE_TOLERANCE
    out = Path(folder)
    on_first(lambda: (out.mkdir(exist_ok=True), write_beads(out)))
    for name, case in cases(out):
        if names != "all" and name not in names.split(","):
            continue
        case = replace(case, solver=replace(case.solver, engine=engine, tolerance=1e-11),
                       output=replace(case.output, plots=False, restart_every=STEPS // 2),
                       time=replace(case.time, max_steps=STEPS), title=name)
        # what forgets its distance to an interface depends on the last digits of the drop
        step.UNIT_RESPONSE_TOLERANCE = 0.0 if name in NAMES_OF_TWO else usual
        api.run(case, out=out / name, quiet=True, check=False, overwrite=True)
    petsc = sys.modules.get("isphcli.solvers.petsc")
    left = 0 if petsc is None else sum(isinstance(known, petsc._Shell) for known in gc.get_objects())
    on_first(lambda: (out / "left").write_text(str(left)))


def resume(*folders):
    from isphcli import api
    from isphcli.case.load import load_case
    from isphcli.domain.communicator import join
    from isphcli.flow import step
    from isphcli.output.environment import launched

    join(launched())
    usual = step.UNIT_RESPONSE_TOLERANCE
    for folder in map(Path, folders):
        step.UNIT_RESPONSE_TOLERANCE = 0.0 if folder.name in NAMES_OF_TWO else usual
        case = load_case(folder / "case.yaml", (f"time.max_steps={STEPS + 10}",))
        api.run(case, out=folder, restart=folder, quiet=True, check=False)


if __name__ == "__main__":
    if sys.argv[1] == "goes_on":
        resume(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
