"""What measuring costs, and whether the CPU seconds that a run reports are those of the operating system.

usage: python benchmarks/measuring.py [CASE ...]        (two of cases/)

The case runs in a process of its own, which asks the operating system (getrusage) before and after the run; what the
whole process took besides is the start of Python, imports and the reading of the case. Then the case runs in this
process, and everything that only measures is counted and timed: sections of the stopwatch (their number times the cost
of an empty one), rows of the history, and the errors against the reference, which `isph validate` leaves out.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from isphcli.case.load import load_case, read_case
from isphcli.output.clock import Clock
from isphcli.output.files import History, read_history
from isphcli.references import compare
from isphcli.runs.run import run_case
from isphcli.runs.time_loop import TimeLoop

NAMES = ("taylor_green_2d_re100", "taylor_green_3d_re100")
CASES = [Path(__file__).parents[1] / "cases" / f"{name}.yaml" for name in NAMES]
QUIET = ("output.snapshots=false", "output.plots=false")
RUN = Path(__file__).with_name("measured_run.py")


def of_children():
    """CPU seconds of the processes that were waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def ran(text):
    """(summary, rows of the history, CPU seconds without compilation) of a case of this text."""
    with tempfile.TemporaryDirectory() as folder:
        case = read_case(text.encode(), "case.yaml", (*QUIET, f"output.directory={folder}"))
        summary = run_case(case, quiet=True)
        rows = read_history(f"{folder}/history.csv")
    cpu = summary["cpu_seconds"]
    return summary, rows, cpu["total"] - cpu.get("compile", 0.0)


class Timed:
    """A function that sums the CPU seconds spent in it."""

    def __init__(self, function):
        self.function, self.seconds, self.calls = function, 0.0, 0

    def __call__(self, *args, **kwargs):
        start = time.process_time()
        try:
            return self.function(*args, **kwargs)
        finally:
            self.seconds += time.process_time() - start
            self.calls += 1

    def __get__(self, instance, owner=None):
        return lambda *args, **kwargs: self(instance, *args, **kwargs)


def agreement(case):
    """(CPU seconds of the process, of them those of the run, {section: reported seconds}), of the operating system."""
    before = of_children()
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, str(RUN), str(case), *QUIET, f"output.directory={folder}"]
        done = subprocess.run(words, check=True, capture_output=True, text=True)
    return of_children() - before, *json.loads(done.stdout.splitlines()[-1])


def overhead(case):
    """(CPU seconds of a run without compilation and reference, {what only measures: CPU seconds})."""
    clock, count = Clock(), 20_000
    start = time.process_time()
    for _ in range(count):
        with clock("section"):
            pass
    a_section = (time.process_time() - start) / count
    sections, rows = Timed(Clock.__call__), Timed(TimeLoop._row)
    appends, errors = Timed(History.append), Timed(compare.compare)
    timed = ((Clock, "__call__", sections), (TimeLoop, "_row", rows), (History, "append", appends),
             (compare, "compare", errors))  # fmt: skip
    for owner, name, function in timed:
        setattr(owner, name, function)
    with tempfile.TemporaryDirectory() as folder:
        summary = run_case(load_case(case, (*QUIET, f"output.directory={folder}")), quiet=True)
    spent = summary["cpu_seconds"]["total"] - summary["cpu_seconds"].get("compile", 0.0) - errors.seconds
    for owner, name, function in timed:
        setattr(owner, name, function.function)
    parts = {
        f"{sections.calls} sections of the stopwatch": sections.calls * a_section,
        f"{rows.calls} rows of the history": rows.seconds + appends.seconds,
        "errors against the reference": errors.seconds,
    }
    return spent, parts


def main(*cases):
    for case in cases or CASES:
        whole, inside, reported = agreement(case)
        total = reported["total"]
        split = ", ".join(f"{name} {s:.2f}" for name, s in reported.items() if name != "total" and s >= 0.005)
        print(f"{Path(case).stem}: operating system {inside:.2f} CPU s in the run ({whole:.2f} of the process), "
              f"reported {total:.2f}: {100 * (total / inside - 1):+.2f} %\n  {split}")  # fmt: skip
        spent, parts = overhead(case)
        print(f"  of {spent:.2f} CPU s without compilation and reference: "
              + ", ".join(f"{name} {1e3 * s:.1f} ms ({100 * s / spent:.2f} %)" for name, s in parts.items()))


if __name__ == "__main__":
    main(*sys.argv[1:])
