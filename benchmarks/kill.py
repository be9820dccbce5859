"""Kills a run with SIGKILL at random moments and restarts it, until it has ended; then compares with a run left alone.

    PYTHONPATH=. python benchmarks/kill.py [CASE.yaml | --two-fluids] [--kills 200] [--seed 0]

The built-in cases: flow past a disk, and half a drop that slides along a wall.

Every process is a fork of one that has imported everything and runs one thread: a kill falls into the run itself, not
into seconds of imports. A kill must leave the snapshots that were listed before it byte for byte, and a restart must
begin at once or, before the first restart file, say that there is none (the case then starts anew). What the pieces
have left in the end, history, snapshots, time series and the arrays of the restart file, must be the bytes of the run
that was left alone. Rounds of that are played until there were so many kills. Exit code 1 if anything was lost.
"""

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

CASE = """
geometry: {box: [1, 1], periodic: [x, y], shapes: [{sphere: {centre: [0.5, 0.5], radius: 0.2}, is: solid}]}
particles: {spacing: 0.0625, jitter: 0.1}
fluids: {water: {density: 1, viscosity: 0.1}}
drive: {body_force: [1, 0]}
time: {end: 0.4, cfl: 0.4}
output: {every: 0.02, restart_every: 4, plots: false}
"""
# files every other step or so: else hardly a kill falls into a write
TWO_FLUIDS = """
geometry:
  box: [1, 0.5]
  periodic: [x]
  fluid: water
  shapes: [{sphere: {centre: [0.5, 0], radius: 0.25}, is: oil}]
particles: {spacing: 0.0625, jitter: 0.1}
fluids: {oil: {density: 2, viscosity: 0.2}, water: {density: 1, viscosity: 0.05}}
interface: {tension: 1, contact_angle: 60}
drive: {body_force: [0.5, -1]}
time: {end: 0.6, capillary: 0.7}
output: {every: 0.01, restart_every: 2, plots: false}
"""
QUIET_END, REFUSED, FAULT = 0, 2, 1


def child(path, out, resume):
    """Runs or goes on in a fork; its process id. Exit code 2: there is no restart file, 1: anything else."""
    pid = os.fork()
    if pid:
        return pid
    code = FAULT
    try:
        from isphcli.case.load import load_case
        from isphcli.output.restart import RestartError
        from isphcli.runs.run import run_case

        try:
            run_case(load_case(path, [f"output.directory={out}"]), quiet=True, resume=out if resume else None,
                     overwrite=not resume)
            code = QUIET_END
        except RestartError as error:
            print(f"\n{error}", file=sys.stderr)
            code = REFUSED
    except BaseException:
        import traceback

        traceback.print_exc()
    os._exit(code)


def wait(pid, seconds):
    """Exit code of a child, or None if it was killed after so many seconds."""
    end = time.monotonic() + seconds
    while True:
        found, status = os.waitpid(pid, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end:
            os.kill(pid, signal.SIGKILL)
            _, status = os.waitpid(pid, 0)
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else None  # it may have ended in the same moment
        time.sleep(2e-4)


def listed(out):
    """{file: bytes} of the snapshots in the series."""
    from isphcli.output.files import read_pvd

    series = out / "particles.pvd"
    return {file: (out / file).read_bytes() for _, file in read_pvd(series)} if series.exists() else {}


def left_by(out):
    """{name: bytes} of what must not depend on the kills."""
    import numpy as np

    found = listed(out) | {name: (out / name).read_bytes() for name in ("history.csv", "particles.pvd")}
    with np.load(out / "restart.npz") as file:
        return found | {f"restart.npz: {name}": file[name].tobytes() for name in file.files}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", nargs="?", type=Path)
    parser.add_argument("--two-fluids", action="store_true", help="the built-in case of two fluids")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    # before numba is imported: one thread, and no thread pool that a fork would inherit half of
    os.environ |= {"NUMBA_NUM_THREADS": "1", "NUMBA_THREADING_LAYER": "workqueue", "OPENBLAS_NUM_THREADS": "1"}
    import meshio  # noqa: F401
    import pyamg  # noqa: F401

    import isphcli.runs.moving_case  # noqa: F401

    rng = random.Random(asked.seed)
    root = Path(tempfile.mkdtemp(prefix="isph-kill-"))
    path = asked.case or root / "case.yaml"
    if asked.case is None:
        path.write_text(TWO_FLUIDS if asked.two_fluids else CASE)
    alone = root / "alone"
    assert wait(child(path, alone, False), 1e6) == QUIET_END  # compiles
    shutil.rmtree(alone)
    start = time.monotonic()
    assert wait(child(path, alone, False), 1e6) == QUIET_END
    seconds = time.monotonic() - start
    reference = left_by(alone)
    count, lost = Counter(), []
    print(f"a run left alone: {seconds:.2f} s, {len(listed(alone))} snapshots, "
          f"{len((alone / 'history.csv').read_text().splitlines()) - 1} steps", flush=True)
    while count["kills"] < asked.kills:
        out = root / "killed"
        shutil.rmtree(out, ignore_errors=True)
        resume, code, before = False, None, {}
        while code != QUIET_END:
            again = count["kills"] < asked.kills
            code = wait(child(path, out, resume), rng.uniform(0.0, 0.5 * seconds) if again else 1e6)
            if code is None:
                count["kills"] += 1
                count["in restarted runs"] += resume
                count["amid a write"] += any(out.rglob(".isph-*")) if out.exists() else 0
                if resume:
                    for file, content in before.items():
                        if not (out / file).exists() or (out / file).read_bytes() != content:
                            lost.append(f"kill {count['kills']}: {file} changed")
                resume, before = True, listed(out)
            elif code == REFUSED and not (out / "restart.npz").exists():
                count["before the first restart file"] += 1
                resume, before = False, {}
            elif code != QUIET_END:
                lost.append(f"after kill {count['kills']}: the restart ended with exit code {code}")
                break
            elif resume:
                count["restarts to the end"] += 1
        if code == QUIET_END:
            found = left_by(out)
            differing = [name for name in reference.keys() | found.keys() if reference.get(name) != found.get(name)]
            if differing:
                lost.append(f"after kill {count['kills']}: {', '.join(sorted(differing)[:5])} differ")
        count["rounds"] += 1
    shutil.rmtree(root)
    for name, number in count.items():
        print(f"{name}: {number}")
    print(f"lost or different: {len(lost)}")
    for line in lost[:20]:
        print(" ", line)
    return bool(lost)


if __name__ == "__main__":
    sys.exit(main())
