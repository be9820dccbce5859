"""What a restart file costs, of which each process writes and reads its rows.

    PYTHONPATH=. mpiexec -n 2 python benchmarks/restart_cost.py FOLDER [PARTICLES]      in 3D, of each process

Prints MB of the file, and CPU s and s of wall of rank 0 that writing and reading it take.
"""

import sys
import time
from pathlib import Path

import numpy as np


def timed(what, function, size):
    wall, spent = time.perf_counter(), time.process_time()
    found = function()
    wall, spent = time.perf_counter() - wall, time.process_time() - spent
    print(f"{what}: {spent:.2f} CPU s, {wall:.2f} s of wall, {size() / 1e6 / spent:.0f} MB a CPU s", flush=True)
    return found


def main(folder, particles="1000000"):
    from isphcli.domain.communicator import current, join
    from isphcli.flow.state import State
    from isphcli.output import restart
    from isphcli.output.environment import launched

    join(launched())
    ranks, n, path = current(), int(particles), Path(folder) / "restart.npz"
    rng = np.random.default_rng(ranks.rank)
    x, u, old, p = (rng.random((n, 3) if k < 3 else n) for k in range(4))
    state = State(x=x, u=u, u_old=old, p=p, step=1, number=n * ranks.rank + np.arange(n))
    sys.stdout = sys.stdout if ranks.rank == 0 else open("/dev/null", "w", encoding="utf-8")
    timed("written", lambda: restart.save(path, restart.Saved(state)), lambda: path.stat().st_size)
    print(f"{ranks.size} processes, {path.stat().st_size / 1e6:.0f} MB")
    timed("read", lambda: restart.load(path, state), lambda: path.stat().st_size)


if __name__ == "__main__":
    main(*sys.argv[1:])
