"""Weak and strong scaling on few processes: what each holds, sends and takes, measured beside the model of
isphcli/validation/scaling.py.

usage: python benchmarks/scaling.py FOLDER [weak|strong] [RANKS...]     (1 2 4 8; needs mpiexec, mpi4py and petsc4py)
       python benchmarks/scaling.py model beads|bubbles PARTICLES US_ASSEMBLING US_SOLVING ITERATIONS...
                                                                  the model, from the last row of a ladder
       python benchmarks/scaling.py sizes                         what large steady scenes would take, extrapolated

Fluid between spheres in a periodic box, 20 spacings a sphere: creeping flow to two tolerances, moving particles of 2
and of 5 steps, and with drops in the place of the spheres. weak: a sphere a process, 6,300 particles, as many as the
paper gave one; strong: 8 spheres on all. Prints a table of each in Markdown. On a machine with fewer cores than
processes their CPU seconds hold what they wait for each other: what they waited outside of PETSc is taken off, what
they wait within it is not.
"""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

CASE = """
geometry:
  box: {box}
  periodic: [x, y, z]
  fluid: water
  shapes:
{spheres}
particles: {{spacing: 0.05}}
fluids:
  water: {{density: 1, viscosity: 0.1}}
{flow}
output: {{snapshots: false, plots: false}}
solver: {{engine: petsc, tolerance: {tolerance}}}
"""
PUSHED = "drive: {body_force: [1, 0, 0]}\ntime: {end: 99, max_steps: SIZE}"
FLOWS = {"steady": "flow: stokes\ndrive: {axes: [x]}", "moving": PUSHED,
         "drops": "  oil: {density: 0.5, viscosity: 0.05}\ninterface: {tension: 1}\n" + PUSHED}
# (tolerance, steps): what the last has more than the one before is that of iterations, and of moving particles what the
# second has more than the first that of steps
SIZES = {"steady": ((1e-3, 0), (1e-6, 0)), "moving": ((1e-6, 2), (1e-6, 5), (1e-9, 5)),
         "drops": ((1e-6, 2), (1e-6, 5), (1e-9, 5))}
CELLS = {1: (1, 1, 1), 2: (2, 1, 1), 4: (2, 2, 1), 8: (2, 2, 2)}  # of the weak runs, by their processes
COUNTED = ("messages", "sent", "collectives", "iterations", "cpu")


def case_of(kind, cells, size):
    from isphcli.case.load import read_case

    spheres = "\n".join(
        f"    - {{sphere: {{centre: {[float(k + 0.5) for k in place]}, radius: 0.37}}, "
        f"is: {'oil' if kind == 'drops' else 'solid'}}}"
        for place in np.ndindex(*cells))
    tolerance, steps = size
    flow = FLOWS[kind].replace("SIZE", str(steps))
    return read_case(CASE.format(box=[float(n) for n in cells], spheres=spheres, flow=flow,
                                 tolerance=tolerance).encode(), "scaling.yaml")


def measured(kind, cells, size, out):
    """What every process has and sends in a run, on all of them."""
    from isphcli import api
    from isphcli.domain.communicator import TRAFFIC, current
    from isphcli.output.files import read_history

    before, begin = replace(TRAFFIC), time.process_time()
    summary = api.run(case_of(kind, cells, size), out=out, quiet=True, check=False, overwrite=True).summary
    spent = time.process_time() - begin - (TRAFFIC.waited - before.waited)
    rows = current().first(read_history(out / "history.csv") if current().rank == 0 else None)
    names = [name for name in rows[0] if name.startswith("iterations")]
    steps = rows[2:] or rows  # the first ones find the pressure
    fluid, remote = (summary["ranks"][name][1] if current().size > 1 else summary["particles"]["fluid"] * own
                     for name, own in (("fluid", 1), ("remote", 0)))
    own = {"messages": TRAFFIC.messages - before.messages, "sent": TRAFFIC.sent - before.sent,
           "collectives": TRAFFIC.collectives - before.collectives,
           "cpu": spent - summary["cpu_seconds"].get("compile", 0.0) * (current().rank == 0),
           "iterations": sum(row[name] for row in rows for name in names)}
    most = {name: max(of[name] for of in current().collect(own)) for name in own}
    return most | {"all": summary["particles"]["fluid"], "fluid": fluid, "remote": remote,
                   "mean": sum(row[name] for row in steps for name in names) / max(len(steps), 1)}


def on_ranks(out, modes):
    """One program of several processes: every scene of so many. Leaves <ranks>.json."""
    from isphcli.domain.communicator import current, join
    from isphcli.output.environment import launched

    join(launched())
    ranks = current().size
    found = []
    for mode, cells in (("weak", CELLS[ranks]), ("strong", CELLS[8])):
        for kind, sizes in SIZES.items():
            if mode not in modes or (mode == "strong" and (ranks == 8 or kind == "drops")):
                continue
            measured(kind, cells, (1e-3, 1), out / "first")  # compiles
            runs = [measured(kind, cells, size, out / f"{kind}_{mode}") for size in sizes]
            entry = {"mode": mode, "kind": kind, "ranks": ranks, "cells": cells, **runs[1]}
            more = runs[-1]["iterations"] - runs[-2]["iterations"]
            entry |= {f"{name}_iteration": (runs[-1][name] - runs[-2][name]) / more for name in COUNTED}
            if kind != "steady":
                steps = sizes[1][1] - sizes[0][1]
                entry |= {f"{name}_step": (runs[1][name] - runs[0][name]) / steps for name in COUNTED}
            found.append(entry)
    if current().rank == 0:
        (out / f"{ranks}.json").write_text(json.dumps(found))


