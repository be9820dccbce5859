"""What a permeability from so many particles per voxel is worth: every known body, against its true permeability.

usage: PYTHONPATH=. python benchmarks/calibration.py measure FILE.csv WALL[,WALL...] [NAME ...]
       PYTHONPATH=. python benchmarks/calibration.py report FILE.csv
       PYTHONPATH=. python benchmarks/calibration.py volumes FILE.csv [BEYOND]
       PYTHONPATH=. python benchmarks/calibration.py bars FILE.csv

measure: solves the bodies of `isphcli.validation.known_bodies` at 1, 2 and 3 particles per voxel edge, as far as they
have MOST particles, and appends a row a body and wall to FILE.csv; rows that it has are kept. WALL: exact (the surface
itself), labels, grey, scan (random bodies, whose grey image is their level function, by the share of solid in a voxel
as the others), stairs; "finite volumes" and "lattice Boltzmann" are those of benchmarks/finite_volumes.py and
benchmarks/lattice_boltzmann.py on the labels. report: prints the table of bodies, and what
`isphcli/runs/expected_error.py` takes from it. volumes: what labels and their smooth body make of the volume of the
pores of bodies whose k from labels is more than BEYOND (0.03) off.

bars: what error bars hold, and what they would hold of a family of bodies by constants from all others.

Truth of stairs is another body, that of the cubes: finite volumes on 3 and 4 cells a voxel (6 and 8 on a slice of
straight bodies, 4 and 6 of large ones), extrapolated by the order of edges; a body without edges (slits and ducts along
the voxels) is left out.
"""

import csv
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import finite_volumes
import lattice_boltzmann
import numpy as np

from isphcli.case.load import read_case
from isphcli.output.clock import Clock
from isphcli.preflight.look import look
from isphcli.references.published import DATA
from isphcli.runs.expected_error import WALLS, calibrations, grain_chord, is_straight, mean_chord, pore_width
from isphcli.runs.permeability import EDGE, ORDER, extrapolate
from isphcli.runs.steady import build_scene, solve_axis
from isphcli.scene.build_geometry import build_geometry
from isphcli.validation.known_bodies import GREY_LEVEL, LevelGeometry, bodies
from isphcli.validation.markdown import table

LEVELS = (1, 2, 3)
MOST = 40_000  # particles of the third level: 3 to 8 CPU seconds
ELSEWHERE = DATA / "arrays_measured.csv"  # of benchmarks/bars_elsewhere.py: its first line is the command
HELD_BACK = DATA / "bodies_held_back.csv"  # of benchmarks/bodies_held_back.py
MANY = 100_000  # cells of the truth of stairs: a minute
GREY = ("grey", "scan")  # walls of images that are understood by a threshold
NAMES = ("body", "family", "wall", "truth", "uncertainty", "narrow", "median", "k", "flux", "cpu", "narrow_pores")


def case_of(body, wall, folder):
    image = {"grey": body.grey, "scan": partial(body.grey, scanned=True)}.get(wall, body.labels)()
    np.save(folder / "image.npy", image)
    what = f"grey: {{threshold: {GREY_LEVEL}, solid: above}}" if wall in GREY else "labels: {solid: 0, water: 1}"
    stairs = ", wall_distance: stairs" if wall == "stairs" else ""
    text = (f"geometry: {{voxels: {{file: {folder / 'image.npy'}, {what}, voxel_size: 1, axes: xyz}}"
            f", periodic: [x, y, z]{stairs}}}\nparticles: {{spacing: 1}}\n"
            f"fluids: {{water: {{density: 1, viscosity: 1}}}}\ndrive: {{axes: [{'xyz'[body.axis]}]}}\nflow: stokes\n")
    return read_case(text.encode(), f"{body.name}.yaml")


