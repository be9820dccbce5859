"""Which reference notices which broken operator.

    python benchmarks/mutations.py [--out DIR] [NAME ...]

A mutation is one small change of the source: a sign, a factor, an order. The package is copied, one line of the copy
is changed, and `isph validate --levels 1` runs the quick references with it in a process of its own. Prints a Markdown
table: what was changed, and the references that miss their bound with it (error over bound), nearest miss last.
About 20 s a mutation, of which most is the compiler.
"""

import argparse
import ast
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
QUICK = (
    "slit", "square_duct", "annulus", "cylinder_array", "two_tubes", "taylor_couette", "couette", "startup_couette",
    "startup_poiseuille", "decaying_channel", "taylor_green_2d", "taylor_green_2d_re100", "taylor_green_3d",
)  # fmt: skip
TWO_FLUIDS = ("two_layer_couette", "two_layer_poiseuille", "square_drop_1")
TIMEOUT = 600  # s: a broken operator may never converge


class Mutation(NamedTuple):
    """One change: text of a module of the package that occurs once, what stands there instead, why no reference is
    known to miss its bound by it, and a test of the suite that notices it then."""

    name: str
    kind: str  # sign, factor or order
    what: str
    module: str
    old: str
    new: str
    cases: tuple[str, ...] = QUICK
    unnoticed: str = ""
    test: str = ""


MUTATIONS = (
    Mutation("laplacian_factor", "factor", "the 2 of the Laplacian (eq. 6) forgotten",
             "operators.moments", "lap[k] = w[k] * (2.0 * tensor", "lap[k] = w[k] * (1.0 * tensor"),
    Mutation("laplacian_gradient_sign", "sign", "e . grad f of eq. 6 added, not subtracted",
             "operators.moments", "tensor / s[k] - (d0 * g0", "tensor / s[k] + (d0 * g0"),
    Mutation("gradient_uncorrected", "order", "correction tensor G_i of the gradient (eq. 5) dropped",
             "operators.moments", "g00, g01, g02, g11, g12, g22 = g[0, 0], g[0, 1], g[0, 2], g[1, 1], g[1, 2], g[2, 2]",
             "g00, g01, g02, g11, g12, g22 = 1.0, 0.0, 0.0, 1.0, 0.0, 1.0"),
    Mutation("gradient_first_order", "order", "second-order part K_i of the gradient dropped",
             "operators.moments", "    if order == 1:\n        return\n", "    if order < 3:\n        return\n"),
    Mutation("laplacian_second_order", "order", "viscous step of second order",
             "operators.fourth_order", "if not near_wall[i] and fourth > 0.0:", "if near_wall[i] and fourth > 0.0:"),
    Mutation("wall_sign", "sign", "a wall's share of the diagonal subtracted (extrapolation, eq. 11)",
             "operators.wall_weights", "    lap[i] += a\n", "    lap[i] -= a\n"),
    Mutation("wall_at_the_dummy", "order", "walls taken at the dummy, not where the pair meets them",
             "operators.wall_weights", "s[k] *= t[first]", "s[k] *= 1.0"),
    Mutation("rotational_sign", "sign", "rotational term of the pressure added, not subtracted",
             "flow.step", "+ beside - terms.rotational_viscosity * div", "+ beside + terms.rotational_viscosity * div"),
    Mutation("projection_factor", "factor", "half of the pressure gradient taken off the velocity (eq. 3)",
             "flow.step", "u = u_star - terms.ops.gradient_p(q) / rate",
             "u = u_star - 0.5 * terms.ops.gradient_p(q) / rate",
             unnoticed="the pressure is incremental: what divergence is left comes back in the next right-hand side",
             test="tests/flow/test_projection.py::test_a_step_takes_off_the_gradient_of_its_pressure"),
    Mutation("first_order_in_time", "order", "implicit Euler in place of the second-order scheme",
             "flow.step", "dt / state.dt_old if (state.dt_old and self.second_order) else 0.0", "0.0"),
    Mutation("shift_without_carry", "order", "shifted particles keep their velocity (eq. 9 dropped)",
             "flow.shifting", "taylor(ops, fields, gradients, dr, second)",
             "taylor(ops, fields, gradients, 0.0 * dr, second)"),
    Mutation("darcy_factor", "factor", "permeability of the mean velocity of the pores, not the superficial one",
             "runs.permeability", "total * (site_volume / np.prod(upper - lower))",
             "total / max(int(inside.sum()), 1)"),
    Mutation("viscosity_mean", "order", "mean viscosity between unlike particles, not the one that keeps the stress",
             "two_phase.two_fluids", "1.0 / (t / mu[i] + (1.0 - t) / mu[j])",
             "(0.5 * mu[i] + 0.5 * mu[j])", TWO_FLUIDS),
    Mutation("tension_factor", "factor", "nine tenths of the pressure jump of the interface",
             "two_phase.surface_tension", "jump = scale * (", "jump = 0.9 * scale * (", TWO_FLUIDS),
    Mutation("curvature_sign", "sign", "the curvature of an interface has the opposite sign in 2D",
             "two_phase.quadratic_fit", "-(xx * gy * gy", "(xx * gy * gy", TWO_FLUIDS),
)  # fmt: skip