def report(out, counts):
    from isphcli.validation.scaling import busiest

    entries = [entry for ranks in counts for entry in json.loads((out / f"{ranks}.json").read_text())]
    entries += [entry | {"mode": "strong"} for entry in entries if entry["ranks"] == 8 and entry["kind"] != "drops"]
    for kind in SIZES:
        print(f"\n| {kind}: processes | particles of one | imbalance | remote over own: measured, model | "
              "neighbours: model | iterations | of an iteration: messages, collectives, bytes a remote particle, "
              "CPU ms | of a step |\n|---|---|---|---|---|---|---|---|")
        for mode in ("weak", "strong"):
            for entry in (e for e in entries if e["kind"] == kind and e["mode"] == mode):
                near = busiest(np.zeros(3), np.array(entry["cells"], float), entry["ranks"], 2.1 * 0.05, (True,) * 3)
                own, ghosts = entry["fluid"], entry["remote"]
                count = entry["iterations"] if kind == "steady" else entry["mean"]
                cells = []
                for each in ("iteration", "step"):
                    if f"sent_{each}" in entry:
                        sent = entry[f"sent_{each}"] / ghosts if ghosts else 0.0
                        cells.append(f"{entry[f'messages_{each}']:.1f}, {entry[f'collectives_{each}']:.1f}, "
                                     f"{sent:.0f}, {1e3 * entry[f'cpu_{each}']:.1f}")
                print(f"| {mode}, {entry['ranks']} | {own:,} | {own * entry['ranks'] / entry['all']:.4f} | "
                      f"{ghosts / own:.3f}, {near.remote:.3f} | {near.neighbours} | {count:.1f} | "
                      f"{cells[0]} | {cells[1] if len(cells) > 1 else ''} |")


# Of docs/clusters.md: bytes of a process; those that one may hold; power with which iterations grow with the particles
# (PETSc, Berea 64^3 and 128^3: 32 and 41 of 88,635 and 728,845). Then bytes of an own or remote particle; CPU us a
# particle of the set-up and of an iteration; iterations of a scene of so many particles: the pack of N = 128 on two
# processes (236 CPU s each, 144 of them in 55 iterations, other programs beside it); Berea 128^3 by PETSc
PROGRAM, ROOM, GROWTH = 2.45e8, 3.5e9, 0.12
COSTS = {"pack": (2.9e3, 70.0, 2.0, 55, 2.62e6), "rock": (2.4e3, 23.9, 1.29, 41, 7.29e5)}


def sizes():
    """Prints a table of processes of ROOM bytes."""
    from isphcli.preflight.costs_of_ranks import WAITS
    from isphcli.validation.paper import LENGTH, POROSITY, RADIUS, TABLE_1, fluid_of_table_1

    side = np.pi**0.5 * RADIUS
    scenes = [(f"table 1, N = {n}", fluid_of_table_1(n), "pack", np.array([side, LENGTH, side]), POROSITY)
              for n in TABLE_1]
    scenes.append(("rock of 1000^3 voxels, porosity 0.21", 2.1e8, "rock", np.ones(3), 0.21))
    print("| scene | fluid particles | processes | own and remote of one | memory of one, all | iterations | wall |\n"
          "|---|---|---|---|---|---|---|")
    for name, fluid, kind, box, porosity in scenes:
        reach = 2.1 * (np.prod(box) * porosity / fluid) ** (1 / 3)
        chosen = next(count for count in range(2, 100_000, 2 if fluid < 1e7 else 16)
                      if held(fluid, count, box, reach, COSTS[kind][0])[1] < ROOM)
        each_holds, set_up, each, iterations, of = COSTS[kind]
        near, memory = held(fluid, chosen, box, reach, each_holds)
        iterations *= (fluid / of) ** GROWTH
        seconds = 1e-6 * (set_up + each * iterations) * fluid / chosen * (1.0 + near.remote) * WAITS
        print(f"| {name} | {fluid / 1e6:,.1f} million | {chosen:,} | {fluid / chosen:,.0f} and "
              f"{near.remote * fluid / chosen:,.0f} | {memory / 1e9:.2f} GB, {memory * chosen / 1e9:,.0f} GB | "
              f"{iterations:.0f} | {seconds:,.0f} s |")


def model(kind, *last):
    """Prints the table that `isph validate --paper` makes of the last row of a ladder whose iterations do not grow."""
    from isphcli.validation.markdown import table
    from isphcli.validation.paper import weak_scaling

    heads, rows = weak_scaling([float(value) for value in last], 0.0, kind == "beads")
    print("\n".join(table(heads, [[str(cell) for cell in row] for row in rows])))


def held(fluid, count, box, reach, bytes_each):
    """The busiest of so many processes, and bytes that it holds."""
    from isphcli.validation.scaling import busiest

    near = busiest(np.zeros(3), box, count, reach, (False, True, False))
    return near, PROGRAM + bytes_each * fluid / count * (1.0 + near.remote)


def main(folder, *words):
    out = Path(folder)
    out.mkdir(exist_ok=True)
    counts = [int(word) for word in words if word not in ("weak", "strong")] or [1, 2, 4, 8]
    modes = next((word for word in words if word in ("weak", "strong")), "weak,strong")
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMPI_MCA_rmaps_base_oversubscribe": "1",
                                "OMPI_MCA_mpi_yield_when_idle": "1"}
    for ranks in counts:
        launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
        subprocess.run([*launcher, sys.executable, __file__, str(out), "several", modes], env=environment, check=True)
    report(out, counts)


if __name__ == "__main__":
    if sys.argv[1:] == ["sizes"]:
        sizes()
    elif sys.argv[1] == "model":
        model(*sys.argv[2:])
    elif sys.argv[2:3] == ["several"]:
        on_ranks(Path(sys.argv[1]), sys.argv[3].split(","))
    else:
        main(*sys.argv[1:])