def stairs_truth(body):
    """(k, relative uncertainty): between the exponents of edges along and across the flow, see `permeability.EDGE`. Of
    bodies whose slices across z are all the same one slice is solved, and finer."""
    pores, cells = body.labels(), (3, 4)
    if np.all(pores == pores[:, :, :1]):
        pores = pores[:, :, :1]
        cells = (6, 8) if pores.sum() * 8**3 <= MANY else (4, 6)
    k = [finite_volumes.permeability(pores, body.axis, finer)[0] for finer in cells]
    limit, bar, *_ = extrapolate([1 / finer for finer in cells], k, EDGE)
    return limit, bar / limit


def has_edges(body):
    """Whether three of the four voxels around an edge are pores: without one `EDGE` says nothing of its stairs."""
    pores = (body.labels() == 1).astype(int)
    return any((pores + np.roll(pores, 1, a) + np.roll(pores, 1, b) + np.roll(pores, (1, 1), (a, b)) == 3).any()
               for a, b in ((0, 1), (0, 2), (1, 2)))


def truth_of(body):
    try:
        return body.truth()[:2]
    except KeyError:  # its k can be measured before its truth is computed
        return float("nan"), float("nan")


PEERS = {"finite volumes": finite_volumes.permeability, "lattice Boltzmann": lattice_boltzmann.permeability}


def peer(body, method):
    """Another method on the labels, at as many cells a voxel."""
    if method == "lattice Boltzmann":
        PEERS[method](np.ones((2, 2, 2), bool), 0)  # compiles
    values, seconds = [], []
    for level in LEVELS:
        if level > 2 and body.labels().sum() * level**3 > MOST:
            break
        begin = time.process_time()
        values.append(float(PEERS[method](body.labels(), body.axis, level)[0]))
        seconds.append(time.process_time() - begin)
    truth, uncertainty = truth_of(body)
    return {"body": body.name, "family": body.family, "wall": method, "truth": f"{truth:.6g}",
            "uncertainty": f"{uncertainty:.2g}", "k": " ".join(f"{k:.6g}" for k in values),
            "cpu": " ".join(f"{s:.2f}" for s in seconds)}


def row_of(body, wall):
    truth, uncertainty = stairs_truth(body) if wall == "stairs" else truth_of(body)
    with tempfile.TemporaryDirectory() as folder:
        case = case_of(body, "labels" if wall == "exact" else wall, Path(folder))
        geometry = build_geometry(case)
    throats = look(case, geometry, Clock(), True).throats
    if wall == "exact":
        geometry = LevelGeometry(body)
    values, fluxes, seconds, narrow = [], [], [], []
    for level in LEVELS:
        if level > 2 and body.labels().sum() * level**3 > MOST:
            break
        begin = time.process_time()
        scene = build_scene(case, geometry, 1 / level, Clock(), [body.axis])
        flow = solve_axis(case, scene, body.axis, np.eye(3)[body.axis], Clock())
        values.append(float(flow.permeability[body.axis]))
        fluxes.append(flow.mass_error)
        seconds.append(time.process_time() - begin)
        narrow.append(bool(flow.narrow))
    return {"body": body.name, "family": body.family, "wall": wall, "truth": f"{truth:.6g}",
            "uncertainty": f"{uncertainty:.2g}", "narrow": f"{throats['narrow']:.3g}",
            "median": f"{throats['median']:.3g}", "k": " ".join(f"{k:.6g}" for k in values),
            "flux": " ".join(f"{flux:.3g}" for flux in fluxes), "cpu": " ".join(f"{s:.2f}" for s in seconds),
            "narrow_pores": " ".join(str(int(b)) for b in narrow)}


def rows_of(path):
    if not Path(path).exists():
        return []
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def measure(path, walls, *names):
    done = {(row["body"], row["wall"]) for row in rows_of(path)}
    for wall in walls.split(","):
        for body in bodies():
            if (body.name, wall) in done or (names and body.name not in names):
                continue
            if (wall == "stairs" and not has_edges(body)) or (wall == "scan" and not body.field):
                continue
            row = peer(body, wall) if wall in PEERS else row_of(body, wall)
            new = not Path(path).exists()
            with open(path, "a", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, NAMES, lineterminator="\n")
                if new:
                    writer.writeheader()
                writer.writerow(row)
            off = ", ".join(f"{100 * (float(k) / float(row['truth']) - 1):+.2f}" for k in row["k"].split())
            print(f"{wall} {body.name}: {off} % of {row['truth']}, CPU s {row['cpu']}", flush=True)


