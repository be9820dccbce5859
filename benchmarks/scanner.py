"""How far k from a scan holds: partial volumes, the scanner's blur and noise, over random bodies whose truth is known.

usage: PYTHONPATH=. python benchmarks/scanner.py [VARIANT ...]        (all)

A voxel of the scan has the share of solid in it (counted on 4^3 cells of the exact field), averaged with a Gaussian of
`blur` voxels, and normal noise of `noise` times the contrast; threshold half-way, one particle per voxel. Mean of the
signed errors of k over the bodies, in per cent, and their root mean square, for: the image as it is; averaged with a
Gaussian of half a voxel (`denoised`); sharpened by the blur that is found and corrected until its own scan is the image
(`auto`, `geometry/scan_fit.py`), or by the known blur (`known`); the same of the averaged image (`denoised, auto`);
labels (the scan segmented at the threshold); and as `auto` with the wall at Otsu's threshold, and half-way between
fluid and solid of the scan, which is what the threshold `otsu` takes.
Grey values are in units of half the contrast between the means of the two sides, as a case takes them.
"""

import sys

import numpy as np
from walls_from_labels import ROUND, labels_of, permeability  # sets the number of threads before numba is there

from isphcli.geometry.grey import field_of_grey, otsu_threshold
from isphcli.geometry.iso_surface import ImageField, IsoSurfaceGeometry
from isphcli.geometry.scan_fit import fit_scan
from isphcli.geometry.spline import average
from isphcli.validation.known_bodies import body

BODIES = tuple(body(name) for name in ("blobs 12", "blobs 14", "blobs 17", "blobs 19"))
FINER = 4  # cells a voxel edge of which partial volumes are counted
AROUND = np.ones(3, bool)
DENOISE = 0.5  # voxels


def scan(body, blur, noise):
    """The scan of a body, [z, y, x], > 0 in fluid."""
    cells = body.labels(FINER).transpose(2, 1, 0)
    shares = cells.reshape([e for n in body.size[::-1] for e in (n, FINER)]).mean(axis=(1, 3, 5))
    image = average((2.0 * shares - 1.0).astype(np.float32), blur, AROUND)
    rng = np.random.default_rng(sum(body.size) + BODIES.index(body))
    return -field_of_grey(image + 2.0 * noise * rng.standard_normal(image.shape), 0.0, "above")


def iso(image, gaussian=0.0):
    return IsoSurfaceGeometry(labels_of(image), ImageField(image, gaussian), 1.0, ROUND)


def by_otsu(image):
    """The image with its zero at Otsu's threshold."""
    return field_of_grey(image, otsu_threshold(image), "below")


VARIANTS = {
    "as it is": lambda image, blur: iso(image),
    "denoised": lambda image, blur: iso(image, DENOISE),
    "auto": lambda image, blur: iso(fit_scan(image, AROUND).field),
    "known": lambda image, blur: iso(fit_scan(image, AROUND, None, blur).field),
    "denoised, auto": lambda image, blur: iso(fit_scan(average(image, DENOISE, AROUND), AROUND).field),
    "Otsu": lambda image, blur: iso(fit_scan(by_otsu(image), AROUND).field),
    "half-way": lambda image, blur: iso(fit_scan(by_otsu(image), AROUND, centred=True).field),
    "labels": lambda image, blur: IsoSurfaceGeometry(labels_of(image), None, 1.0, ROUND),
}


def main(*names):
    chosen = {name: VARIANTS[name] for name in names or VARIANTS}
    truths = [body.truth()[0] for body in BODIES]
    print("| blur | noise | blur that is found | " + " | ".join(chosen) + " |\n" + "|---" * (3 + len(chosen)) + "|")
    for blur in (0.0, 0.5, 0.8):
        for noise in (0.0, 0.05, 0.1):
            images = [scan(body, blur, noise) for body in BODIES]
            guesses = [fit_scan(image, AROUND).blur for image in images]
            cells = []
            for make in chosen.values():
                errors = [100.0 * (permeability(make(image, blur), 1) / k - 1.0) for image, k in zip(images, truths)]
                cells.append(f"{np.mean(errors):+.1f} ({np.sqrt(np.mean(np.square(errors))):.1f})")
            print(f"| {blur:.1f} | {noise:g} | {min(guesses):.2f} to {max(guesses):.2f} | " + " | ".join(cells) + " |",
                  flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
