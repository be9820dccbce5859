"""Bodies of other kinds than those of `isphcli.validation.known_bodies`: what a run prints of each, beside its truth.

usage: PYTHONPATH=. python benchmarks/bodies_held_back.py FILE.csv [NAME ...]      (all without a name)

Every body is an image of a level function in a periodic box, run as a user does: grey values with one particle per
voxel and what is printed as range; with `refine: auto`; labels, the same. Of smooth fields the grey image is the
field, of all others the share of solid in a voxel. A value whose range does not hold the truth has a star. Truth: a
formula, or the exact surface with about PARTICLES particles; its uncertainty is the larger of the change from some
0.7 of the resolution and, where finite volumes on finer cells (benchmarks/finite_volumes.py, the mean of two
staircases) differ from it by more than 3 %, that difference over 3. What is in FILE.csv is kept: truths that were
computed, and k of grey images and of labels with `refine: auto`, which benchmarks/calibration.py takes for
what an image leaves open.
"""

import csv
import math
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from finite_volumes import permeability as finite_volumes
from true_permeabilities import solve

import isphcli  # before numpy: threads
from isphcli.runs.expected_error import is_straight, mean_chord
from isphcli.validation import known_bodies as known
from isphcli.validation.known_bodies import GREY_LEVEL, Body

PARTICLES = 6e4  # 10 to 30 CPU seconds
NAMES = ("body", "family", "truth", "uncertainty", "finite_volumes", "grey_chord", "grey_straight", "grey_k",
         "labels_chord", "labels_straight", "labels_k")
CELLS = 40  # along the longest edge, of finite volumes: 1 to 10 CPU seconds


def _cube(name, family, n, level, field=False, axis=0):
    return Body(name, family, (n,) * 3 if np.isscalar(n) else n, axis, level, field=field)


def _minimal(x, n, level, what):
    """Triply periodic minimal surfaces, one cell in n voxels."""
    a, b, c = (2 * np.pi * (x[:, i] - shift) / n for i, shift in enumerate((0.27, 0.11, 0.4)))
    sin, cos = np.sin, np.cos
    value = {"gyroid": lambda: sin(a) * cos(b) + sin(b) * cos(c) + sin(c) * cos(a),
             "P": lambda: cos(a) + cos(b) + cos(c),
             "D": lambda: cos(a) * cos(b) * cos(c) - sin(a) * sin(b) * sin(c)}[what]()
    return value - level


def minimal(what, n, porosity):
    points = (np.random.default_rng(1).random((400_000, 3))) * n
    level = float(np.quantile(_minimal(points, n, 0.0, what), 1.0 - porosity))
    surface = partial(_minimal, n=n, level=level, what=what)
    return _cube(f"{what} {porosity:g}, {n}", "minimal surface", n, surface, True)


def _capsules(x, n, middles, ways, radius):
    """Outside fibres with round ends, whose halves reach no farther than half the box less 3 voxels: the periodic image
    of the nearest middle is then that of the nearest wall. middles, ways: (m, 3) voxels."""
    out = np.full(len(x), np.inf)
    for middle, way in zip(middles, ways):
        offset = known._near(x - middle, n)
        t = np.clip(offset @ way / (way @ way), -0.5, 0.5)
        np.minimum(out, np.linalg.norm(offset - t[:, None] * way, axis=1) - radius, out=out)
    return out


def fibres(n, count, radius, length, seed):
    random = np.random.default_rng(seed)
    ways = random.standard_normal((count, 3))
    ways *= length / np.linalg.norm(ways, axis=1)[:, None]
    return _cube(f"fibres {2 * radius:g}", "fibres", n,
                 partial(_capsules, n=n, middles=random.random((count, 3)) * n, ways=ways, radius=radius))


