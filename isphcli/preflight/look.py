"""A case from its file to its results: the one place that chooses which terms a scene has."""

import sys

import numpy as np

from ..geometry.protocol import sample_box
from ..output import progress
from ..run.results import _porosity


class _Seen:
    """What was seen of a scene before anything was solved: `warnings`, `open_axes` (names of the axes along which
    pores lead through the sample, of a scene with walls) and `throats` (check.Throats or None)."""

    def __init__(self, case, found, geometry):
        self.voxels = case.geometry.voxels
        self.inputs = [f"{name}: {text}" for name, text in geometry.described]
        self.warnings = list(dict.fromkeys(found.warnings))
        self.throats = found.throats
        leads = found.connectivity.percolates if geometry.has_solid and found.connectivity is not None else ()
        self.open_axes = [name for name, open_ in zip("xyz", leads) if open_]

    def scene(self, geometry, particles):
        """Entries of the summary on the scene that was run."""
        image = throats = None
        if self.voxels is not None:
            voxel = np.asarray(geometry.voxel_size)
            lower, upper = sample_box(geometry)
            image = {"size": np.rint((upper - lower) / voxel).astype(int), "voxel_size": voxel,
                     "axes": self.voxels.axes}
        if self.throats is not None:
            throats = {"narrow": self.throats.narrow, "median": self.throats.median, "thin": self.throats.thin}
        return {"inputs": self.inputs, "image": image, "porosity": _porosity(geometry, particles),
                "open_axes": self.open_axes if geometry.has_solid else None, "throats": throats}


def _look(case, geometry, clock, quiet):
    """_Seen of a case that is about to run; what is warned of stands on stderr unless `quiet`.

    On Berea (128^3 voxels) it took 1.5 s on an idle core, 5 s on a busy one: the lattice is looked at,
    no neighbours are searched.
    """
    from .check import check

    with clock("check"), progress.stage("check of the scene", quiet):
        found = check(case, geometry, to_run=True)
    seen = _Seen(case, found, geometry)
    if not quiet:
        for text in seen.warnings:
            print(f"warning: {text}", file=sys.stderr, flush=True)
    return seen
