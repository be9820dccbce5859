# ruff: noqa: RUF009  (a dataclass default that is a call is what `key` is for; it makes a `field`)
"""The case language: one frozen dataclass per block, with its keys, their defaults, bounds and documentation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from .reader import Table, key, keys_of
from .yaml import Where

Vector = tuple[float, ...]
Timed = float | str  # a number, or a formula of the time t, s
TimedVector = tuple[Timed, ...]
AXES = ("x", "y", "z")
FACES = tuple(f"{axis}_{end}" for axis in AXES for end in ("min", "max"))
SOLID = "solid"
ORDERS = ("zyx", "xyz", "zxy", "yxz", "yzx", "xzy")  # of the axes of an image
DTYPES = ("uint8", "uint16", "uint32", "uint64", "int8", "int16", "int32", "int64", "float32", "float64")
LATTICES = {2: ("square", "hexagonal"), 3: ("cubic", "bcc")}  # by dimension, the default first
FLOWS = ("navier_stokes", "stokes")
SUPPORT, SUPPORT_MOVING_2D = 2.1, 2.3  # defaults, measured: benchmarks/support.py
SUPPORT_TENSION_2D = 2.8  # with 2.3 the curvature of a disk is 1 % too small (docs/method.md 12)
WALL_DISTANCES = ("exact", "smooth", "stairs")
KERNELS = ("wendland_c2", "wendland_c4", "quintic_spline")
FIELDS = ("velocity", "pressure", "phase", "distance", "divergence")
MEASURES = ("formation_factor",)
REFERENCE_KINDS = (
    "slit",
    "couette",
    "poiseuille",
    "startup_couette",
    "startup_poiseuille",
    "oscillating_slit",
    "oscillating_pipe",
    "decaying_channel",
    "taylor_couette",
    "annulus",
    "two_layer_couette",
    "two_layer_poiseuille",
    "two_layer_hydrostatics",
    "square_duct",
    "sphere_array",
    "cylinder_array",
    "taylor_green",
    "taylor_green_3d",
    "lid_driven_cavity",
    "static_drop",
    "oscillating_drop",
    "imbibition",
    "capillary_wave",
    "rising_bubble",
    "contact_angle",
    "permeability",
    "flow_split",
)


@dataclass(frozen=True, kw_only=True)
class Grey:
    """A grey image as it was scanned: the wall is the surface on which it has the value of the threshold."""

    threshold: float | str = key(
        "grey value of the wall, or otsu: the value that parts the histogram into the two classes that differ most "
        "(Otsu 1979), in an image that is the scan of a body (`blur`) that half-way between its fluid and its solid; "
        "the run says which it took",
        choices=("otsu",),
    )
    solid: str = key("which side of the threshold is solid: above (bright) or below", choices=("above", "below"))
    uncertainty: float | None = key(
        "how uncertain the threshold is, in grey values: a steady run also solves with the threshold this much lower "
        "and higher, at the spacing of the case, and says what that does to k. Without it: nothing is said of it",
        default=None,
        above=0,
    )
    fluids: Table[tuple[float, float]] = key(
        "for each fluid, the grey values [from, to) of its voxels, where there are two. Without it: all pores hold the "
        "first fluid",
        default=Table(),
    )
    blur: float | str | None = key(
        "width of the scanner's blur (standard deviation of a Gaussian) that is taken out of the image, with the "
        "average over a voxel, in voxels, or auto: that of the body whose own scan is nearest to the image, for images "
        "of two grey values. 0: nothing is taken out, of a field whose zero is the wall, such as a signed distance. "
        "Without it: auto of an image of two grey values that is the scan of a body, else 0; the run says which",
        default=None,
        at_least=0,
        at_most=2,
        choices=("auto",),
    )
    denoise: float = key(
        "width of a Gaussian that the image is averaged with against noise, in voxels; of an image that is the scan of "
        "a body it is taken out again with the blur of the scanner, of others it opens throats as a blur does",
        default=0.0,
        at_least=0,
        at_most=2,
    )


@dataclass(frozen=True, kw_only=True)
class Voxels:
    """An image: segmented, or grey."""

    ONE_OF: ClassVar = ("labels", "grey")

    file: Path = key(
        "image: TIFF, raw, NRRD, HDF5, VTI, VTK, PNG, BMP, MetaImage, npy, npz, Palabos .dat, MATLAB .mat, or a "
        "folder of TIFF, PNG or BMP slices (docs/formats.md)",
        input=True,
        folder=True,
    )
    labels: Table[tuple[int, ...]] = key(
        "for `solid`, each fluid and each microporous rock in the image, the voxel value or values that stand for it",
        default=Table(),
        single=True,
        unique=True,
        at_least=0,
    )
    grey: Grey | None = key("how a grey image, which nobody has segmented, is understood", default=None)
    voxel_size: float | Vector | None = key(
        "edge of a voxel: one number, or one per axis (x, y, z). Without it: that of the file; where "
        "that has no unit it is taken as metres",
        default=None,
        unit="m",
        above=0,
        lengths=(2, 3),
    )
    array: str | None = key(
        "name of the array in a file that holds several (npz, HDF5, VTI, VTK, MATLAB)", default=None
    )
    axes: str | None = key(
        "directions of the axes of the array, the last one varies fastest. Without it: zyx; yxz of MATLAB files (rows, "
        "columns, slices), xyz of Palabos .dat files",
        default=None,
        choices=ORDERS,
    )
    shape: tuple[int, ...] | None = key(
        "voxels along x, y, z of a file without a header (raw, dat). Without it: as its name or a header beside it "
        "says",
        default=None,
        at_least=1,
        lengths=(2, 3),
    )
    dtype: str | None = key(
        "type of the numbers of a raw file. Without it: as its name or a header beside it says, or one or two unsigned "
        "bytes where its size fits",
        default=None,
        choices=DTYPES,
    )
    offset: int | None = key("bytes before the first voxel of a raw file. Without it: none", default=None, at_least=0)
    byte_order: str | None = key(
        "byte order of the numbers of a raw file. Without it: little", default=None, choices=("little", "big")
    )
    clear_layer: float | None = key(
        "thickness of the layer of clear fluid added at each end of the axis of flow, where the image is "
        "neither periodic nor mirrored along it. Without it: as thick as changes the permeability by less than 1 %, by "
        "an estimate of how the flow spreads between the pores of the two faces (docs/method.md 5)",
        default=None,
        unit="m",
        at_least=0,
    )
    crop: tuple[tuple[int, int], ...] | None = key(
        "voxel ranges [first, end) along x, y, z that are kept, before anything else",
        default=None,
        at_least=0,
        lengths=(2, 3),
    )


@dataclass(frozen=True, kw_only=True)
class SphereBlock:
    """A sphere; a disk in 2D."""

    centre: Vector = key("centre of the sphere", unit="m", per_axis=True)
    radius: float = key("radius of the sphere", unit="m", above=0)


@dataclass(frozen=True, kw_only=True)
class SpheresBlock:
    """Spheres listed in a file, or placed at random without overlap, outside the solids before them."""

    ONE_OF: ClassVar = ("file", "random")

    file: Path | None = key(
        "table of the spheres, parted by commas, semicolons, tabs or blanks, or a LAMMPS or LIGGGHTS dump (its last "
        "step). A header names columns in any order, radius or diameter among them, and perhaps the unit of the "
        "lengths, as in x_mm or radius [um]; without one they are x, y, z and perhaps the radius, in m",
        default=None,
        input=True,
    )
    scale: float | None = key(
        "length of 1 in the file, such as 1 mm, where no header names a unit. Without it: 1 m",
        default=None,
        unit="m",
        above=0,
    )
    random: int | None = key(
        "number of spheres placed at random (more: from a file)", default=None, at_least=1, at_most=10_000
    )
    radius: float | None = key(
        "radius of all spheres; not needed where the file has a column for it", default=None, unit="m", above=0
    )
    clearance: float = key(
        "least distance between spheres placed at random, and of them from solids", default=0.0, unit="m", at_least=0
    )
    seed: int = key("seed of the random places", default=0, at_least=0)


@dataclass(frozen=True, kw_only=True)
class BoxBlock:
    """A box along the axes."""

    lower: Vector = key("lower corner", unit="m", per_axis=True)
    upper: Vector = key("upper corner", unit="m", per_axis=True)


@dataclass(frozen=True, kw_only=True)
class CylinderBlock:
    """A circular cylinder along an axis, infinite unless ends are given; 3D only."""

    axis: str = key("direction of the cylinder", choices=AXES)
    radius: float = key("radius of the cylinder", unit="m", above=0)
    centre: Vector | None = key(
        "a point of its axis. Without it: the middle of the box", default=None, unit="m", per_axis=True
    )
    lower: float | None = key("coordinate of the lower end along the axis", default=None, unit="m")
    upper: float | None = key("coordinate of the upper end along the axis", default=None, unit="m")


@dataclass(frozen=True, kw_only=True)
class HalfSpaceBlock:
    """The side of a plane that its normal points away from: (x - point) . normal < 0."""

    point: Vector = key("a point of the plane", unit="m", per_axis=True)
    normal: Vector = key("normal of the plane, of any length, pointing out of the shape", per_axis=True)


@dataclass(frozen=True, kw_only=True)
class ShapeBlock:
    """A region of space and what fills it."""

    ONE_OF: ClassVar = ("sphere", "spheres", "box", "cylinder", "half_space")

    sphere: SphereBlock | None = key("a sphere, in 2D a disk", default=None)
    spheres: SpheresBlock | None = key("many spheres, from a file or at random", default=None)
    box: BoxBlock | None = key("a box along the axes", default=None)
    cylinder: CylinderBlock | None = key("a circular cylinder", default=None)
    half_space: HalfSpaceBlock | None = key("one side of a plane", default=None)
    outside: bool = key("the region is the outside of the shape", default=False)
    what: str = key("what fills the region: `solid`, or the name of a fluid or of microporous rock", name="is")
    velocity: TimedVector | None = key(
        "velocity of the wall, if solid; an entry may be a formula of t, as in drive. Without it: at rest",
        default=None,
        unit="m/s",
        per_axis=True,
        formula=("t",),
    )
    angular_velocity: float | None = key(
        "turning of the wall, if solid: of a cylinder about its axis, of a disk (2D) about its centre, "
        "counterclockwise. Without it: none",
        default=None,
        unit="rad/s",
    )
    slip_length: float | None = key(
        "Navier slip length of the wall, if solid. Without it: that of the geometry",
        default=None,
        unit="m",
        at_least=0,
    )


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A face of the box."""

    velocity: TimedVector | None = key(
        "velocity of the wall, along itself; an entry may be a formula of t, as in drive. Without it: at rest",
        default=None,
        unit="m/s",
        per_axis=True,
        formula=("t",),
    )
    slip_length: float | None = key(
        "Navier slip length. Without it: that of the geometry", default=None, unit="m", at_least=0
    )


