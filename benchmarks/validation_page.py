"""docs/validation.md from runs of the code as it is: the one command behind every number in it.

usage: python benchmarks/validation_page.py [--reuse] [--budget SECONDS] [--levels N]

Runs, one after the other and each in a process of its own: `isph validate` over all of cases/, `isph validate --paper`,
benchmarks/mutations.py, benchmarks/calibration.py (its report; what it measured is in isphcli/data) and
benchmarks/measuring.py. What they leave stands in out/page; --reuse takes what is there
from before and runs the rest. About an hour on one core.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out" / "page"
PAGE = """\
# Validation

Written by `python benchmarks/validation_page.py`, which runs what is shown at the head of each part. The verdict of a
case is about the spacing that stands in its file; the best error may be of a finer one. Seconds are of one core,
without compilation and without the reference solution.

{cases}

{paper}

## Broken operators, noticed

`python benchmarks/mutations.py` changes one line of the code and runs the quick references with it; the worst misses
come first. Where none does, the reason stands there.

{mutations}

## Known bodies

{bodies}

## Measuring

`python benchmarks/measuring.py`: CPU seconds that a run reports against those of the operating system, and what of
them only measures.

```
{measuring}
```
"""


def part(name, command, result, reuse):
    """The text that a command leaves, in the file `result` or on its standard output."""
    path = OUT / result
    if not (reuse and path.exists()):
        print(shlex.join(command), flush=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, *command], cwd=ROOT, env=environment, capture_output=True, text=True)
        if not path.exists() or path.name.endswith(".txt"):
            path.write_text(done.stdout or done.stderr)
        print(f"  {name}: exit code {done.returncode}", flush=True)
    return path.read_text()


def demoted(page):
    """A Markdown page as a part of another: its headings a level lower, its pictures left out."""
    lines = [line for line in page.splitlines() if not line.startswith("![")]
    lines = ["#" + line if line.startswith("#") else line for line in lines]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reuse", action="store_true", help="take the parts that stand in out/page")
    parser.add_argument("--budget", type=float, default=400.0, help="seconds of the levels of a case")
    parser.add_argument("--levels", type=int, default=2, help="resolutions of a case")
    options = parser.parse_args()
    common = ["--threads", "1", "--quiet"]
    folder = OUT.relative_to(ROOT)
    cases = part("cases", ["-m", "isphcli", "validate", "--levels", str(options.levels), "--budget",
                           f"{options.budget:g}", "--out", str(folder / "cases"), *common],
                 "cases/validation.md", options.reuse)  # fmt: skip
    paper = part("paper", ["-m", "isphcli", "validate", "--paper", "--out", str(folder / "paper"), "--threads", "1"],
                 "paper/report.md", options.reuse)  # fmt: skip
    mutations = part("mutations", ["benchmarks/mutations.py"], "mutations.txt", options.reuse)
    measuring = part("measuring", ["benchmarks/measuring.py"], "measuring.txt", options.reuse)
    bodies = part("bodies", ["benchmarks/calibration.py", "report", "isphcli/data/known_bodies_measured.csv"],
                  "bodies.txt", options.reuse)  # fmt: skip
    text = PAGE.format(
        cases=demoted(cases).replace("## Validation", "## Cases", 1), paper=demoted(paper),
        mutations=mutations.strip(), bodies=bodies.strip(), measuring=measuring.strip(),
    )  # fmt: skip
    (ROOT / "docs" / "validation.md").write_text(text)


if __name__ == "__main__":
    main()