def _crossing(x, n, radius):
    """Outside cylinders along x, y and z that pass each other."""
    def out(i, j, a, b):
        return np.hypot(known._near(x[:, i] - a, n), known._near(x[:, j] - b, n)) - radius
    along_x, along_y = out(1, 2, 0.3 * n, 0.2 * n), out(0, 2, 0.25 * n, 0.7 * n)
    return np.minimum(np.minimum(along_x, along_y), out(0, 1, 0.8 * n, 0.75 * n))


def _turned(seed, count):
    """(count, 3, 3) rotations at random."""
    from scipy.spatial.transform import Rotation

    return Rotation.random(count, random_state=seed).as_matrix()


def _grains(x, n, centres, turns, what):
    """Outside ellipsoids (half axes), boxes or disks (half edges; radius, half thickness), each turned."""
    out = np.full(len(x), np.inf)
    for centre, turn in zip(centres, turns):
        local = known._near(x - centre, n) @ turn
        kind, size = what
        if kind == "ellipsoid":
            value = (np.linalg.norm(local / size, axis=1) - 1.0) * min(size)
        else:
            if kind == "disk":
                local = np.stack([np.hypot(local[:, 0], local[:, 1]), local[:, 2]], axis=1)
            beyond = np.abs(local) - size
            value = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
        np.minimum(out, value, out=out)
    return out


def grains(name, n, count, kind, size, seed):
    centres = np.random.default_rng(seed).random((count, 3)) * n
    return _cube(name, kind, n, partial(_grains, n=n, centres=centres, turns=_turned(seed, count),
                                        what=(kind, np.array(size, float))))


def spheres(name, size, centres, radii):
    centres, radii = np.asarray(centres), np.asarray(radii)
    outside = partial(known._outside_spheres, size=size, centres=centres, radii=radii)
    return Body(name, "spheres", size, 0, outside, None, (centres, radii))


def unlike_spheres(name, n, radii, seed, gap=0.0):
    """Spheres of given radii, the largest first, `gap` or more between them."""
    random, centres = np.random.default_rng(seed), np.empty((0, 3))
    for k, radius in enumerate(radii):
        for _ in range(100_000):
            one = random.random(3) * n
            if np.all(np.linalg.norm(known._near(centres - one, n), axis=1) >= np.array(radii[:k]) + radius + gap):
                centres = np.vstack([centres, one])
                break
        else:
            raise ValueError(f"sphere {k} of {name} finds no place")
    return spheres(name, (n,) * 3, centres, radii)


def hexagonal(edge, radius):
    size = (edge, round(edge * math.sqrt(3)), round(edge * math.sqrt(8 / 3)))
    places = np.array([(0, 0, 0), (0.5, 0.5, 0), (0.5, 1 / 6, 0.5), (0, 2 / 3, 0.5)]) + (0.02, 0.03, 0.01)
    return spheres(f"hexagonal close {edge}", size, places * size, np.full(4, radius))


def _fracture(x, n, height, waves, aperture):
    """Between two rough walls. waves: of the lower wall and of the aperture, (m, 4): modes along x, y, phase, size."""
    def rough(part):
        kx, ky, phase, size = (column[:, None] for column in part.T)
        return np.sum(size * np.cos(2 * np.pi * (kx * x[:, 0] + ky * x[:, 1]) / n + phase), axis=0)
    low = height / 2 - aperture / 2 + rough(waves[0])
    return np.minimum(x[:, 2] - low, low + np.maximum(aperture + rough(waves[1]), -1.0) - x[:, 2])


def fracture(n, height, aperture, spread, seed, hurst=0.8, modes=6):
    """A fracture whose aperture is Gaussian and self-affine, closed where it would be negative."""
    random, waves = np.random.default_rng(seed), []
    kx, ky = (k.ravel() for k in np.meshgrid(np.arange(modes + 1), np.arange(-modes, modes + 1)))
    kept = (np.hypot(kx, ky) > 0) & (np.hypot(kx, ky) <= modes)
    kx, ky = kx[kept], ky[kept]
    for share in (0.6, 1.0):
        size = random.standard_normal(len(kx)) * np.hypot(kx, ky) ** (-1 - hurst)
        size *= share * spread / math.sqrt(np.sum(size**2) / 2)
        waves.append(np.stack([kx, ky, random.random(len(kx)) * 2 * np.pi, size], axis=1))
    return Body(f"fracture {aperture:g} +- {spread:g}", "fracture", (n, n, height), 0,
                partial(_fracture, n=n, height=height, waves=tuple(waves), aperture=aperture))