def mutate(source, mutation):
    """The text of a module with the mutation; AssertionError where the text to change is not there once."""
    assert source.count(mutation.old) == 1, f"{mutation.name}: the text to change must occur once in {mutation.module}"
    return source.replace(mutation.old, mutation.new)


def copy_package(target, mutation):
    """The package and its cases in `target`, mutated; compiled kernels are kept where they do not see the change."""
    shutil.copytree(ROOT / "isphcli", target / "isphcli")  # keeps the times that the cache of numba goes by
    shutil.copytree(ROOT / "cases", target / "cases")
    if mutation is None:
        return
    path = file_of(target / "isphcli", mutation.module)
    path.write_text(mutate(path.read_text(), mutation))
    for name in dependents(mutation.module):
        changed = file_of(target / "isphcli", name)
        for compiled in (changed.parent / "__pycache__").glob(f"{changed.stem}.*"):
            compiled.unlink()


def file_of(package, module):
    """The file of a module such as operators.moments."""
    return package.joinpath(*module.split(".")).with_suffix(".py")


def imported(name, text):
    """Modules of the package that a module imports, by the text of it."""
    folder, found = name.split(".")[:-1], set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = ".".join(folder[: len(folder) - node.level + 1] + ([node.module] if node.module else []))
            found |= {base, *(f"{base}.{alias.name}".strip(".") for alias in node.names)}
    return found


def dependents(module):
    """Modules that import a module of the package, directly or not, and itself: their kernels may hold its kernels."""
    package = ROOT / "isphcli"
    names = {".".join(path.relative_to(package).with_suffix("").parts): path for path in package.rglob("*.py")}
    known = {name: imported(name, path.read_text()) for name, path in names.items()}
    found, new = set(), {module}
    while new:
        found |= new
        new = {name for name, others in known.items() if name not in found and others & found}
    return found


def validate(folder, out, names):
    """{case: its setting of validation.json, or None where the command ended before} of some references."""
    cases = [f"cases/{name}.yaml" for name in names]
    command = [sys.executable, "-m", "isphcli", "validate", *cases, "--levels", "1", "--out", str(out), "--quiet",
               "--threads", "1"]  # fmt: skip
    environment = os.environ | {"PYTHONPATH": str(folder)}
    try:
        subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        pass
    results = {}
    for name in names:
        path = out / name / "validation.json"
        results[name] = json.loads(path.read_text())["settings"][0] if path.exists() else None
    return results


def misses(results):
    """[(error over bound, text)] of the references that are missed, the worst first; a failed run is infinitely bad."""
    found = []
    for name, setting in results.items():
        if setting is None or not setting["levels"]:
            found.append((float("inf"), f"{name} (did not end)"))
        elif not setting["verdict"]["passed"]:
            error, why, word = setting["levels"][0]["error"], setting["verdict"]["why"], setting["verdict"]["word"]
            if error is None:
                found.append((float("inf"), f"{name} (run failed: {why.split(':')[0]})"))
            elif word != "FAIL":
                found.append((float("inf"), f"{name} ({word.lower()}: {why.split(':')[0]})"))
            else:
                bound = float(why.split("= " if "= " in why else "> ")[1].split(" at")[0])
                found.append((abs(error) / bound, f"{name} ({error:+.2g}, bound {bound:g})"))
    return sorted(found, reverse=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="mutations to run; all without a name")
    parser.add_argument("--out", type=Path, help="where the results of the runs stay; nowhere without it")
    options = parser.parse_args()
    print("| broken | kind | what was changed | references that miss their bound |\n" + "| --- " * 4 + "|", flush=True)
    chosen = [m for m in MUTATIONS if not options.names or m.name in options.names]
    missed_by_all = []
    for mutation in (None, *chosen):
        with tempfile.TemporaryDirectory() as folder:
            copy_package(Path(folder), mutation)
            name = mutation.name if mutation else "nothing"
            out = options.out.absolute() / name if options.out else Path(folder, "out")
            found = misses(validate(Path(folder), out, mutation.cases if mutation else QUICK + TWO_FLUIDS))
        kind, what = (mutation.kind, mutation.what) if mutation else ("-", "the code as it is")
        shown = "; ".join(text for _, text in found[:4]) + (f"; {len(found) - 4} more" if len(found) > 4 else "")
        if not shown:
            shown = f"none: {mutation.unnoticed}" if mutation and mutation.unnoticed else "none"
            if mutation and mutation.test:
                shown += f"; by {mutation.test}"
        print(f"| {name} | {kind} | {what} | {shown} |", flush=True)
        if mutation and not found:
            missed_by_all.append(name)
    if missed_by_all:
        sys.exit(f"not noticed: {', '.join(missed_by_all)}")


if __name__ == "__main__":
    main()