# -- what it says ---------------------------------------------------------------------------------------


def measured(path):
    """Rows of a file with numbers in place of texts, and with their truth; those without one are left out."""
    known = {body.name: body for body in bodies()}
    rows = []
    for row in rows_of(path):
        body = known[row["body"]]
        try:
            true, unsure, _ = body.truth()
        except KeyError:
            continue
        porosity, pores = float(body.labels(3).mean()), body.labels() == 1
        rows.append({**row, "true": true, "truth": float(row["truth"]) if row["wall"] == "stairs" else true,
                     "k": np.array(row["k"].split(), float), "flux": np.array(row["flux"].split(), float),
                     "cpu": row["cpu"].split(), "chord": mean_chord(pores), "straight": is_straight(pores),
                     "unsure": 0.0 if row["wall"] == "stairs" else unsure,
                     "pores": pore_width(true, porosity),
                     "width": min(pore_width(true, porosity), grain_chord(LevelGeometry(body), 1 / 3))})
    return rows


def off(k, truth):
    """Relative error, as much of one too small as of one too large by the same factor."""
    return np.exp(np.abs(np.log(np.asarray(k) / truth))) - 1.0


def errors_of(rows, wall, part):
    """(widths, errors, families): of spacings widths of pores or grains in particles, against the truth or the finest
    spacing; of images mean chords in voxels. Of shapes with those of the scenes at random places, of images with the
    bodies that were held back."""
    widths, errors, families = [], [], []
    for row in rows:
        if row["wall"] not in (GREY if wall == "grey" else (wall,)):
            continue
        k = row["k"]
        if part != "spacing":
            if row["straight"] != (part == "straight"):
                continue
            families.append(row["family"])
            widths.append(row["chord"])
            errors.append(off(row["truth"] if wall == "stairs" else k[-1], row["true"]))
            continue
        converged = wall in ("exact", "stairs")
        limit, levels = (row["truth"], len(k)) if converged else (k[-1], len(k) - 1)
        widths += [row["width"] * level for level in LEVELS[:levels]]
        errors += list(off(k[:levels], limit))
        families += [row["family"]] * levels
    for row in rows_of(HELD_BACK) if part != "spacing" and wall in ("grey", "labels") else ():
        if (row[f"{wall}_straight"] == "1") == (part == "straight"):
            widths.append(float(row[f"{wall}_chord"]))
            errors.append(float(off(float(row[f"{wall}_k"]), float(row["truth"]))))
            families.append(row["family"])
    if (wall, part) == ("exact", "spacing"):
        for row in rows_of(ELSEWHERE):
            widths.append(float(row["width"]))
            errors.append(float(row["error"]))
            families.append(f"{row['family']} at random places")
    return np.array(widths), np.array(errors), np.array(families)


def fit(widths, errors, families, power=None):
    """(factor, power): the power by least squares of the logarithms, between 0.5 and 3, where it is not given; then the
    factor that a further body like these keeps within by 90 % (conformal prediction: of n + 1 bodies that one is as
    good as any). families: of the bodies, or None: nine in ten of each family keep within too. Who has a body of shapes
    has one of a kind: walls that all lie alike to the lattice are off by more than those of pores in all directions. Of
    images the part of the image, which knows straight pores, is larger."""
    if power is None:
        slope = -np.polyfit(np.log(widths), np.log(np.maximum(errors, 1e-5)), 1)[0]
        power = min(max(round(2 * slope) / 2, 0.5), 3.0)
    scaled = np.sort(errors * widths**power)
    factor = scaled[min(int(np.ceil(0.9 * (len(scaled) + 1))), len(scaled)) - 1]
    for family in () if families is None else np.unique(families):
        own = np.sort((errors * widths**power)[families == family])
        factor = max(factor, own[int(np.ceil(0.9 * len(own))) - 1])
    return float(factor), power


