"""The size and the structure of the package, in figures.

    PYTHONPATH=. python benchmarks/structure.py [FOLDER ...]

FOLDER: of a package, here isphcli; that of an earlier commit is there after
`mkdir -p /tmp/before && git archive e9399b3 isphcli | tar x -C /tmp/before`. A floor is one more than the highest of
the files that a file imports; files that import each other in a circle stand on one. Functions that numba compiles
count for arguments and the median, not for annotations and the longest.
"""

import ast
import statistics
import sys
from pathlib import Path

from tests.source import files_of, functions, imports, is_kernel, lines, not_annotated, taken


def reached(arrows, name):
    """All files that a file imports, directly or through others."""
    found, ask = set(), [name]
    while ask:
        new = arrows[ask.pop()] - found
        found |= new
        ask += new
    return found


def floors_and_circles(arrows):
    """(number of floors, number of circles of files)."""
    reach = {name: reached(arrows, name) for name in arrows}
    circle = {name: frozenset(other for other in reach[name] if name in reach[other]) | {name} for name in arrows}
    floor = {}
    for name in sorted(arrows, key=lambda name: len(reach[name] | circle[name])):  # what it imports has come before
        floor[name] = 1 + max((floor[other] for other in reach[name] - circle[name]), default=0)
    return max(floor.values()), len({found for found in circle.values() if len(found) > 1})


def figures(package):
    """[(what, figure)] of a package."""
    files = files_of(package)
    trees = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in files.items()}
    floors, circles = floors_and_circles({name: imports(name, tree, files) for name, tree in trees.items()})
    found = [node for tree in trees.values() for node in functions(tree)]
    python = [node for node in found if not is_kernel(node)]
    public = [node for node in python if not node.name.startswith("_")]
    longest = max(python, key=lines)
    said = sum(not not_annotated(node) for node in public)
    return [("files", len(files)), ("floors of imports", floors), ("circles of imports", circles),
            ("functions", len(found)), ("of 8 arguments and more", sum(len(taken(node)) > 7 for node in found)),
            ("lines of a function, median", f"{statistics.median(map(lines, found)):g}"),
            ("longest function but for kernels", f"{lines(longest)} ({longest.name})"),
            ("public functions with annotations", f"{100 * said / len(public):.0f} %")]


if __name__ == "__main__":
    packages = [Path(name) for name in sys.argv[1:]] or [Path(__file__).parents[1] / "isphcli"]
    for row in zip(*map(figures, packages)):
        print("|", row[0][0], "|", " | ".join(str(figure) for _, figure in row), "|")