@dataclass(frozen=True, kw_only=True)
class GeometryBlock:
    """Where there is fluid and where there is solid: an image, or a box with shapes."""

    ONE_OF: ClassVar = ("voxels", "box")

    voxels: Voxels | None = key("an image, segmented or grey", default=None)
    box: Vector | None = key(
        "edges of the box; two numbers make the scene 2D", default=None, unit="m", above=0, lengths=(2, 3)
    )
    origin: Vector | None = key(
        "lower corner of the box. Without it: zeros", default=None, unit="m", per_axis=True
    )
    clear_layer: float | None = key(
        "thickness of the layer of clear fluid added at each end of the axis of flow of a box that does not repeat "
        "along it, such as a pack of spheres; the permeability is that of the pack without the layers. Spheres of a "
        "file whose centre lies beyond the ends are left out. Without it: none",
        default=None,
        unit="m",
        above=0,
    )
    depth: float | None = key(
        "distance of the two plates between which a 2D scene lies, as in an etched micromodel: velocities are means "
        "over it, and the plates resist by 12 nu / depth2. Without it: none",
        default=None,
        unit="m",
        above=0,
    )
    fluid: str | None = key("what fills the box before the shapes. Without it: the first fluid", default=None)
    shapes: tuple[ShapeBlock, ...] = key("regions of the box, later ones on top of earlier ones", default=())
    periodic: tuple[str, ...] = key(
        "axes along which the scene repeats; along the others the faces are walls (image: sealed sides)",
        default=(),
        choices=AXES,
        unique=True,
    )
    mirror: tuple[str, ...] = key(
        "axes along which an image is followed by its mirror image, and the two together repeat: its faces then fit "
        "each other, without clear layers or sealed sides, for twice the particles per axis",
        default=(),
        choices=AXES,
        unique=True,
    )
    walls: Table[Wall] = key(
        "faces of the box that move or slip: x_min, x_max, y_min, y_max, z_min, z_max",
        default=Table(),
        names=FACES,
    )
    wall_distance: str | None = key(
        "where the walls are: exact (shapes), smooth (an image: the surface on which the interpolated grey values have "
        "that of the threshold, or the averaged labels the value between fluid and solid) or stairs (an image: the "
        "faces of its solid voxels). Without it: exact for shapes, smooth for an image",
        default=None,
        choices=WALL_DISTANCES,
    )
    slip_length: float = key(
        "Navier slip length of all walls that do not state their own", default=0.0, unit="m", at_least=0
    )

    @property
    def repeats(self) -> tuple[str, ...]:
        """Axes along which the scene has no faces: periodic, or mirrored."""
        return (*self.periodic, *self.mirror)