def bar_of(row, wall, levels):
    """(value, bar) of a body by the spacings of so many particles per voxel."""
    k = row["k"][np.array(levels) - 1]
    usual = calibrations()["exact", "spacing"].within(row["width"] * max(levels))
    edges, flux = (EDGE, 0.0) if wall == "stairs" else (None, row["flux"][max(levels) - 1])
    return extrapolate([1 / level for level in levels], k, edges, usual=usual, flux=flux)[:2]


def bars_of(rows, wall, levels):
    """(errors, bars, uncertainties) relative to the truth, of bodies that were solved at these particles per voxel; and
    their families."""
    found, families = [], []
    for row in rows:
        if row["wall"] == wall and len(row["k"]) >= max(levels):
            value, bar = bar_of(row, wall, levels)
            found.append((abs(value / row["truth"] - 1), bar / row["truth"], row["unsure"]))
            families.append(row["family"])
    return np.array(found).reshape(-1, 3).T, np.array(families)


SETS = ((1, 2), (2, 3), (1, 2, 3))


def by_families(path):
    """Of bars as they are, and of bars scaled for every family with one factor from all others: the smallest by which
    nine of ten of their bodies hold, and a further one (conformal prediction), whatever the spacings. Printed: the
    share of the bodies that hold the truth, and the median of bar over error."""
    rows, lines = measured(path), []
    for wall in ("exact", "stairs"):
        found = [bars_of(rows, wall, levels) for levels in SETS]
        needed = [np.maximum(errors - unsure, 0.0) / bars for (errors, bars, unsure), _ in found]

        def factor(family, found=found, needed=needed):
            others = [np.sort(need[families != family]) for need, (_, families) in zip(needed, found)]
            return max(other[min(int(np.ceil(0.9 * (len(other) + 1))), len(other)) - 1] for other in others)

        for levels, need, ((errors, bars, _), families) in zip(SETS, needed, found):
            factors = np.array([factor(family) for family in families])
            ratios = bars / np.maximum(errors, 1e-6)
            lines.append([f"{wall}, {levels}", str(len(bars)), f"{100 * np.mean(need <= 1):.0f}",
                          f"{np.median(ratios):.2f}", f"{factors.min():.2f} to {factors.max():.2f}",
                          f"{100 * np.mean(need <= factors):.0f}", f"{np.median(factors * ratios):.2f}"])
    print("\n".join(table(["walls, particles per voxel", "bodies", "held, %", "bar over error", "factor by the others",
                           "held by it, %", "bar over error by it"], lines)))


KINDS = ("exact", *GREY, "labels", "stairs", *PEERS)


def table_of_bodies(rows):
    """A row a body: errors in per cent at 1, 2, 3 particles (cells) a voxel of each kind of wall, then CPU seconds."""
    heads = ["body", "pores and chords, voxels", "true k, voxel^2", *(f"{kind}, %" for kind in KINDS), "labels: bar, %",
             "CPU s: labels", *PEERS]
    lines = []
    for body in bodies():
        own = {row["wall"]: row for row in rows if row["body"] == body.name}
        if "labels" not in own:
            continue
        labels = own["labels"]
        _, uncertainty, _ = body.truth()
        line = [body.name, f"{labels['pores']:.2f}, {labels['chord']:.2f}",
                f"{labels['true']:.4g}" + (f" +- {100 * uncertainty:.1f} %" if uncertainty > 1e-6 else "")]
        for kind in KINDS:
            found = own.get(kind)
            line.append(", ".join(f"{100 * (k / found['truth'] - 1):+.2f}" for k in found["k"]) if found else "")
        value, bar = bar_of(labels, "labels", LEVELS[: len(labels["k"])])
        line += [f"{100 * bar / value:.2f}", ", ".join(labels["cpu"])]
        line += [", ".join(own[method]["cpu"]) if method in own else "" for method in PEERS]
        lines.append(line)
    return table(heads, lines)