def _wavy_pipe(x, n, period, radius, depth):
    r = np.hypot(known._near(x[:, 1] - n / 2 - 0.2, n), known._near(x[:, 2] - n / 2 + 0.1, n))
    return radius * (1 + depth * np.cos(2 * np.pi * x[:, 0] / period)) - r


def _chambers(x, n, radius):
    """Within spheres that overlap: chambers with sharp windows between them."""
    return radius - np.linalg.norm(known._near(x - np.array([0.27, 0.11, 0.4]) - n / 2, n), axis=1)


def rock(seed, n, length, porosity):
    return _cube(f"rock {seed}: {porosity:g}, {length:g}", "rock", n,
                 partial(known._blobs, source=(seed, n, length, porosity)), True)


def held_back():
    random = np.random.default_rng(3)
    sizes = sorted(np.exp(random.normal(1.05, 0.3, 14)), reverse=True)
    return (
        minimal("gyroid", 12, 0.5), minimal("gyroid", 18, 0.7), minimal("P", 14, 0.5), minimal("P", 16, 0.3),
        minimal("D", 16, 0.5), minimal("D", 20, 0.7),
        fibres(18, 18, 1.6, 8.0, 1), fibres(20, 50, 0.9, 12.0, 2),
        _cube("cylinders across each other", "fibres", 16, partial(_crossing, n=16, radius=3.1)),
        grains("ellipsoids", 20, 12, "ellipsoid", (5.5, 3.5, 2.2), 4),
        grains("turned cubes", 18, 12, "box", (3.1, 3.1, 3.1), 5),
        grains("thin disks", 16, 8, "disk", (4.5, 0.6), 6),
        unlike_spheres("spheres 1 : 3", 18, [6.0] * 2 + [2.0] * 18, 7, 0.1),
        unlike_spheres("polydisperse", 18, sizes, 8, 0.05),
        hexagonal(12, 5.8),
        known._ellipse_body("ellipse at 37 degrees", (17, 15, 6), (8.3, 7.6), 37.0, 7.3, 3.1),
        fracture(24, 12, 3.5, 1.5, 9),
        _cube("wavy pipe", "channel", (16, 12, 12), partial(_wavy_pipe, n=12, period=16, radius=3.4, depth=0.4)),
        _cube("chambers", "chambers", 14, partial(_chambers, n=14, radius=8.0)),
        rock(31, 20, 1.6, 0.22), rock(32, 20, 2.2, 0.2),
    )


# -- truth and runs -------------------------------------------------------------------------------------