@dataclass(frozen=True, kw_only=True)
class ParticlesBlock:
    """The particles: how many, how arranged, how many neighbours they see."""

    spacing: float = key(
        "lattice constant; bcc has two particles a cube of this edge; hexagonal: distance of neighbours",
        unit="m",
        above=0,
    )
    lattice: str | None = key(
        f"arrangement: {' or '.join(LATTICES[2])} in 2D, {' or '.join(LATTICES[3])} in 3D. "
        "Without it: the first of each",
        default=None,
        choices=LATTICES[2] + LATTICES[3],
    )
    support: float | None = key(
        "support radius of the kernel over the spacing. Without it: "
        + f"{SUPPORT}, and for moving particles in a 2D box {SUPPORT_MOVING_2D}, with tension {SUPPORT_TENSION_2D}",
        default=None,
        at_least=1.5,
        at_most=6,
    )
    kernel: str = key("smoothing kernel", default=KERNELS[0], choices=KERNELS)
    offset: Vector | None = key(
        "shift of the lattice, in spacings. Without it: chosen by the geometry", default=None, per_axis=True
    )
    jitter: float = key(
        "random displacement of the particles, over the spacing (0.2: 20 %)",
        default=0.0,
        at_least=0,
        at_most=0.5,
    )
    seed: int = key("seed of the random displacement", default=0, at_least=0)
    shifting: float = key(
        "coefficient C of the particle shifting (Xu et al. 2009); 0 switches it off", default=0.3, at_least=0
    )
    keep_volume: float = key(
        "steps in which blocks of six spacings that have gained or lost particles return to the number that fits in, "
        "for long runs through pores (100 suits; moving particles; smooth flow is the worse for it); 0 leaves it out",
        default=0.0,
        at_least=0,
    )