def report(path):
    rows = measured(path)
    command = f"PYTHONPATH=. python benchmarks/calibration.py report {path}"
    print(f"`{command}`: errors at 1, 2 and 3\n"
          "particles per voxel, of stairs from the body of cubes, of all others from the true body. Finite volumes\n"
          "(benchmarks/finite_volumes.py) and lattice Boltzmann (benchmarks/lattice_boltzmann.py) take the labels\n"
          "and as many cells.\n")
    print("\n".join(table_of_bodies(rows)))
    print("\nBars (`runs/permeability.py`) against the truth of the surface that was solved:\n")
    for wall in ("exact", "stairs"):
        for levels in SETS:
            (errors, bars, unsure), _ = bars_of(rows, wall, levels)
            if len(errors):
                held, ratio = np.mean(errors <= bars + unsure), np.median(bars / np.maximum(errors, 1e-6))
                print(f"- {wall}, {levels} a voxel: {len(errors)} bodies, {100 * held:.0f} % within the bar, median "
                      f"error {100 * np.median(errors):.3f} %, bar {100 * np.median(bars):.3f} %, bar over error "
                      f"{ratio:.2f}")
    print("\nRelative errors that 90 % keep within, factor / width^power, with the width of the pores or the chord "
          "of the\ngrains in particles (spacing) or the mean chord of either in voxels (image; straight: all slices "
          "alike), as\nisphcli/data/calibration.csv has them:\n\n```\n"
          f"# {command}\nwall,part,factor,power,bodies,widest")
    for wall in WALLS:
        for part in ("spacing",) if wall == "exact" else ("spacing", "image", "straight"):
            widths, errors, families = errors_of(rows, wall, part)
            if len(widths) > 1:
                # an image leaves the place of a wall open by a share of a voxel: by first order in the chord; beside
                # smooth walls of every kind the order is that of the bars
                power = 1.0 if part != "spacing" else ORDER if wall != "stairs" else None
                factor, power = fit(widths, errors, families if wall == "exact" else None, power)
                count = len(widths) if part != "spacing" else len({r["body"] for r in rows if r["wall"] == wall})
                count += len(rows_of(ELSEWHERE)) // len(LEVELS) if (wall, part) == ("exact", "spacing") else 0
                print(f"{wall},{part},{factor:.3g},{power:g},{count},{widths.max():.3g}")
    print("```")


def volumes(path, beyond=0.03):
    """Volume of the pores by six lattice points per voxel edge, of the labels and of the smooth body by three."""
    lines = []
    for row in measured(path):
        k = float(row["k"][-1] / row["truth"] - 1)
        if row["wall"] != "labels" or abs(k) <= float(beyond):
            continue
        body = next(one for one in bodies() if one.name == row["body"])
        true, labels = (float(body.labels(finer).mean()) for finer in (6, 1))
        with tempfile.TemporaryDirectory() as folder:
            geometry = build_geometry(case_of(body, "labels", Path(folder)))
        points = np.meshgrid(*[(np.arange(3 * n) + 0.5) / 3 for n in body.size], indexing="ij")
        smooth = float(np.mean(geometry.phase(np.stack(points, axis=-1).reshape(-1, 3)) >= 0))
        lines.append([row["body"], f"{row['pores']:.2f}", f"{100 * k:+.2f}", f"{100 * (labels / true - 1):+.2f}",
                      f"{100 * (smooth / true - 1):+.2f}"])
    heads = ["body", "pores, voxels", "k, %", "volume of the labels, %", "of the smooth body, %"]
    print("\n".join(table(heads, lines)))


if __name__ == "__main__":
    {"measure": measure, "report": report, "volumes": volumes, "bars": by_families}[sys.argv[1]](*sys.argv[2:])
