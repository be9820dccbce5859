"""docs/validation.md from runs of the code as it is: the one command behind every table in it.

usage: python benchmarks/validation_page.py [--reuse] [--parts NAME,...] [--budget SECONDS]

Runs, one after the other and each in a process of its own: `isph validate` over the cases of one fluid and over those
of two, `isph validate --paper`, benchmarks/mutations.py, benchmarks/calibration.py (report and volumes; what it
measured is in isphcli/data) and benchmarks/measuring.py. What each leaves stands in out/page, with the commit that it
was measured at, and replaces what stands in the page between `<!-- part: NAME -->` and `<!-- end -->`; the text round
these parts is written by hand and stays. --parts: one_fluid, two_fluids, paper, mutations, bodies, volumes, measuring;
all without it. --reuse takes what is in out/page from before and runs the rest. About an hour on one core.
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
PAGE = ROOT / "docs" / "validation.md"
MEASURED = "isphcli/data/known_bodies_measured.csv"
TITLES = {"one_fluid": "Cases of one fluid", "two_fluids": "Cases of two fluids"}
LEVELS = {"one_fluid": 2, "two_fluids": 1}  # resolutions of a case


def commit():
    """The commit of this checkout, with "and changes" where files differ from it."""
    asked = ["git", "describe", "--always", "--dirty= and changes", "--exclude=*"]
    return subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def left_by(name, command, result, reuse):
    """(text, commit) that a command leaves, in the file `result` of out/page or on its standard output."""
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
    return path.read_text(), at.read_text().strip()


def demoted(page, commit, title=None):
    """A Markdown page as a part of another: its headings a level lower, its pictures left out, its commit named."""
    lines = [line for line in page.splitlines() if not line.startswith("![")]
    lines = ["#" + line if line.startswith("#") else line for line in lines]
    if title is not None:
        lines[0] = f"## {title}"
    lines.insert(next(k for k, line in enumerate(lines) if line.startswith("- date:")), f"- commit: {commit}")
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip()


def shown(name, text, commit):
    """A part of the page of what a command left."""
    if name in ("one_fluid", "two_fluids", "paper"):
        return demoted(text, commit, TITLES.get(name))
    if name in ("bodies", "volumes"):  # of numbers measured before, whose commit stands in the text
        return text.strip()
    if name == "measuring":
        text = f"```\n{text.strip()}\n```"
    return f"Commit {commit}.\n\n{text.strip()}"


def replaced(page, name, text):
    """The page with this text between the markers of a part. Raises ValueError where they are not there once."""
    between = rf"(<!-- part: {name} -->\n).*?(\n<!-- end -->)"
    found, count = re.subn(between, lambda ends: ends[1] + text + ends[2], page, flags=re.DOTALL)
    if count != 1:
        raise ValueError(f"{PAGE}: {count} parts named {name}, there must be one")
    return found


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
    parser.add_argument("--reuse", action="store_true", help="take what stands in out/page")
    parser.add_argument("--parts", help="names, with commas between them; all parts without it")
    parser.add_argument("--budget", type=float, default=400.0, help="seconds of the levels of a case")
    options = parser.parse_args()
    folder = OUT.relative_to(ROOT)
    commands = {}
    for name, cases in zip(LEVELS, cases_by_fluids()):
        ladder = ["--levels", str(LEVELS[name]), "--budget", f"{options.budget:g}", "--threads", "1", "--quiet"]
        commands[name] = ["-m", "isphcli", "validate", *cases, *ladder, "--out", str(folder / name)]
    commands["paper"] = ["-m", "isphcli", "validate", "--paper", "--out", str(folder / "paper"), "--threads", "1"]
    commands["mutations"] = ["benchmarks/mutations.py"]
    commands["bodies"] = ["benchmarks/calibration.py", "report", MEASURED]
    commands["volumes"] = ["benchmarks/calibration.py", "volumes", MEASURED]
    commands["measuring"] = ["benchmarks/measuring.py"]
    results = {"one_fluid": "one_fluid/validation.md", "two_fluids": "two_fluids/validation.md",
               "paper": "paper/report.md"}  # fmt: skip
    page = PAGE.read_text()
    for name in options.parts.split(",") if options.parts else commands:
        left = left_by(name, commands[name], results.get(name, f"{name}.txt"), options.reuse)
        page = replaced(page, name, shown(name, *left))
    PAGE.write_text(page)


if __name__ == "__main__":
    main()
