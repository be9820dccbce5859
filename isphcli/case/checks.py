"""Checks between the keys of a case. Each reports all problems that it finds and never raises.

A value that could not be read is None and has a problem at its path: a check calls `clear` with the paths
that it uses, and skips values that have a problem already.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from . import expressions, forcing
from .blocks import AXES, FACES, LATTICES, SOLID, Grey, ShapeBlock
from .force_list import wrong_with_forces
from .reader import Key, Table, keys_of, suggest
from .yaml import ProblemList, as_key, shown

if TYPE_CHECKING:
    from .blocks import Case, Drive, Reservoirs

NAMED_ARRAYS = (".npz", ".h5", ".hdf5", ".vti", ".vtk", ".mat")
WITHOUT_SIZE = (".npy", ".png", ".bmp", ".dat")  # images that never tell the size of a voxel
HEADERLESS = {"shape": (".raw", ".bin", ".dat"), "dtype": (".raw", ".bin"), "offset": (".raw", ".bin"),
              "byte_order": (".raw", ".bin")}  # fmt: skip
OF_A_FORCE = ("poiseuille", "startup_poiseuille", "two_layer_poiseuille")  # solutions that a given force makes
FEWEST_STEPS = 10  # steps in which the volume of a block may be restored: a step restores a tenth of its error at most
MAX_SITES = 1e9  # most lattice sites, far more than fit into a memory: with more the lengths must be mistaken


def check_case(case: Case, problems: ProblemList) -> None:
    """Report keys that contradict each other."""
    checks = _Checks(case, problems)
    for check in (
        checks.fluids,
        checks.scene,
        checks.voxels,
        checks.voxel_size,
        checks.periodic,
        checks.walls,
        checks.shapes,
        checks.vectors,
        checks.particles,
        checks.volume,
        checks.interface,
        checks.forces,
        checks.reservoirs,
        checks.drive,
        checks.formulas,
        checks.flow,
        checks.refine,
        checks.measure,
        checks.reference,
        checks.format,
    ):
        check()


def check_dimension(case: Case, dim: int) -> None:
    """Raise CaseError where a case does not fit its image of `dim` dimensions, known only once the image is read."""
    problems = ProblemList()
    checks = _Checks(case, problems, dim)
    checks.periodic()
    checks.voxel_size()
    checks.vectors()
    checks.lattice()
    checks.driven_axes()
    checks.reservoirs()
    checks.formulas()
    checks.forces()
    checks.reference_values()
    problems.raise_if_any()


class _Checks:
    def __init__(self, case: Case, problems: ProblemList, dim: int | None = None):
        self.case = case
        self.problems = problems
        self.clear = problems.clear_of
        self.dim = dim or _dimension_of(case)
        self.axes = AXES[: self.dim or 3]

    def bad(self, path: str, message: str, fix: str = "") -> None:
        """Report a problem at the line of `path` or of the innermost block around it."""
        self.problems.add(self.case.place_of(path), path, message, fix)

    def format(self) -> None:
        """A missing library for the output is reported now, not after hours of a run whose files it has to write."""
        if self.case.output.format == "xdmf" and find_spec("h5py") is None:
            self.bad("output.format", "xdmf needs h5py, which is not installed", "pip install h5py, or take vtk")

    def fluids(self) -> None:
        if self.case.fluids is None:
            return
        if not self.case.fluids:
            self.bad("fluids", "no fluid is declared", "add one: water: {density: 1000, viscosity: 1e-3}")
        for name, fluid in self.case.fluids.items():
            path = f"fluids.{as_key(name)}"
            if not name.replace("_", "").replace("-", "").isalnum() or name == SOLID:
                fix = "use letters, digits, - and _; solid is not a fluid"
                self.bad(path, "not a name for a fluid", fix)
            elif self.clear(path) and not all(0.0 < v < math.inf for v in (fluid.mu, fluid.nu)):
                self.bad(path, "its viscosity and density together leave the range of numbers", "check their units")
        if len(self.case.fluids) > 2:
            self.bad("fluids", f"{len(self.case.fluids)} fluids", "a scene has one or two")

    def scene(self) -> None:
        """Keys that belong to a box make no sense beside an image, and the reverse."""
        if not self.clear("geometry.box", "geometry.voxels"):
            return
        geometry = self.case.geometry
        if geometry.voxels:
            for name in ("origin", "clear_layer", "fluid", "shapes", "walls"):
                if getattr(geometry, name):
                    self.bad(f"geometry.{name}", "belongs to a box, not to voxels", "remove it")
        elif geometry.fluid is not None:
            self._fluid_name(geometry.fluid, "geometry.fluid")
        if geometry.clear_layer is not None and not self.case.drive:
            self.bad("geometry.clear_layer", "there is no axis of flow", "give drive, or remove it")
        refused = "exact" if geometry.voxels else "stairs"
        if geometry.wall_distance == refused:
            what = "voxels have no exact walls" if geometry.voxels else "only voxels have stairs"
            self.bad("geometry.wall_distance", what, f"use {'smooth' if geometry.voxels else 'exact'}")

    def voxels(self) -> None:
        if not self.clear("geometry.voxels") or self.case.geometry.voxels is None:
            return
        voxels, path = self.case.geometry.voxels, "geometry.voxels"
        if voxels.grey is not None:
            self._grey(voxels.grey, f"{path}.grey")
        elif self.clear(f"{path}.labels"):
            for name in voxels.labels:
                if name != SOLID:
                    self._filling_name(name, f"{path}.labels.{as_key(name)}")
            if not set(voxels.labels) - {SOLID}:
                self.bad(f"{path}.labels", "no voxel is fluid", "add the name of a fluid and its value")
            self._labels_differ(voxels.labels, f"{path}.labels")
        suffix = voxels.file.suffix.lower() if voxels.file is not None else ""
        if voxels.array is not None and suffix not in NAMED_ARRAYS:
            self.bad(f"{path}.array", f"only {', '.join(NAMED_ARRAYS)} files hold named arrays", "remove it")
        for name, suffixes in HEADERLESS.items():
            if getattr(voxels, name) is not None and voxels.file is not None and suffix not in suffixes:
                self.bad(f"{path}.{name}", f"is of files without a header ({', '.join(suffixes)})", "remove it")
        for axis, (first, end) in zip(AXES, voxels.crop or ()):
            if first >= end:
                self.bad(f"{path}.crop", f"keeps nothing along {axis}", "each range is [first, end)")
        if voxels.crop and len(voxels.crop) < (self.dim or 0):
            self.bad(f"{path}.crop", f"has {len(voxels.crop)} ranges", f"the image has {self.dim} dimensions")
        size = voxels.voxel_size
        if size is None and suffix in WITHOUT_SIZE:
            self.bad(f"{path}.voxel_size", f"is missing, and a{'n' * (suffix == '.npy')} {suffix[1:]} holds none",
                     "give the edge of a voxel, in m")
        if voxels.crop and isinstance(size, tuple) and len(size) != len(voxels.crop):
            self.bad(f"{path}.crop", f"has {len(voxels.crop)} ranges, voxel_size has {len(size)} numbers")

    def _grey(self, grey: Grey, path: str) -> None:
        if grey.uncertainty is not None and self.clear("flow") and self.case.flow != "stokes":
            self.bad(f"{path}.uncertainty", "is of a steady solve", "remove it, or use flow: stokes")
        before: tuple[float, float] | None = None
        for name, (first, end) in sorted((grey.fluids or {}).items(), key=lambda entry: entry[1]):
            where = f"{path}.fluids.{as_key(name)}"
            self._filling_name(name, where)
            if first >= end:
                self.bad(where, "holds no grey value", "each range is [from, to)")
            elif before is not None and first < before[1]:
                self.bad(where, "shares grey values with another fluid", "let the ranges not overlap")
            before = (first, end)

    def _labels_differ(self, labels: Table[tuple[int, ...]], path: str) -> None:
        owner: dict[int, str] = {}
        for name, values in labels.items():
            for value in values:
                if owner.setdefault(value, name) != name:
                    self.bad(f"{path}.{as_key(name)}", f"value {value} already stands for {owner[value]}")

    def periodic(self) -> None:
        if self.clear("geometry.periodic"):
            self._axes_exist(self.case.geometry.periodic, "geometry.periodic")
        if self.clear("geometry.mirror", "geometry.periodic"):
            self.mirror()

    def mirror(self) -> None:
        scene, path = self.case.geometry, "geometry.mirror"
        if scene.mirror and scene.voxels is None:
            self.bad(path, "mirrors an image, and there is none", "shapes are mirrored by placing them twice")
        elif self._axes_exist(scene.mirror, path):
            for axis in set(scene.mirror) & set(scene.periodic):
                self.bad(path, f"{axis} is periodic too", "name the axis in one of the two")

    def _axes_exist(self, axes: Any, path: str) -> bool:
        missing = [axis for axis in axes if axis not in self.axes]
        voxels = self.case.geometry.voxels if self.case.geometry is not None else None
        image = f"; {voxels.file.name} is an image of two dimensions" if voxels is not None and voxels.file else ""
        for axis in missing:
            self.bad(path, f"a 2D scene has no axis {axis}", f"there are x and y{image}")
        return not missing

    def walls(self) -> None:
        if not self.clear("geometry.walls", "geometry.periodic"):
            return
        for face, wall in self.case.geometry.walls.items():
            path, axis = f"geometry.walls.{face}", face[0]
            if not self._axes_exist(axis, path):
                continue
            if axis in self.case.geometry.periodic:
                self.bad(path, f"{axis} is periodic and has no walls", "remove it, or the axis from periodic")
            normal = AXES.index(axis)
            if wall.velocity and normal < len(wall.velocity) and wall.velocity[normal] != 0:
                self.bad(f"{path}.velocity", f"moves the wall along {axis}", "a wall slides along itself")
            self.of_time(wall.velocity or (), f"{path}.velocity")

    def shapes(self) -> None:
        shapes = self.case.geometry.shapes if self.case.geometry else None
        for i, shape in enumerate(shapes or ()):
            path = f"geometry.shapes.{i}"
            if self.clear(path):
                self._filling(shape, path)
                self._form(shape, path)
                self.of_time(shape.velocity or (), f"{path}.velocity")

    def _filling(self, shape: ShapeBlock, path: str) -> None:
        if shape.what == SOLID:
            return
        self._filling_name(shape.what, f"{path}.is", extra=(SOLID,))
        for name in ("velocity", "angular_velocity", "slip_length"):
            if getattr(shape, name) is not None:
                self.bad(f"{path}.{name}", "only solids have one", "remove it, or write is: solid")

    def _form(self, shape: ShapeBlock, path: str) -> None:
        box, cylinder = shape.box, shape.cylinder
        if box and any(lower >= upper for lower, upper in zip(box.lower, box.upper)):
            self.bad(f"{path}.box", "lower must be below upper along every axis")
        if shape.angular_velocity is not None and not (cylinder or (shape.sphere and self.dim == 2)):
            self.bad(f"{path}.angular_velocity", "only cylinders turn, and disks in 2D", "remove it")
        if shape.spheres and shape.spheres.random and shape.spheres.radius is None:
            self.bad(f"{path}.spheres.radius", "missing", "spheres placed at random need one")
        if shape.half_space and not any(shape.half_space.normal):
            self.bad(f"{path}.half_space.normal", "has no direction", "give a vector that is not zero")
        if not cylinder:
            return
        if self.dim == 2:
            self.bad(f"{path}.cylinder", "a cylinder is 3D", "a sphere in 2D is a disk")
        if cylinder.lower is not None and cylinder.upper is not None and cylinder.lower >= cylinder.upper:
            self.bad(f"{path}.cylinder", "lower must be below upper")

    def vectors(self) -> None:
        """All vectors have as many entries as the scene has dimensions; those of an image agree."""
        wanted = (self.dim,) if self.dim else (2, 3)
        for path, spec, value in _walk(self.case):
            if spec.per_axis and isinstance(value, tuple) and len(value) not in wanted:
                numbers = " or ".join(map(str, wanted))
                self.bad(path, f"has {len(value)} entries", f"the scene has {numbers} dimensions")

    def voxel_size(self) -> None:
        voxels = self.case.geometry.voxels if self.case.geometry is not None else None
        size = voxels.voxel_size if voxels is not None else None
        if self.dim and isinstance(size, tuple) and len(size) != self.dim:
            fix = f"the image has {self.dim} dimensions"
            self.bad("geometry.voxels.voxel_size", f"has {len(size)} entries", fix)

    def particles(self) -> None:
        if not self.dim or not self.clear("particles.spacing", "particles.lattice"):
            return
        self.lattice()
        if self.case.geometry.box is not None:
            self._spacing_fits(self.case.particles.spacing, "particles.spacing")

    def volume(self) -> None:
        path = "particles.keep_volume"
        if self.clear(path) and 0.0 < self.case.particles.keep_volume < FEWEST_STEPS:
            message = f"{self.case.particles.keep_volume:g} steps would throw the particles about"
            self.bad(path, message, f"take 100, at least {FEWEST_STEPS}, or 0 to leave it out")

    def lattice(self) -> None:
        assert self.dim
        lattice, allowed = self.case.particles.lattice, LATTICES[self.dim]
        if lattice and lattice not in allowed:
            message = f"{lattice} is not a lattice in {self.dim}D"
            self.bad("particles.lattice", message, f"use {' or '.join(allowed)}")

    def _spacing_fits(self, spacing: float, path: str) -> None:
        box = self.case.geometry.box
        assert box is not None
        sites = sum(math.log10(edge) - math.log10(spacing) for edge in box)  # the ratio may overflow
        if spacing >= min(box):
            self.bad(path, f"{spacing:g} is not smaller than the box, {min(box):g}", "make it smaller")
        elif sites > math.log10(MAX_SITES):
            self.bad(path, f"the box has about 1e{sites:.0f} sites", "are box and spacing in the same unit?")

    def interface(self) -> None:
        if self.case.interface and self.case.fluids is not None and len(self.case.fluids) != 2:
            self.bad("interface", f"needs two fluids, found {len(self.case.fluids)}")

    def forces(self) -> None:
        if self.clear("fluids", "geometry", "flow", "microporous", "particles.spacing"):
            for problem in wrong_with_forces(self.case, self.dim):
                self.bad(*problem)

    def reservoirs(self) -> None:
        found, path = self.case.reservoirs, "reservoirs"
        if found is None or not self.clear(path, "geometry.periodic", "geometry.mirror", "geometry.voxels"):
            return
        scene = self.case.geometry
        for name in ("inlet", "outlet"):
            self._fluid_name(getattr(found, name), f"{path}.{name}")
        if not self._axes_exist(found.axis, f"{path}.axis"):
            return
        if self.case.flow == "stokes":
            self.bad(path, "has no meaning in flow: stokes, which is steady", "remove it, or use navier_stokes")
        if scene.voxels is not None:
            self._reservoirs_of_image(found)
        elif found.axis not in scene.periodic:
            self.bad(f"{path}.axis", f"{found.axis} ends at walls", f"add {found.axis} to geometry.periodic")
        elif found.length is None:
            self.bad(f"{path}.length", "missing: a box has no clear layers", "give the length of each reservoir, in m")
        elif self.dim and self.clear("particles.spacing"):
            length, spacing = scene.box[AXES.index(found.axis)], self.case.particles.spacing  # type: ignore[index]
            if 2.0 * found.length >= length:
                self.bad(f"{path}.length", "two of them fill the box", "make it smaller")
            elif min(found.length, length - 2.0 * found.length) < spacing:
                what = "it is" if found.length < spacing else "what two of them leave of the box is"
                self.bad(f"{path}.length", f"{what} less than a spacing, {spacing:g}", "make it a few spacings or more")

    def _reservoirs_of_image(self, found: Reservoirs) -> None:
        scene = self.case.geometry
        assert scene.voxels is not None
        if found.length is not None:
            self.bad("reservoirs.length", "an image has its reservoirs in its clear layers",
                     "give geometry.voxels.clear_layer")
        if found.axis in scene.repeats:
            self.bad("reservoirs.axis", f"the image repeats along {found.axis} and has no clear layers there",
                     f"remove {found.axis} from geometry.{'mirror' if found.axis in scene.mirror else 'periodic'}")
        elif scene.voxels.clear_layer == 0:
            self.bad("geometry.voxels.clear_layer", "is 0: no room for reservoirs", "leave it out, or give a thickness")

    def drive(self) -> None:
        drive = self.case.drive
        if drive is None or not self.clear("drive"):
            return
        pushed = drive.body_force or drive.pressure_drop or drive.superficial_velocity
        if drive.axes is not None and pushed:
            self.bad("drive.axes", "makes its own flow along each axis", "remove the rest of drive")
        if not (drive.axes or pushed or drive.steps):
            self.bad("drive", "drives nothing", "give body_force, pressure_drop, superficial_velocity, steps or axes")
        if drive.axes and self.clear("flow") and self.case.flow != "stokes":
            self.bad("drive.axes", "needs flow: stokes", "use body_force, pressure_drop or superficial_velocity")
        if drive.superficial_velocity is not None:
            self.held_rate(drive)
        if drive.steps is not None:
            self.drive_steps(drive)
        self.driven_axes()
        if self.case.reservoirs is not None and self.clear("reservoirs"):
            for name in ("pressure_drop", "superficial_velocity"):
                if set(getattr(drive, name) or ()) - {self.case.reservoirs.axis}:
                    self.bad(f"drive.{name}", "drives across the axis of the reservoirs",
                             f"name {self.case.reservoirs.axis}, or another reservoirs.axis")
        self.of_time(drive.body_force or (), "drive.body_force")
        for name, drop in (drive.pressure_drop or {}).items():
            self.of_time((drop,), f"drive.pressure_drop.{name}", listed=False)

    def of_time(self, items: Any, path: str, listed: bool = True) -> None:
        """Formulas of the time need a flow in time with an end, up to which they have finite values."""
        for i, formula in enumerate(items):
            if not isinstance(formula, str) or not self.clear("flow", "time"):
                continue
            place, case = f"{path}.{i}" if listed else path, self.case
            if case.flow == "stokes":
                self.bad(place, "changes with time, and flow: stokes is steady", "give a number, or use navier_stokes")
            elif case.time is None or case.time.end is None:
                self.bad(place, "changes with time, up to an end that is not given", "give time.end")
            else:
                try:
                    expressions.evaluate(formula, t=forcing.sample_times(case))
                except expressions.ExpressionError as error:
                    self.bad(place, str(error))

    def held_rate(self, drive: Any) -> None:
        path = "drive.superficial_velocity"
        if len(drive.superficial_velocity) != 1:
            self.bad(path, "needs one axis", "name the axis of the flow alone")
        for axis, value in drive.superficial_velocity.items():
            if value == 0:
                self.bad(f"{path}.{axis}", "is zero and drives nothing", "give another number, or remove it")
        if drive.pressure_drop is not None:
            self.bad(path, "finds its own pressure drop", "remove drive.pressure_drop")
        if self.clear("flow") and self.case.flow == "stokes":
            self.bad(path, "needs flow: navier_stokes", "use pressure_drop: the permeability of a steady creeping flow "
                     "does not depend on it")

    def drive_steps(self, drive: Drive) -> None:
        path, steps = "drive.steps", drive.steps
        assert steps is not None
        if self.case.reservoirs is None and self.clear("reservoirs"):
            self.bad(path, "are between reservoirs, and there are none", "add reservoirs: {axis, inlet, outlet}")
        if drive.pressure_drop or drive.superficial_velocity or drive.axes:
            fix = "remove pressure_drop, superficial_velocity and axes"
            self.bad(path, "are all of the drive along their axis", fix)
        if not (steps.pressure_drop or steps.superficial_velocity):
            self.bad(path, "have no step", "give at least one pressure or velocity")
        if steps.window is not None and steps.window > steps.duration:
            self.bad(f"{path}.window", "is longer than a step", "make it a small part of the duration")
        if self.clear("time") and self.case.time is not None and self.case.time.steady is not None:
            self.bad("time.steady", "is of one flow, and the drive has steps", "give drive.steps.settled")

    def driven_axes(self) -> None:
        for name in ("pressure_drop", "superficial_velocity", "axes"):
            axes = getattr(self.case.drive, name, None) or ()
            if self._axes_exist(axes, f"drive.{name}"):
                self._driven_axes_open(axes, f"drive.{name}")

    def _driven_axes_open(self, axes: Any, path: str) -> None:
        """In a box a flow from face to face needs a periodic axis; an image gets clear layers instead."""
        if not self.dim or not self.clear("geometry.periodic") or self.case.geometry.box is None:
            return
        for axis in axes if self.case.geometry.clear_layer is None else ():
            if axis not in self.case.geometry.periodic:
                fix = f"add {axis} to geometry.periodic, or give geometry.clear_layer"
                self.bad(path, f"{axis} ends at walls", fix)

    def formulas(self) -> None:
        if not self.case.initial or not self.clear("initial") or not self.dim:
            return
        self.flood()
        for i, formula in enumerate(self.case.initial.velocity or ()):
            try:
                expressions.check(formula, self.axes)
            except expressions.ExpressionError as error:
                self.bad(f"initial.velocity.{i}", str(error))

    def flood(self) -> None:
        flood, path = self.case.initial.flood, "initial.flood"  # type: ignore[union-attr]
        if flood is not None:
            self._fluid_name(flood.fluid, f"{path}.fluid")
            self._axes_exist(flood.face[0], f"{path}.from")

    def flow(self) -> None:
        if not self.clear("flow", "time"):
            return
        case = self.case
        if case.flow == "stokes":
            for name in ("time", "initial", "interface"):
                if getattr(case, name) is not None:
                    self.bad(name, "has no meaning in flow: stokes, which is steady", "remove it")
        elif case.time is None or not (case.time.end or case.time.steady or forcing.drive_steps(case)):
            self.bad("time", "the run would not end", "give time.end or time.steady")
        elif case.time.step and case.time.end and case.time.step > case.time.end:
            message = f"{case.time.step:g} is longer than the run, {case.time.end:g}"
            self.bad("time.step", message, "make it a small part of time.end")

    def refine(self) -> None:
        if not self.case.refine or not self.clear("refine", "particles.spacing", "flow"):
            return
        if self.case.flow != "stokes":
            self.bad("refine", "needs flow: stokes", "remove it")
        if self.case.refine == "throats":
            for wrong in self._wrong_in_throats():
                self.bad("refine", f"throats knows no {wrong}", "take auto or a list of spacings")
        further = self.case.spacings[1:]
        if self.case.particles.spacing in further:
            self.bad("refine", "repeats particles.spacing", "list the further spacings only")
        for i, spacing in enumerate(further):
            if self.dim and self.case.geometry.box is not None:
                self._spacing_fits(spacing, f"refine.{i}")

    def _wrong_in_throats(self) -> Iterator[str]:
        """Features of a case that particles of two spacings do not support (`operators/mixed_weights.py`)."""
        case = self.case
        if case.particles.lattice not in (None, "cubic", "square"):
            yield f"lattice {case.particles.lattice}"
        if case.particles.jitter:
            yield "jitter"
        if forcing.walls_move(case):
            yield "walls that move"
        if case.microporous or case.geometry.depth:
            yield "resistance beside the viscosity (microporous, geometry.depth)"

    def measure(self) -> None:
        if not self.case.measure or not self.clear("measure", "flow", "drive"):
            return
        if self.case.flow != "stokes":
            self.bad("measure", "needs flow: stokes", "remove it")

    def reference(self) -> None:
        reference = self.case.reference
        if reference is None or not self.clear("reference"):
            return
        if reference.kind == "permeability" and reference.value is None:
            self.bad("reference", "kind permeability needs a value", "give value, in m2")
        elif reference.kind == "permeability" and not isinstance(reference.value, tuple) and reference.axes is None:
            self.bad("reference.axes", "is missing, and one value does not say of which axes it is",
                     "give the axes along which it holds, such as [x]")
        self.reference_values()
        self.reference_names()
        for name in ("axes", "crop", "voxel_size"):
            if getattr(reference, name) is not None and reference.kind != "permeability":
                self.bad(f"reference.{name}", "is of kind permeability", "remove it")
        if reference.kind in OF_A_FORCE and self.case.drive and self.case.drive.superficial_velocity:
            self.bad("reference.kind", f"{reference.kind} is the flow under a given force", "give drive.pressure_drop")
        elif reference.kind in OF_A_FORCE and self.clear("drive") and not forcing.force_is_given(self.case):
            self.bad("reference.kind", f"{reference.kind} is the flow under a constant force", "give numbers in drive")
        self.reference_parameters()

    def reference_parameters(self) -> None:
        """Names and values of the parameters of a reference: a run would find mistakes in them at its end only."""
        from ..references.parameters import OF_TWO_FLUIDS, PARAMETERS, needed, words

        reference, path = self.case.reference, "reference.parameters"
        assert reference is not None
        fluids, kind = tuple(self.case.fluids or ()), reference.kind
        if kind in OF_TWO_FLUIDS and self.clear("fluids") and len(fluids) < 2:
            self.bad("reference.kind", f"{kind} is of two fluids, and the case has one", "take another, or add a fluid")
        for name in needed(kind):
            if name not in reference.parameters:
                self.bad(path, f"kind {kind} needs {name}", f"add parameters: {{{name}: ...}}")
        for name, value in reference.parameters.items():
            place, known = f"{path}.{as_key(name)}", words(kind, name, fluids, FACES)
            if name not in PARAMETERS[kind]:
                fix = suggest(name, PARAMETERS[kind]) if PARAMETERS[kind] else "it knows none"
                self.bad(place, f"kind {kind} does not know it", fix)
            elif known is None and isinstance(value, str):
                self.bad(place, f"expected a number, found {shown(value)}", PARAMETERS[kind][name])
            elif known is not None and value not in known:
                self.bad(place, f"{shown(str(value))} is not a choice", suggest(str(value), known))

    def reference_values(self) -> None:
        """A permeability has one value or one per axis, and its sample one range and one edge of a voxel per axis."""
        reference = self.case.reference
        if reference is None or reference.kind != "permeability" or not self.clear("reference", "geometry.box"):
            return
        values = reference.value if isinstance(reference.value, tuple) else (reference.value,)
        if any(value is not None and value <= 0.0 for value in values):
            self.bad("reference.value", "a permeability is above 0", "give it in m2")
        wanted = (self.dim,) if self.dim else (2, 3)
        for name, what in (("value", "numbers"), ("crop", "ranges"), ("voxel_size", "numbers")):
            given = getattr(reference, name)
            if isinstance(given, tuple) and len(given) not in wanted:
                axes = " or ".join(map(str, wanted))
                self.bad(f"reference.{name}", f"has {len(given)} {what}, and the scene has {axes} axes",
                         "give one an axis" + (", or one number and reference.axes" if name == "value" else ""))

    def reference_names(self) -> None:
        """Names in `reference.geometry` exist in this case: a misspelled one would be that of another geometry."""
        reference, path = self.case.reference, "reference.geometry"
        if reference is None or not self.clear("fluids", "microporous"):
            return
        part, voxels = reference.geometry, reference.geometry.get("voxels") or {}
        for name in voxels.get("labels") or ():
            if name != SOLID:
                self._filling_name(name, f"{path}.voxels.labels.{as_key(name)}", extra=(SOLID,))
        for name in (voxels.get("grey") or {}).get("fluids") or ():
            self._filling_name(name, f"{path}.voxels.grey.fluids.{as_key(name)}")
        if part.get("fluid"):
            self._fluid_name(part["fluid"], f"{path}.fluid")
        for i, shape in enumerate(part.get("shapes") or ()):
            if shape is not None and shape.what != SOLID:
                self._filling_name(shape.what, f"{path}.shapes.{i}.is", extra=(SOLID,))

    def _filling_name(self, name: str, path: str, extra: tuple[str, ...] = ()) -> None:
        """A fluid, or microporous rock."""
        if name not in (self.case.microporous or ()):
            self._fluid_name(name, path, (*extra, *(self.case.microporous or ())))

    def _fluid_name(self, name: str, path: str, extra: tuple[str, ...] = ()) -> None:
        if self.case.fluids is not None and name not in self.case.fluids:
            fix = suggest(name, (*extra, *self.case.fluids))
            self.bad(path, f"{shown(name)} is not a fluid of this case", fix)


def _dimension_of(case: Case) -> int | None:
    """Dimension of the box, or of the image by its header alone; None where it is unknown."""
    scene = case.geometry
    if scene is None or scene.box is not None or scene.voxels is None or scene.voxels.file is None:
        return None if scene is None else case.dim
    voxels = scene.voxels
    from ..geometry.images.image import Layout
    from ..geometry.images.read import image_shape

    layout = Layout(voxels.array, voxels.axes, voxels.shape, voxels.dtype, voxels.offset, voxels.byte_order)
    shape = image_shape(voxels.file, layout=layout)
    if shape is None or len(shape) == 2:
        return None if shape is None else 2
    first, end = voxels.crop[-1] if voxels.crop and len(voxels.crop) == 3 else (0, shape[0])
    return 2 if end - first == 1 else 3  # of one layer the scene is of two dimensions


def _walk(block: Any, path: str = "") -> Iterator[tuple[str, Key, Any]]:
    """Dotted path, declaration and value of every key below a block."""
    cls: Any = type(block)
    for declared in keys_of(cls).values():
        value = getattr(block, declared.attribute)
        child_path = f"{path}.{declared.name}" if path else declared.name
        yield child_path, declared.spec, value
        for name, item in _items(value):
            if is_dataclass(item):
                yield from _walk(item, f"{child_path}.{name}" if name else child_path)


def _items(value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Table):
        yield from ((as_key(name), item) for name, item in value.items())
    elif isinstance(value, tuple):
        yield from ((str(i), item) for i, item in enumerate(value))
    else:
        yield "", value
