"""What `isph validate --check-only` says of the cases, and what runs of them take: CPU seconds, steps and peak memory.

usage: PYTHONPATH=. python benchmarks/estimates.py [--seconds S] [CASE ...]        (without CASE: all of cases/)

Each case runs in a process of its own on one thread, whole if the check says that it takes at most S seconds (120),
else as many steps of it as that allows: then the check is of these steps too. A steady case is run whole or not at all.
Seconds are those of the CPU without compilation and reference, pictures are not drawn; memory is the peak of the
process. Run it twice: the first time the compiler takes memory too.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

from isphcli.case.load import load_case
from isphcli.preflight.check import check

CASES = Path(__file__).parents[1] / "cases"
PLAIN = ("output.plots=false",)
GOOD = 1.3  # said over measured, either way


def of_case(path, seconds):
    """(overrides, CheckResult) of as much of a case as takes so many seconds at most; None where it cannot be cut."""
    report = check(load_case(path, PLAIN))
    if report.seconds is None or report.seconds <= seconds:
        return PLAIN, report
    if report.steps is None:
        return None, report
    steps = max(int(report.steps.count * seconds / report.seconds), 10)
    cut = (*PLAIN, f"time.max_steps={steps}")
    return cut, check(load_case(path, cut))


def ran(path, overrides, folder):
    """The summary of a run."""
    sets = [word for text in (*overrides, f"output.directory={folder}") for word in ("--set", text)]
    done = subprocess.run([sys.executable, "-m", "isphcli", "run", str(path), "--quiet", *sets], capture_output=True,
                          text=True)
    if not (Path(folder) / "summary.json").exists():
        raise SystemExit(f"{path}: {done.stderr}")
    return json.loads((Path(folder) / "summary.json").read_text())


def ratio(said, measured):
    bad = not 1.0 / GOOD <= said / measured <= GOOD
    return f"{said / measured:.2f}{' !' * bad}"


def row(path, seconds):
    overrides, report = of_case(path, seconds)
    if overrides is None:
        said = sum(report.memory.values()) / 1e6
        return [path.stem, "not run", f"{report.seconds:.0f}", "", "", "", f"{said:.0f}", "", ""]
    with tempfile.TemporaryDirectory() as folder:
        summary = ran(path, overrides, folder)
    spent = summary["cpu_seconds"]
    taken = spent["total"] - spent.get("compile", 0.0) - spent.get("reference", 0.0)
    memory = summary["peak_memory_bytes"]
    said, steps = sum(report.memory.values()), ""
    if report.steps is not None and report.steps.count:
        steps = ratio(report.steps.count, summary["steps"])
    print(f"{path.stem}: {summary['particles']} {summary.get('steps')} " + ", ".join(
        f"{name} {value:.2f}" for name, value in spent.items()), file=sys.stderr, flush=True)
    run = "whole" if overrides == PLAIN else f"{summary['steps']} steps"
    return [path.stem, run, f"{report.seconds:.3g}", f"{taken:.3g}", ratio(report.seconds, taken), steps,
            f"{said / 1e6:.0f}", f"{memory / 1e6:.0f}", ratio(said, memory)]


def main():
    asked = argparse.ArgumentParser()
    asked.add_argument("--seconds", type=float, default=120.0)
    asked.add_argument("cases", nargs="*")
    options = asked.parse_args()
    paths = [CASES / f"{name}.yaml" for name in options.cases] or sorted(CASES.glob("*.yaml"))
    print("| case | run | CPU s said | measured | ratio | steps, ratio | MB said | measured | ratio |\n"
          "|---|---|---|---|---|---|---|---|---|")
    for path in paths:
        print("| " + " | ".join(row(path, options.seconds)) + " |", flush=True)


if __name__ == "__main__":
    main()