@dataclass(frozen=True, kw_only=True)
class Fluid:
    """A Newtonian fluid."""

    ONE_OF: ClassVar = ("viscosity", "kinematic_viscosity")

    density: float = key("density", unit="kg/m3", above=0)
    viscosity: float | None = key("dynamic viscosity", default=None, unit="Pa s", above=0)
    kinematic_viscosity: float | None = key("kinematic viscosity", default=None, unit="m2/s", above=0)

    @property
    def mu(self) -> float:
        """Dynamic viscosity, Pa s."""
        if self.viscosity is not None:
            return self.viscosity
        assert self.kinematic_viscosity is not None
        return self.kinematic_viscosity * self.density

    @property
    def nu(self) -> float:
        """Kinematic viscosity, m2/s."""
        if self.kinematic_viscosity is not None:
            return self.kinematic_viscosity
        return self.mu / self.density


@dataclass(frozen=True, kw_only=True)
class Microporous:
    """Rock whose pores are too small to be resolved: fluid seeps through it, held back by Brinkman's drag."""

    permeability: float = key("permeability of the rock itself", unit="m2", above=0)


@dataclass(frozen=True, kw_only=True)
class InterfaceBlock:
    """Surface tension between two fluids."""

    tension: float = key("surface tension", unit="N/m", above=0)
    contact_angle: float = key(
        "at walls, measured through the first fluid", default=90.0, unit="degrees", at_least=0, at_most=180
    )
    slip_length: float = key(
        "Navier slip length of the walls that both fluids are within a support of, where it is more than their own",
        default=0.0,
        unit="m",
        at_least=0,
    )
    method: str = key(
        "a sharp jump of pressure, or a continuous force in a band (csf)",
        default="jump",
        choices=("jump", "csf"),
    )


