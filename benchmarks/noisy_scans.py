"""What the range of k says of scans with blur, noise and a second mineral, on bodies whose truth is known.

usage: PYTHONPATH=. python benchmarks/noisy_scans.py [NAME ...]        (the bodies of NAMES)

A voxel of the scan has the share of solid in it, counted on 6^3 cells of the exact field, that in places of a second
mineral (waves on MINERAL of the volume, as long as a quarter of the body and less) counted `bright` times, averaged
with a Gaussian of `blur` voxels, and normal noise of `noise` times the contrast between fluid and the first mineral;
one particle per voxel. Prints, for each kind of scan, the error of k as the image is with a threshold half-way between
those two, by `geometry/scan_fit.py` with that threshold, and with `threshold: otsu` (root mean square and largest, per
cent); of the latter how far the walls may be off (voxels), of how many bodies the part of the range by the image holds
the truth (`runs/expected_error.py`), and the error times the chord that holds nine in ten; then the same by how far the
walls may be off.
"""

import itertools
import sys

import numpy as np
from walls_from_labels import ROUND, labels_of, permeability  # sets the number of threads before numba is there

from isphcli.geometry.grey import field_of_grey, otsu_threshold
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.geometry.scan_fit import fit_scan
from isphcli.geometry.spline import average
from isphcli.runs.expected_error import Scan, expected, is_straight, mean_chord
from isphcli.validation.known_bodies import body

NAMES = ("blobs 12", "blobs 14", "blobs 17", "blobs 19", "spheres 0.216, 12", "spheres 0.45, 14", "separate 8",
         "touching 9", "touching 14", "pipe 3.7 at 45 degrees")
FINER = 6  # cells a voxel edge of which partial volumes are counted
MINERAL = 0.15
AROUND = np.ones(3, bool)
BLURS, NOISES, BRIGHT = (0.0, 0.5, 0.9), (0.0, 0.02, 0.05, 0.1), (1.0, 1.3, 1.6, 2.5)
NOISES_OF_TWO = (0.02, 0.05)  # of scans with a second mineral
EDGES = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 0.5)  # voxels, of how far walls may be off, that are shown together


def waves(shape, longest, rng):
    """A periodic random field [z, y, x], above 0 on MINERAL of it: noise without waves shorter than `longest` cells."""
    modes = np.fft.rfftn(rng.standard_normal(shape))
    frequencies = np.meshgrid(*(np.fft.fftfreq(n) for n in shape[:2]), np.fft.rfftfreq(shape[2]), indexing="ij")
    modes[np.sqrt(sum(f * f for f in frequencies)) > 2.0 / longest] = 0.0
    field = np.fft.irfftn(modes, shape, axes=(0, 1, 2))
    return field - np.quantile(field, 1.0 - MINERAL)


def scan(solid, mineral, kind):
    """Grey values [z, y, x] of the shares of solid and of the second mineral in it, by cells. kind: (blur, noise,
    bright, random numbers)."""
    blur, noise, bright, rng = kind
    values = solid * np.where(mineral, bright, 1.0)
    shape = [k for n in values.shape for k in (n // FINER, FINER)]
    image = average(values.reshape(shape).mean(axis=(1, 3, 5)).astype(np.float32), blur, AROUND)
    return image + noise * rng.standard_normal(image.shape)


def measured(one, kind):
    """(relative error of k as the image is, of the body that is found by a threshold half-way, by Otsu's, `ScanFit.off`
    of the latter, range by the image, chord)."""
    solid = 1.0 - one.labels(FINER).transpose(2, 1, 0)
    rng = np.random.default_rng(sum(one.size))
    mineral = waves(solid.shape, max(solid.shape) / 4, rng) > 0.0
    values, true, pores = scan(solid, mineral, (*kind, rng)), one.truth()[0], one.labels() == 1
    image, by_otsu = (field_of_grey(values, t, "above") for t in (0.5, otsu_threshold(values)))
    found = fit_scan(by_otsu, AROUND, centred=True)
    fields = image, fit_scan(image, AROUND).field, found.field
    geometries = (IsoSurfaceGeometry(labels_of(field), ImageField(field), 1.0, ROUND) for field in fields)
    errors = [permeability(geometry, 1, one.axis) / true - 1.0 for geometry in geometries]
    what = Scan(mean_chord(pores), is_straight(pores), found.off)
    return (*errors, found.off, expected("grey", true, 0.5, 1.0, scan=what).image, what.chord)


def line(name, rows):
    *errors, off, image, chord = rows.T
    error = errors[-1]
    of_each = "  ".join(f"{100 * np.sqrt(np.mean(e * e)):5.1f} {100 * np.abs(e).max():5.1f}" for e in errors)
    print(f"{name:30s}{of_each}   {off.mean():.3f}   {np.mean(np.abs(error) <= image):4.0%}"
          f"   {np.quantile(np.abs(error) * chord, 0.9):.3f}", flush=True)


def main(*names):
    print(f"{'blur  noise  bright':30s}as it is      half-way     otsu          off     held  factor")
    every = []
    for bright in BRIGHT:
        for noise in NOISES if bright == 1.0 else NOISES_OF_TWO:
            for blur in BLURS:
                rows = np.array([measured(body(name), (blur, noise, bright)) for name in names or NAMES])
                line(f"{blur:4.1f}  {noise:5.2f}  {bright:6.1f}", rows)
                every.append(rows)
    found = np.concatenate(every)
    print()
    for low, high in itertools.pairwise(EDGES):
        some = found[(found[:, 3] >= low) & (found[:, 3] < high)]
        if len(some):
            line(f"off {low} to {high}, {len(some)} scans", some)
    line(f"all {len(found)}", found)


if __name__ == "__main__":
    main(*sys.argv[1:])