def truth_of(body):
    """(k in voxel^2, relative uncertainty), finite volumes included, and the CPU seconds."""
    begin, edge = time.process_time(), max(body.size)
    if body.known is not None:
        return body.known[0], body.known[1], math.nan, 0.0
    cells = round((PARTICLES / body.labels(2).mean() / np.prod(body.size)) ** (1 / 3) * edge)
    coarse, fine = (solve(body, edge / n)[0] for n in (round(0.7 * cells), cells))
    finer = max(CELLS // edge, 2)
    volumes = np.mean([finite_volumes(body.labels(n), body.axis)[0] / n**2 for n in (finer, finer + 1)])
    beyond = abs(volumes / fine - 1.0)
    return fine, max(abs(coarse / fine - 1.0), beyond / 3 * (beyond > 0.03)), volumes, time.process_time() - begin


def kept(path):
    """{body: row} of a file; see NAMES."""
    if not path.exists():
        return {}
    with open(path, encoding="utf-8", newline="") as file:
        return {row["body"]: row for row in csv.DictReader(line for line in file if not line.startswith("#"))}


def keep(path, rows):
    with open(path, "w", encoding="utf-8", newline="") as file:
        file.write(f"# PYTHONPATH=. python benchmarks/bodies_held_back.py {path}\n")
        writer = csv.DictWriter(file, NAMES, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows.values())


def row_of(body):
    """Truth, and what of the images their error depends on."""
    truth, unsure, volumes, _ = truth_of(body)
    row = {"body": body.name, "family": body.family, "truth": f"{truth:.6g}", "uncertainty": f"{unsure:.2g}",
           "finite_volumes": f"{volumes:.6g}"}
    for wall, pores in (("grey", body.grey() < GREY_LEVEL), ("labels", body.labels() > 0)):
        row |= {f"{wall}_chord": f"{mean_chord(pores):.3g}", f"{wall}_straight": int(is_straight(pores))}
    return row


def run(body, wall, refine=None):
    """Summary of a run, with its CPU seconds, compilation left out."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.npy"
        np.save(path, body.grey() if wall == "grey" else body.labels())
        voxels = {"file": str(path), "voxel_size": 1.0, "axes": "xyz"}
        voxels.update({"grey": {"threshold": GREY_LEVEL, "solid": "above"}} if wall == "grey"
                      else {"labels": {"solid": 0, "water": 1}})
        case = {"geometry": {"voxels": voxels, "periodic": ["x", "y", "z"]}, "particles": {"spacing": 1.0},
                "fluids": {"water": {"density": 1.0, "viscosity": 1.0}}, "flow": "stokes",
                "drive": {"axes": ["xyz"[body.axis]]}, "output": {"plots": False, "snapshots": False}}
        found = isphcli.run(case | ({"refine": refine} if refine else {}), quiet=True, threads=1).summary
    seconds = found["cpu_seconds"]
    return found | {"seconds": seconds["total"] - seconds.get("compile", 0.0)}


def cell(found, truth, unsure):
    k, (low, high) = found["permeability"], found["permeability_range"]
    outside = not low * (1 - unsure) <= truth <= high * (1 + unsure)
    return f"{100 * (k / truth - 1):+.2f} (-{100 * (1 - low / k):.1f} +{100 * (high / k - 1):.1f}){'*' * outside}"


def bar_cell(found):
    values = found["permeability_by_spacing"]
    k = list(next(iter(values.values())).values())
    bar = found["permeability_error"]
    return f"{len(k)}: +-{100 * bar / found['permeability']:.2f}"


def main(path, *names):
    path, rows = Path(path), kept(Path(path))
    print("| body | k, voxel^2 | finite volumes, % | grey, 1 a voxel, % | grey, refine: auto, % | its spacings: bar, % "
          "| labels, % | labels, refine: auto, % | its spacings: bar, % | CPU s of these |\n" + "|---" * 10 + "|")
    for body in held_back():
        if names and body.name not in names:
            continue
        row = rows.setdefault(body.name, {}) or row_of(body)
        truth, unsure, volumes = (float(row[key]) for key in ("truth", "uncertainty", "finite_volumes"))
        cells = [body.name, f"{truth:.4g} +- {100 * unsure:.2g} %", f"{100 * (volumes / truth - 1):+.1f}"]
        runs, warned = [], []
        for wall, refine in (("grey", None), ("grey", "auto"), ("labels", None), ("labels", "auto")):
            runs.append(run(body, wall, refine))
            cells.append(cell(runs[-1], truth, unsure))
            warned.append(f"{wall} {refine or ''}: {runs[-1]['warnings']}")
            if refine:
                cells.append(bar_cell(runs[-1]))
            row[f"{wall}_k"] = f"{runs[-1]['permeability']:.6g}"
        cells.append(", ".join(f"{found['seconds']:.1f}" for found in runs))
        rows[body.name] = row
        keep(path, rows)
        print("| " + " | ".join(cells) + " |", flush=True)
        print(body.name, *warned, sep="\n  ", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