@dataclass(frozen=True, kw_only=True)
class Reservoirs:
    """Two reservoirs, of one fluid each: the fluid of the inlet is injected at one end of a scene, and fluid leaves at
    the other end.

    They are the clear layers of an image, or the two ends of a box that is periodic along the axis. Fluid that leaves
    one end of the box comes in at the other as the fluid of the reservoir there.
    """

    axis: str = key("axis from the inlet, at its lower end, to the outlet, at its upper end", choices=AXES)
    inlet: str = key(
        "fluid in the reservoir at the lower end: a positive `drive` along the axis injects it (imbibition if it wets "
        "the rock, else drainage)"
    )
    outlet: str = key("fluid in the reservoir at the upper end: a negative `drive` brings it back")
    length: float | None = key(
        "length of each reservoir along the axis (box). An image has them in its clear layers", default=None, unit="m",
        above=0,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class DriveSteps:
    """A drive between reservoirs in steps, up or down; the run ends with the last one and leaves curve.csv."""

    ONE_OF: ClassVar = ("pressure_drop", "superficial_velocity")

    pressure_drop: Vector | None = key(
        "of each step, the pressure of the inlet less that of the outlet; a negative one brings the other fluid back",
        default=None,
        unit="Pa",
    )
    superficial_velocity: Vector | None = key(
        "of each step, the flux that is held, as in `drive.superficial_velocity`", default=None, unit="m/s"
    )
    duration: float = key("longest time of a step", unit="s", above=0)
    settled: float | None = key(
        "a step is done before its duration when the saturation of the sample has changed by less than this over "
        "`window`. Without it: every step takes the duration",
        default=None,
        above=0,
        below=1,
    )
    window: float | None = key(
        "time over which the saturation is compared, and pressures are averaged. Without it: a tenth of the duration",
        default=None,
        unit="s",
        above=0,
    )


@dataclass(frozen=True, kw_only=True)
class Drive:
    """What drives the flow."""

    body_force: TimedVector | None = key(
        "acceleration of the fluid, such as gravity: [0, 0, -9.81]. An entry may be a formula of the time t in s "
        '(navier_stokes), such as "0.5*cos(2*pi*50*t)"; angles are in radians, constants pi and e; it needs time.end',
        default=None,
        unit="m/s2",
        per_axis=True,
        formula=("t",),
    )
    pressure_drop: Table[Timed] | None = key(
        "axis: drop over the box along it; the same as a body force of drop / (density length). It may be a formula of "
        "t, as in body_force",
        default=None,
        unit="Pa",
        names=AXES,
        formula=("t",),
    )
    superficial_velocity: Table[float] | None = key(
        "axis: flux through a cross section of the box, solids included, that is held by a pressure drop that follows "
        "(navier_stokes); of an image with clear layers, that of the layers; the history tells the drop",
        default=None,
        unit="m/s",
        names=AXES,
    )
    axes: tuple[str, ...] | None = key(
        "permeability along these axes, one solve each from shared matrices (stokes); all axes of a "
        "periodic scene give the tensor",
        default=None,
        choices=AXES,
        unique=True,
    )

    steps: DriveSteps | None = key("a drive in steps, between `reservoirs`", default=None)

    @property
    def named_axes(self) -> tuple[str, ...]:
        """Axes of a flow whose force the run chooses; none where the block gives a force."""
        return self.axes or tuple(self.superficial_velocity or ())


@dataclass(frozen=True, kw_only=True)
class Flood:
    """A fluid that has come in from one face of the scene."""

    fluid: str = key("name of the fluid")
    face: str = key("face that it comes from", name="from", choices=FACES)
    saturation: float = key(
        "its share of all fluid (image: without the clear layers), reached by whole layers of particles",
        above=0,
        at_most=1,
    )


@dataclass(frozen=True, kw_only=True)
class Initial:
    """The state at time zero."""

    flood: Flood | None = key("turns the fluid next to one face into another", default=None)
    velocity: tuple[str, ...] | None = key(
        'one formula of x, y, z an axis, such as "sin(2*pi*x)*cos(2*pi*y)". Without it: at rest',
        default=None,
        unit="m/s",
        per_axis=True,
        formula=("x", "y", "z"),
    )


@dataclass(frozen=True, kw_only=True)
class Time:
    """Duration and steps of a run; needs `end` or `steady`, and the run stops at the first of them."""

    end: float | None = key("time at which the run ends", default=None, unit="s", above=0)
    steady: float | None = key(
        "estimated distance from the steady value, relative, noise of the particles included, at which the run ends: "
        "of the superficial velocity along the drive; of the pressure drop where a velocity is held; without both of "
        "the root mean square speed (docs/method.md 6)",
        default=None,
        above=0,
        below=1,
    )
    cfl: float = key(
        "distance over the spacing that a particle may move in a step", default=0.2, above=0, at_most=1
    )
    capillary: float = key(
        "largest step over sqrt(rho dx^3 / (2 pi sigma)), rho the mean density (Brackbill, Kothe and Zemach 1992)",
        default=1.0,
        above=0,
    )
    step: float | None = key(
        "fixed time step. Without it: as large as the limits allow", default=None, unit="s", above=0
    )
    max_steps: int = key("steps after which the run ends in any case", default=1_000_000, at_least=1)
    scheme: str = key(
        "time integration: second order (bdf2) or first order, very stable (euler)",
        default="bdf2",
        choices=("bdf2", "euler"),
    )


@dataclass(frozen=True, kw_only=True)
class Solver:
    """The linear solvers."""

    tolerance: float = key("residual over the right-hand side", default=1e-6, above=0, below=1)
    restart: int = key("Krylov vectors kept before GMRES restarts", default=100, at_least=1)
    max_iterations: int = key("iterations after which a solve has failed", default=400, at_least=1)
    engine: str = key(
        "what solves the linear systems: petsc (docs/clusters.md), or auto: PyAMG in one process, PETSc where "
        "mpiexec started several", default="auto", choices=("auto", "petsc")
    )


@dataclass(frozen=True, kw_only=True)
class Output:
    """The files that a run writes."""

    directory: Path | None = key(
        "where results go, from the working directory. Without it: out/<name of the case file>", default=None
    )
    every: float | None = key(
        "time between snapshots. Without it: the first and the last state", default=None, unit="s", above=0
    )
    fields: tuple[str, ...] = key(
        "fields in the snapshots", default=("velocity", "pressure", "phase"), choices=FIELDS, unique=True
    )
    format: str = key(
        "of the snapshots, those on a grid too: vtk (VTU and VTI with .pvd) or xdmf (HDF5 with .xdmf; it needs h5py)",
        default="vtk",
        choices=("vtk", "xdmf"),
    )
    dummies: bool = key("write the particles in the solids too", default=False)
    snapshots: bool = key("write snapshots", default=True)
    grid: float | str | None = key(
        "snapshots on a grid too (VTI, of velocity, pressure, phase and what is solid), for streamlines and to set "
        "beside the image: its spacing, or auto: the voxels of an image, else the spacing of the particles. Without "
        "it: none",
        default=None,
        unit="m",
        above=0,
        choices=("auto",),
    )
    plots: bool = key("draw pictures, and report.html around them", default=True)
    restart_every: int | None = key(
        "steps between restart files. Without it: at the end only", default=None, at_least=1
    )


@dataclass(frozen=True, kw_only=True)
class Reference:
    """The values with which `isph validate` compares the result."""

    kind: str = key("the solution to compare with", choices=REFERENCE_KINDS)
    value: float | Vector | None = key(
        "published number, for the kinds that need one (permeability: m2, one per axis, or one along `axes`)",
        default=None,
    )
    axes: tuple[str, ...] | None = key(
        "axes along which one permeability holds; a flow along another is not compared with it", default=None,
        choices=AXES, unique=True
    )
    crop: tuple[tuple[int, int], ...] | None = key(
        "part of the image that a permeability is of, in voxels of the file as in `geometry.voxels.crop`; a run of "
        "another part is not compared with it. Without it: the whole image",
        default=None,
        at_least=0,
        lengths=(2, 3),
    )
    voxel_size: float | Vector | None = key(
        "edge of the voxels that a permeability is of, one number or one per axis; a run with other voxels is not "
        "compared with it. Without it: that of the run",
        default=None,
        unit="m",
        above=0,
    )
    geometry: Table[Any] = key(
        "what else of `geometry` the value is of, keys as they stand there, such as {voxels: {labels: {solid: 1}}, "
        "mirror: []}; a run in which one of them is otherwise is not compared with it. Keys that are not named "
        "may have any value",
        default=Table(),
        part_of=GeometryBlock,
    )
    tolerance: float | None = key("bound on the relative error", default=None, above=0)
    source: str = key("where the value is from", default="")
    reason: str = key("why that bound", default="")
    parameters: Table[float | str] = key("name: value of what the kind needs", default=Table())


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case: all its blocks."""

    title: str = key("free text", default="")
    geometry: GeometryBlock = key("where there is fluid and where there is solid")
    particles: ParticlesBlock = key("resolution and arrangement of the particles")
    fluids: Table[Fluid] = key("name: properties of the fluid, one block each")
    microporous: Table[Microporous] = key(
        "name: rock with pores below the resolution (stokes), one block each. Names stand where those of fluids do: in "
        "`geometry.voxels.labels` or `grey.fluids`, or `is` of a shape; the first fluid is what seeps through it; "
        "`porosity` leaves it out, its share of the volume is said beside it",
        default=Table(),
    )
    interface: InterfaceBlock | None = key("surface tension, with two fluids", default=None)
    reservoirs: Reservoirs | None = key(
        "which fluid is injected at one end and which leaves at the other; `drive` says at what pressure or flux",
        default=None,
    )
    drive: Drive | None = key("what makes the fluid move", default=None)
    initial: Initial | None = key("the state at time zero. Without it: at rest", default=None)
    flow: str = key(
        "navier_stokes: moving particles, in time; stokes: steady creeping flow on the fixed lattice",
        default="navier_stokes",
        choices=FLOWS,
    )
    time: Time | None = key("how long and in which steps (navier_stokes)", default=None)
    solver: Solver = key("the linear solvers", default=Solver())
    refine: tuple[float, ...] | str = key(
        "further spacings at which the same case is solved, to extrapolate (stokes). auto: two more, finer ones as "
        "memory and `refine_budget` allow, else coarser ones. throats: half of the spacing where the flow loses most "
        "of its energy",
        default=(),
        unit="m",
        above=0,
        unique=True,
        choices=("auto", "throats"),
    )
    refine_budget: float = key(
        "wall seconds that all spacings of `refine: auto` may take together, as those that were solved let expect",
        default=600.0,
        unit="s",
        above=0,
    )
    measure: tuple[str, ...] = key(
        "what is measured beside the permeability, along the same axes (stokes): formation_factor, the electric "
        "resistance over that of the fluid alone, and with it the effective diffusivity, by one more solve per axis",
        default=(),
        choices=MEASURES,
        unique=True,
    )
    output: Output = key("what the run leaves behind", default=Output())
    reference: Reference | None = key("what `isph validate` compares with", default=None)

    path: Path | None = field(default=None, compare=False)
    """The file that the case was read from."""
    places: Mapping[str, Where] = field(default_factory=dict, compare=False, repr=False)
    """Where each key was written, by its dotted path; empty for a case that was made in Python."""

    def place_of(self, path: str) -> Where:
        """Where a key was written, or the innermost block around it."""
        while path and path not in self.places:
            path = path.rpartition(".")[0]
        return self.places.get(path) or Where(str(self.path or "case"))

    @property
    def dim(self) -> int | None:
        """2 or 3; None for an image, which has to be read first."""
        return None if self.geometry.box is None else len(self.geometry.box)

    @property
    def fluid_names(self) -> tuple[str, ...]:
        """In case order: `phase` of a particle is the index into them."""
        return tuple(self.fluids)

    def phase_of(self, name: str) -> int:
        """Index of the fluid that a name stands for, -1 of `solid`; in microporous rock it is the first one."""
        return -1 if name == SOLID else 0 if name in self.microporous else self.fluid_names.index(name)

    @property
    def spacings(self) -> tuple[float, ...]:
        """Spacings that the case names, m; `refine: auto` adds others during the run (`runs/refinement.py`), `throats`
        half of the spacing in some cells (`runs/half_in_throats.py`)."""
        return (self.particles.spacing, *(() if isinstance(self.refine, str) else self.refine))

    @property
    def support(self) -> float:
        """Support radius over the spacing."""
        if self.particles.support is not None:
            return self.particles.support
        if self.flow == "navier_stokes" and self.dim == 2:
            return SUPPORT_MOVING_2D if self.interface is None else SUPPORT_TENSION_2D
        return SUPPORT

    @property
    def wall_distance(self) -> str:
        """How the wall distance is found: smooth or stairs of an image, exact of shapes."""
        return self.geometry.wall_distance or ("smooth" if self.geometry.voxels else "exact")

    def lattice_in(self, dim: int) -> str:
        """The arrangement of the particles of a scene with `dim` dimensions."""
        return self.particles.lattice or LATTICES[dim][0]

    def completed(self) -> Case:
        """The same case with the defaults that depend on other keys filled in."""
        geometry, particles = self.geometry, self.particles
        geometry = replace(geometry, wall_distance=self.wall_distance)
        particles = replace(particles, support=self.support)
        if self.dim:
            origin = geometry.origin or (0.0,) * self.dim
            geometry = replace(geometry, origin=origin, fluid=geometry.fluid or self.fluid_names[0])
            particles = replace(particles, lattice=self.lattice_in(self.dim))
        directory = self.output.directory or Path("out", self.path.stem if self.path else "case").absolute()
        return replace(
            self, geometry=geometry, particles=particles, output=replace(self.output, directory=directory)
        )


def plain(value: Any) -> Any:
    """Dataclasses, tables and tuples as dicts and lists, the types of YAML, without entries that are None."""
    if is_dataclass(value):
        cls: Any = type(value)
        attributes = {k.name: getattr(value, k.attribute) for k in keys_of(cls).values()}
        return {name: plain(v) for name, v in attributes.items() if v is not None}
    if isinstance(value, Table):
        return {name: plain(v) for name, v in value.items()}
    if isinstance(value, tuple):
        return [plain(v) for v in value]
    return str(value) if isinstance(value, Path) else value
