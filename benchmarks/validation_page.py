"""docs/validation.md from runs of the code as it is: the one command behind every number in it.

usage: python benchmarks/validation_page.py [--reuse] [--budget SECONDS] [--levels N]

Runs, one after the other and each in a process of its own: `isph validate` over the cases of one fluid and over those
of two, `isph validate --paper`, benchmarks/mutations.py, benchmarks/calibration.py (report and volumes; what it
measured is in isphcli/data) and benchmarks/measuring.py. What they leave stands in out/page, with the commit that it
was measured at; --reuse takes what is there from before and runs the rest. About an hour on one core.
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

Written by `python benchmarks/validation_page.py`, which runs what is shown at the head of each part, at the commit that
stands there. The verdict of a case is about the spacing that stands in its file; the best error may be of a finer one.
Seconds are of one core, without compilation and without the reference solution.

{one_fluid}

{two_fluids}

{paper}

## Broken operators, noticed

`python benchmarks/mutations.py` (commit {mutations_at}) changes one line of the code and runs the quick references with
it; the worst misses come first. Where none does, the reason stands there, and the test of the suite that notices it.

{mutations}

## Known bodies

{bodies}

Not measured with stairs: bodies without an edge (slits and ducts along the voxels) and those whose cubes take long to
solve finely (separate 12, 20, touching 9, 14, 20).

Labels that are more than 3 % off at the finest spacing, `PYTHONPATH=. python benchmarks/calibration.py volumes
isphcli/data/known_bodies_measured.csv`: k, and what the labels and the smooth body that is solved make of the volume of
the pores.

{volumes}

Where the volume of a straight body is off, the labels themselves are: walls along the voxels lie anywhere within one,
all slices say the same, and k goes with the third power of a gap (slits, annulus: +20, +12.5, +3.9, -5.3 and +1.5 %
of volume are +73, +42, +12, -15 and +4.5 % of k), of ducts, pipes and ellipses with the square (-12.1 % are -23 %).
The smooth body keeps that volume, but rounds the corners of ducts and the ends of small cross sections, which takes
up to 2.6 % more of it. A grey image says where within a voxel the wall is; of walls along the voxels by the share of
a voxel alone, so that corners and slits are still up to 17 % off. The volume of the others is right and k is off by
what the labels make of single throats: the gap between cylinders of 4.6 voxels has 4 in the labels (0.4, 16),
neighbouring spheres leave 0.7 voxels at the throat (0.45, 14), pores of random bodies are 0.8 to 2.1 voxels wide
(blobs 15, 18, 19). Small grains lose volume in the smooth body (`volumes ... 0`; spheres 0.064, 8: of the solid 2.2 %
in the labels, 4.3 % in the smooth body), their k stays within 3 % all the same.

## Measuring

`python benchmarks/measuring.py` (commit {measuring_at}): CPU seconds that a run reports against those of the operating
system, and what of them only measures.

```
{measuring}
```
"""


def commit():
    """The commit of this checkout, with "and changes" where files differ from it."""
    asked = ["git", "describe", "--always", "--dirty= and changes", "--exclude=*"]
    return subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def part(name, command, result, reuse):
    """(text, commit) that a command leaves, in the file `result` or on its standard output."""
    path, at = OUT / result, OUT / f"{name}.commit"
    if not (reuse and path.exists()):
        print(shlex.join(command), flush=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        at.write_text(commit())
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, *command], cwd=ROOT, env=environment, capture_output=True, text=True)
        if not path.exists() or path.name.endswith(".txt"):
            path.write_text(done.stdout or done.stderr)
        print(f"  {name}: exit code {done.returncode}", flush=True)
    return path.read_text(), at.read_text()


def demoted(page, commit, title=None):
    """A Markdown page as a part of another: its headings a level lower, its pictures left out, its commit named."""
    lines = [line for line in page.splitlines() if not line.startswith("![")]
    lines = ["#" + line if line.startswith("#") else line for line in lines]
    if title is not None:
        lines[0] = f"## {title}"
    lines.insert(next(k for k, line in enumerate(lines) if line.startswith("- date:")), f"- commit: {commit}")
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip()


def cases_by_fluids():
    """(cases with one fluid, cases with more) of cases/ that name a reference, as paths from here."""
    sys.path.insert(0, str(ROOT))
    from isphcli.case.load import load_case

    kinds = [], []
    for path in sorted((ROOT / "cases").glob("*.yaml")):
        case = load_case(path)
        if case.reference is not None:
            kinds[len(case.fluids) > 1].append(str(path.relative_to(ROOT)))
    return kinds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reuse", action="store_true", help="take the parts that stand in out/page")
    parser.add_argument("--budget", type=float, default=400.0, help="seconds of the levels of a case")
    parser.add_argument("--levels", type=int, default=2, help="resolutions of a case")
    options = parser.parse_args()
    folder = OUT.relative_to(ROOT)
    measured = "isphcli/data/known_bodies_measured.csv"
    ladder = ["--levels", str(options.levels), "--budget", f"{options.budget:g}", "--threads", "1", "--quiet"]
    commands = {}
    for name, cases in zip(("one_fluid", "two_fluids"), cases_by_fluids()):
        commands[name] = ["-m", "isphcli", "validate", *cases, *ladder, "--out", str(folder / name)]
    commands["paper"] = ["-m", "isphcli", "validate", "--paper", "--out", str(folder / "paper"), "--threads", "1"]
    commands["mutations"] = ["benchmarks/mutations.py"]
    commands["measuring"] = ["benchmarks/measuring.py"]
    commands["bodies"] = ["benchmarks/calibration.py", "report", measured]
    commands["volumes"] = ["benchmarks/calibration.py", "volumes", measured]
    results = {"one_fluid": "one_fluid/validation.md", "two_fluids": "two_fluids/validation.md",
               "paper": "paper/report.md"}  # fmt: skip
    texts, at = {}, {}
    for name, command in commands.items():
        texts[name], at[name] = part(name, command, results.get(name, f"{name}.txt"), options.reuse)
    text = PAGE.format(
        one_fluid=demoted(texts["one_fluid"], at["one_fluid"], "Cases of one fluid"),
        two_fluids=demoted(texts["two_fluids"], at["two_fluids"], "Cases of two fluids"),
        paper=demoted(texts["paper"], at["paper"]), mutations_at=at["mutations"], measuring_at=at["measuring"],
        **{name: texts[name].strip() for name in ("mutations", "bodies", "volumes", "measuring")},
    )  # fmt: skip
    (ROOT / "docs" / "validation.md").write_text(text)


if __name__ == "__main__":
    main()
