"""The command line: `isph init`, `run`, `validate`, `convert-voxels`, `relperm`, `report`,
`film`, `examples`, `keys`.

Nothing but click is imported before a command runs, so that `isph --help` answers at once. Results go to
stdout, everything else to stderr. Exit codes: see `EXIT_CODES`.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import math
import os
import re
import shlex
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .output.environment import launched, settle_streams, settle_threads, stop_printing
from .output.lines import DIGITS, permeability, table

if TYPE_CHECKING:
    from .case.blocks import Case
    from .domain.communicator import Ranks
    from .runs.relative_permeability import Relative

# Their meanings: EXIT_CODES
OUTSIDE, BAD_INPUT, FAILED, INTERNAL, STOPPED_SHORT, INTERRUPTED = 1, 2, 3, 4, 5, 130
NOT_READ = 141  # as the shell says it of programs that end with SIGPIPE
EXIT_CODES = """\
\b
Exit codes:
  0    done
  1    a result misses its reference: farther off than the tolerance, not had within --budget, or of a run that
       stopped short (validate)
  2    the case, a file or an option cannot be used; nothing was written
  3    the run failed on the way: a solve that did not converge, a full disk
  4    a fault of isph itself (please report it; --debug shows where)
  5    the run stopped short: not steady, or out of steps before its end; what it left is written (run)
  130  interrupted
"""
CASES = (".yaml", ".yml", "")


class Unusable(ValueError):
    """An option that cannot be used."""


def set_threads(threads: int | None, quiet: bool = False) -> None:
    """Calls `environment.settle_threads`; prints its sentence on stderr unless `quiet`."""
    note = settle_threads(threads)
    if note and not quiet:
        complain(note)


# -- errors become one message and an exit code ----------------------------------------------------------


def exit_code(error: BaseException) -> int:
    """Exit code of an exception."""
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    names = {cls.__name__ for cls in type(error).__mro__}  # by name, without importing modules that were not used
    if names & {"SolveError", "StepError", "RunError", "NotFiniteError", "CompareError", "LinAlgError", "RenderError"}:
        return FAILED
    if isinstance(error, (OSError, MemoryError)):
        return FAILED
    if isinstance(error, ValueError):  # of ours: CaseError, VoxelError, ShapeError, ParticleError, ...
        return BAD_INPUT
    return INTERNAL


def message(error: BaseException) -> str:
    """The message that is printed for an exception."""
    restart = getattr(error, "restart", None)
    left = f"\nrestart file: {restart}" if restart else ""
    worst = getattr(error, "worst", None)
    left += f"\nworst particles: {worst}" if worst else ""
    left += f"\n{found}" if (found := getattr(error, "found", "")) else ""
    if isinstance(error, KeyboardInterrupt):
        results = getattr(error, "results", None)
        return f"interrupted{left}" + (f"\nresults: {results}" if results else "")
    if isinstance(error, MemoryError):
        return "error: out of memory; `isph validate --check-only` estimates what a case needs"
    code = exit_code(error)
    text = str(error) or type(error).__name__
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        text = f"{text}; make room there, or choose a folder on another disk (--out)"
    if code == INTERNAL:
        return (
            f"internal error: {type(error).__name__}: {text}\nplease report it; --debug shows the traceback"
        )
    problems = getattr(error, "problems", ())
    return (f"{len(problems)} errors:\n{text}" if len(problems) > 1 else f"error: {text}") + left


def guarded(function: Callable[..., int | None]) -> Callable[..., None]:
    """The command with `--debug`, its errors as messages on stderr and its return value as the exit code."""

    @click.option("--debug", is_flag=True, help="Show the traceback of an error.")
    @functools.wraps(function)
    def command(*args: Any, debug: bool, **options: Any) -> None:
        try:
            code = function(*args, **options) or 0
        except click.ClickException:
            raise
        except BrokenPipeError:
            stop_printing()
            code = NOT_READ
        except (Exception, KeyboardInterrupt) as error:
            code = exit_code(error)
            if several() is not None:
                fail_together(traceback.format_exc() if debug else message(error), code)
            elif debug:
                raise
            else:
                complain(message(error))
        sys.exit(code)

    return command


FAIL_TOGETHER = 5.0  # s within which ranks that fail for the same reason fail; one that fails alone ends the others


def several() -> Ranks | None:
    """The processes that run a case together; None of one alone."""
    module = sys.modules.get(f"{__package__}.domain.communicator")  # not imported for a message: it imports numpy
    ranks = module.current() if module is not None else None
    return ranks if ranks is not None and ranks.size > 1 else None


def fail_together(text: str, code: int) -> None:
    """Prints the message of a failure of all processes once. A process that failed alone prints its message and ends
    the others, which would wait for it for ever."""
    ranks = several()
    assert ranks is not None
    said = ranks.agree_to_fail(text, FAIL_TOGETHER)
    if said is None:
        complain(f"rank {ranks.rank} of {ranks.size}: {text}")
        ranks.abort(code)
    elif ranks.rank == 0:
        for line in dict.fromkeys(said):
            complain(line)


def complain(text: str) -> None:
    """Prints a line on stderr; an error in that, of a full disk or a closed pipe, is ignored and changes no exit
    code."""
    with contextlib.suppress(OSError):
        click.echo(text, err=True)


class Program(click.Group):
    """The commands, with streams that take any text."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Runs the command that the arguments name."""
        settle_streams()
        return super().main(*args, **options)


def show_version(context: click.Context, _: click.Parameter, asked: bool) -> None:
    """Prints the version; it is read only here, since that takes longer than all else of `isph --help`."""
    if asked and not context.resilient_parsing:
        from . import __version__

        click.echo(f"isph, version {__version__}")
        context.exit()


@click.group(
    cls=Program, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}, epilog=EXIT_CODES
)
@click.option("--version", is_flag=True, expose_value=False, is_eager=True, callback=show_version,
              help="Show the version and exit.")  # fmt: skip
def main() -> None:
    """Flow through rock, bead packs and other complex solids: permeability, two fluids, pictures.

    A case is a YAML file, and `isph keys` lists what can stand in it. An image can be run as it is. Units are SI or any
    consistent set, and numbers may have a unit (2.25um).

    \b
    isph run scan.tif --set geometry.voxels.voxel_size=2.25um     the permeability of a scan
    isph init scan.npy --voxel-size 5e-6     a commented case to begin with
    isph validate --check-only case.yaml     what a run would do, need and cost
    isph run case.yaml                       run it; results go to out/case
    isph convert-voxels scan.npy rock.npz --threshold 90 --voxel-size 5e-6
    isph examples                            the cases that come with it
    """


set_option = click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE",
    help="Put a value into the case: --set particles.spacing=1e-5. May be repeated.",
)  # fmt: skip
threads_option = click.option(
    "--threads", type=click.IntRange(1, os.cpu_count() or 1), help="Threads of the kernels. [default: all]"
)
check_option = click.option("--check-only", is_flag=True, help="Check what would be run; run nothing.")
ranks_option = click.option(
    "--ranks", type=click.IntRange(1), metavar="N",
    help="With --check-only: what each of N processes (mpiexec -n N isph run) holds and takes.",
)  # fmt: skip
quiet_option = click.option("--quiet", is_flag=True, help="No progress display; results only.")


# -- run -------------------------------------------------------------------------------------------------


@main.command(epilog=EXIT_CODES)
@click.argument("case_file", metavar="[CASE]", type=click.Path(path_type=Path), required=False)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Output directory. [default: the case's, or out/CASE]"
)
@click.option(
    "--restart", type=click.Path(path_type=Path, exists=True, file_okay=False), metavar="DIR",
    help="Go on from DIR/restart.npz with the case in DIR; --set time.end=... runs it longer.",
)  # fmt: skip
@click.option(
    "--overwrite", is_flag=True,
    help="Replace the results that the output directory holds: those files that its manifest.json names.",
)  # fmt: skip
@check_option
@ranks_option
@threads_option
@set_option
@quiet_option
@guarded
def run(
    case_file: Path | None, out: Path | None, restart: Path | None, overwrite: bool, overrides: tuple[str, ...],
    quiet: bool, **more: Any,
) -> int:  # fmt: skip
    """Run a case.

    Prints permeability in m2 and millidarcy (mean velocities where there is none), what was warned of, the error
    against the case's reference and where the time went; leaves snapshots, history, summary and pictures in the
    output directory (docs/output.md). A directory that holds results is refused unless --restart or --overwrite is
    given. An image in place of CASE is run as it is: its permeability along x to water, one particle per voxel.

    \b
    isph run beadpack.yaml
    isph run beadpack.yaml --set particles.spacing=2e-5 --out out/fine --threads 4
    isph run --restart out/beadpack
    isph run scan.tif --set geometry.voxels.voxel_size=2.25um
    """
    if (case_file is None) == (restart is None):
        raise click.UsageError("give a CASE, or --restart DIR")
    if overwrite and restart is not None and (out is None or out.resolve() == restart.resolve()):
        raise click.UsageError("--restart goes on with the files in DIR, --overwrite replaces them: give one of them")
    threads, ranks, check_only = more["threads"], more["ranks"], more["check_only"]
    set_threads(threads, quiet)
    ranks_go_with_a_check(ranks, check_only)
    if check_only:
        return say_check(load(case_file or restart / "case.yaml", overrides), ranks)  # type: ignore[operator]
    if launched() > 1:
        from .domain.communicator import join

        join(launched())
    case = load(case_file or restart / "case.yaml", overrides, out or restart)  # type: ignore[operator]
    check_directory(directory_of(case))
    from . import api

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # SIGTERM ends a run as Ctrl-C does: with a restart file
    try:
        found = api.run(case, out=directory_of(case), quiet=quiet, restart=restart, overwrite=overwrite,
                        threads=threads)
    except KeyboardInterrupt as interrupt:
        if restart is not None and getattr(interrupt, "restart", None) is None:  # before it wrote one itself
            interrupt.restart = restart / "restart.npz"  # type: ignore[attr-defined]
        raise
    processes = several()
    if processes is not None and processes.rank > 0:
        return 0
    click.echo(str(found))
    if not found.complete:
        click.echo(f"stopped short: {found.summary.get('message') or found.summary['status']}", err=True)
        return STOPPED_SHORT
    return 0


def load(path: Path, overrides: Iterable[str], out: Path | None = None) -> Case:
    """Read a case, its output directory replaced by `out`."""
    from dataclasses import replace

    from .case.load import load_case

    case = case_of_image(path, tuple(overrides)) if is_image(path) else load_case(path, tuple(overrides))
    return case if out is None else replace(case, output=replace(case.output, directory=out.absolute()))


def is_image(path: Path) -> bool:
    """Whether there is an image, or a folder of slices, and no case."""
    if not path.exists() or (path.is_file() and path.suffix.lower() in CASES):
        return False
    from .geometry.images.read import FORMATS

    if path.is_dir():  # a folder of results holds pictures too
        return not (path / "case.yaml").exists()
    return path.suffix.lower() in FORMATS


def case_of_image(path: Path, overrides: tuple[str, ...]) -> Case:
    """A case of an image, its assumptions printed on stderr; Unusable where too little is known."""
    from .geometry.images.image import VoxelError
    from .scene.first_case import first_case

    try:
        found = first_case(named(path), overrides)
    except VoxelError as error:
        refuse_image(path, str(error))
        raise
    for text in found.assumed:
        complain(f"assumed: {text}")
    return found.case


def named(path: Path) -> Path:
    """A path with a name of its own: '.' has none."""
    return path if path.name else path.resolve()


def refuse_image(path: Path, reason: str) -> None:
    """Raise Unusable for an image of which too little is known, with the command that writes a case of it."""
    from .geometry.images.read import image_shape

    shape = image_shape(path)
    if shape is None:  # the error of the reader says what is wrong with the file
        return
    size, name = " x ".join(map(str, shape[::-1])), shlex.quote(str(path))
    raise Unusable(f"{reason} (an image of {size} voxels along {', '.join('xyz'[: len(shape)])}). Or keep what is "
                   f"known of it in a case: isph init {name} --voxel-size 5e-6")


def directory_of(case: Case) -> Path:
    """Output directory of a case that was loaded."""
    assert case.output.directory is not None
    return case.output.directory


def check_directory(path: Path) -> None:
    """Raise Unusable where the output directory can neither be made nor written to."""
    there = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
    if not there.is_dir():
        raise Unusable(f"{there}: is a file; choose another output directory with --out")
    if not os.access(there, os.W_OK | os.X_OK):
        raise Unusable(f"{there}: cannot be written to; choose another output directory with --out")


# -- validate --------------------------------------------------------------------------------------------


@main.command(epilog=EXIT_CODES, short_help="Check cases; run those that name a reference.")
@click.argument("case_files", metavar="[CASE]...", nargs=-1, type=click.Path(path_type=Path))
@set_option
@check_option
@ranks_option
@click.option("--stress", is_flag=True, help="Run stiff and extreme scenes instead; the page of docs/stability.md.")
@click.option(
    "--levels", type=click.IntRange(1, 12), help="Resolutions at which a reference is run. [default: 3]"
)
@click.option(
    "--budget", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
    help="Seconds that the levels of a case (in each setting) may take; none is begun that would take more. "
    "[default: 60 for those finer than the case]",
)  # fmt: skip
@click.option(
    "--vary", multiple=True, metavar="KEY=A,B,...", callback=lambda *found: settings(found[-1]),
    help="Run the levels with each of these values: --vary particles.support=2.1,2.5. May be repeated: then "
    "every combination is run.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path),
    help="Directory of the runs, a folder a case in it. [default: out/validate]",
)  # fmt: skip
@click.option(
    "--paper", is_flag=True,
    help="Run the figures and tables of the paper instead, into one report; --budget is of them all. "
    "[default: 1500 CPU seconds, out/paper]",
)  # fmt: skip
@threads_option
@quiet_option
@guarded
def validate(
    case_files: tuple[Path, ...],
    overrides: tuple[str, ...],
    check_only: bool,
    ranks: int | None,
    stress: bool,
    levels: int | None,
    budget: float | None,
    vary: tuple[tuple[str, tuple[str, ...]], ...],
    out: Path | None,
    paper: bool,
    threads: int | None,
    quiet: bool,
) -> int:
    """Check cases, and run those that name a reference: error against run time.

    Without CASE: all of the folder `cases`. An image in its place is taken as isph run takes it. The check says
    what a run would use, need and cost (particles, memory, time), how fine the throats are resolved, which time
    step binds, and what is likely to go wrong. A reference is run at twice the
    spacing of the case, at its own and at half of it; the error at its own has to be within reference.tolerance.

    \b
    isph validate --check-only beadpack.yaml
    isph validate --check-only --ranks 64 beadpack.yaml
    isph validate cases/slit.yaml --levels 3 --budget 60
    isph validate cases/taylor_green_2d.yaml --vary particles.support=2.1,2.5,3
    isph validate --paper --budget 1500 --out out/paper
    """
    set_threads(threads, quiet)
    ranks_go_with_a_check(ranks, check_only)
    if stress:
        from .validation.stress import page

        return told(page(tell=None if quiet else lambda line: click.echo(line, err=True)))
    if paper:
        if case_files or overrides or check_only or levels or vary:
            raise click.UsageError("--paper takes no CASE and only --budget, --out and --threads")
        from .validation.paper import reproduce

        return told(reproduce(out, budget, click.echo))
    code, to_run, estimates = check_cases(case_files or default_cases(), overrides, ranks)
    if check_only or not to_run:
        return code
    options = {"levels": levels, "budget": budget, "out": out, "quiet": quiet, "vary": vary}
    return code or run_references(to_run, overrides=overrides, estimates=estimates, **options)


def ranks_go_with_a_check(ranks: int | None, check_only: bool) -> None:
    """Raises UsageError where a number of processes is given and nothing is checked."""
    if ranks is not None and not check_only:
        raise click.UsageError("--ranks goes with --check-only; to run on N processes: mpiexec -n N isph run CASE")


def say_check(case: Case, ranks: int | None) -> int:
    """Print the check of a case, for so many processes where they are given; the exit code."""
    from .preflight.check import check

    checked = check(case, ranks=ranks)
    click.echo(checked.text())
    return 0 if checked.can_run else BAD_INPUT


def told(outcome: tuple[str, bool]) -> int:
    """Print a page; returns the exit code, by whether everything on it keeps its bounds."""
    text, passed = outcome
    click.echo(text)
    return 0 if passed else OUTSIDE


def check_cases(case_files: Sequence[Path], overrides: tuple[str, ...],
                ranks: int | None = None) -> tuple[int, list[Case], dict[Path | None, float | None]]:
    """Print the check of each case, for so many processes where they are given: (exit code, cases with a reference that
    can be run, their seconds by path)."""
    from .preflight.check import check

    code, to_run, estimates = 0, [], {}
    for path in case_files:
        try:
            checked = check(load(path, overrides), ranks=ranks)
        except (Exception, KeyboardInterrupt) as error:
            if len(case_files) == 1 or exit_code(error) != BAD_INPUT:
                raise
            click.echo(message(error), err=True)
            code = BAD_INPUT
            continue
        click.echo(checked.text() + "\n")
        if not checked.can_run:
            code = BAD_INPUT
        elif checked.case.reference is not None:
            to_run.append(checked.case)
            estimates[checked.case.path] = checked.seconds
    return code, to_run, estimates


def settings(texts: Iterable[str]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """'key=a,b' of each --vary as (key, ('a', 'b')); commas within brackets do not part values."""
    found = []
    for text in texts:
        name, equals, values = text.partition("=")
        parts = tuple(part.strip() for part in re.split(r",(?![^\[]*\])(?![^{]*\})", values))
        if not (name.strip() and equals and all(parts)):
            raise click.BadParameter(f"{text!r} is not of the form key=a,b,c")
        found.append((name.strip(), parts))
    return tuple(found)


def default_cases() -> tuple[Path, ...]:
    """The cases of the folder `cases` here, else those that come with the package."""
    if found := tuple(sorted(Path("cases").glob("*.yaml"))):
        return found
    from .case.examples import example_files

    return example_files()


def run_references(cases: list[Case], **options: Any) -> int:
    """Run the cases against their references; the exit code."""
    from .validation.ladder import validate_cases

    return told(validate_cases(cases, **options))


# -- convert-voxels --------------------------------------------------------------------------------------


def numbers(text: str, kind: Callable[[str], Any] = float) -> tuple[Any, ...]:
    """'1,2,3' as numbers; raises ValueError for anything else, NaN and infinity included."""
    values = tuple(kind(part) for part in text.split(","))
    if not all(math.isfinite(v) for v in values):
        raise ValueError
    return values


def parser(read: Callable[[str], Any], form: str) -> Callable[[Any, Any, str | None], Any]:
    """Callback of an option: its text through `read`; `form` says how it should look."""

    def callback(context: Any, parameter: Any, text: str | None) -> Any:
        try:
            return None if text is None else read(text)
        except ValueError:
            raise click.BadParameter(f"{text!r} is not of the form {form}") from None

    return callback


def lengths(text: str) -> tuple[float, ...]:
    """'5um' or '5e-6,5e-6,1e-5' as lengths in m; raises ValueError for what is no length."""
    from .case.units import number_in

    return tuple(number_in(part, "m") for part in text.split(","))


def radius_of(text: str) -> float:
    """'0.1mm' as a length in m; raises ValueError for what is none or not above 0."""
    (radius,) = lengths(text)
    if not 0 < radius < math.inf:
        raise ValueError
    return radius


def pairs(text: str, between: str) -> tuple[tuple[int, int], ...]:
    """'a:b,c:d' as ((a, b), (c, d))."""
    split = (part.split(between) for part in text.split(","))
    return tuple((int(first), int(second)) for first, second in split)


def threshold_of(text: str) -> str | tuple[float, ...]:
    """'otsu', or one number or two."""
    return text if text == "otsu" else numbers(text)


def axes_named(text: str) -> tuple[str, ...]:
    """'x,z' as ('x', 'z')."""
    found = tuple(text.replace(" ", "").split(","))
    if not set(found) <= set("xyz") or len(set(found)) < len(found):
        raise ValueError
    return found


@main.command("convert-voxels", epilog=EXIT_CODES, short_help="Convert an image of rock and say what it holds.")
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--array", metavar="NAME", help="Which array of a file that holds several (npz, HDF5, VTI, VTK, MATLAB).")
@click.option("--axes", type=click.Choice(["zyx", "xyz", "zxy", "yxz", "yzx", "xzy"]),
              help="Directions of the axes of the array of IN, the last one varies fastest. [default: zyx; yxz of "
              "MATLAB, xyz of Palabos .dat files]")  # fmt: skip
@click.option("--shape", callback=parser(lambda t: numbers(t, int), "100,100,50"), metavar="X,Y,Z",
              help="Voxels along x, y, z of a file without a header (raw, dat). [default: by its name]")  # fmt: skip
@click.option("--dtype", metavar="TYPE", help="Type of the numbers of a raw file, such as uint8 or uint16.")
@click.option("--offset", type=click.IntRange(0), help="Bytes before the first voxel of a raw file.")
@click.option("--byte-order", type=click.Choice(["little", "big"]), help="Of a raw file. [default: little]")
@click.option("--crop", "crop_to", callback=parser(lambda t: pairs(t, ":"), "0:100,0:100,0:50"), metavar="RANGES",
              help="Voxels that are kept, x0:x1,y0:y1,z0:z1; upper ends left out. Only they are read.")  # fmt: skip
@click.option("--threshold", callback=parser(threshold_of, "90, 60,120 or otsu"), metavar="T",
              help="Grey values of T and above are solid (1), those below pore (0). Two values T,U: from U on solid "
              "(1), between them 2, below T pore (0). otsu: the value that parts the histogram best.")  # fmt: skip
@click.option("--invert", is_flag=True,
              help="With --threshold: grey values below T are solid. Without: two labels change places.")  # fmt: skip
@click.option("--labels", callback=parser(lambda t: dict(pairs(t, "=")), "255=1,7=0"), metavar="OLD=NEW,...",
              help="Replace voxel values.")  # fmt: skip
@click.option("--solid", callback=parser(lambda t: numbers(t, int), "1,2"), metavar="VALUE,...", default="1",
              show_default=True, help="Values that are solid, for what follows and the report.")  # fmt: skip
@click.option("--trim", is_flag=True, help="Cut off the border outside of which all is solid.")
@click.option("--mirror", callback=parser(axes_named, "x or x,y"), metavar="AXES",
              help="Let the mirror image follow along these axes.")  # fmt: skip
@click.option("--connected", type=click.Choice(["x", "y", "z", "any", "largest"]),
              help="Keep only the pores that lead through along an axis (any: one of them), or the largest; the "
              "others become solid.")  # fmt: skip
@click.option(
    "--downsample", type=click.IntRange(1), default=1, metavar="N", help="N x N x N voxels become one."
)
@click.option("--voxel-size", callback=parser(lengths, "5e-6, 5um or 5e-6,5e-6,1e-5"), metavar="M",
              help="Edge of a voxel of IN, m unless a unit is named; one number or x,y,z.")  # fmt: skip
@click.option("--picture/--no-picture", default=True, help="Draw three slices into OUT_slices.png.  [default: picture]")
@click.option("--force", is_flag=True,
              help="Replace OUT (the raw file of an mhd and the picture too) where it exists; never IN.")  # fmt: skip
@guarded
def convert_voxels(source: Path, target: Path, picture: bool, force: bool, **options: Any) -> None:
    """Convert an image of rock and say what it holds.

    Reads TIFF, raw, NRRD, HDF5, VTI, VTK, PNG, BMP, MetaImage, npy, npz, Palabos .dat, MATLAB .mat and folders of
    slices; writes npy, npz, mhd, mha, tif, nrrd and raw. In this order: crop, threshold, invert, labels, trim, mirror,
    connected, downsample.

    \b
    isph convert-voxels scan.tif rock.npz --threshold otsu
    isph convert-voxels scan.raw rock.npz --shape 1000,1000,1000 --dtype uint16 --crop 0:200,0:200,0:200
    isph convert-voxels slices/ rock.mhd --threshold 60,120 --connected x --voxel-size 5.3um
    isph convert-voxels seg.nrrd rock.npz --labels 255=1 --trim --downsample 2
    """
    if target.is_dir():
        raise Unusable(f"{target}: is a folder; name the file that is to be written, such as {target / 'rock.npz'}")
    set_threads(None)
    from .geometry.images.image import Layout
    from .geometry.images.raw import DTYPES
    from .output.convert_images import Conversion, convert

    if options["dtype"] not in (None, *DTYPES):
        raise click.UsageError(f"--dtype: {options['dtype']} is none of {', '.join(DTYPES)}")
    layout = Layout(**{name: options.pop(name) for name in ("array", "axes", "shape", "dtype", "offset", "byte_order")})
    how = Conversion(layout=layout, **{name: value for name, value in options.items() if value is not None})
    click.echo(image_lines(convert(source, target, how, force, picture)))


def image_lines(known: Mapping[str, Any]) -> str:
    """The report of `convert_images.convert` as text."""
    size, solid = known["voxel_size"], known["solid"]
    total = sum(known["labels"].values())
    axes = known["percolates"]
    lines = [
        ("read", known["read"]),
        ("written", known["file"]),
        ("voxels", " x ".join(str(n) for n in known["shape"].values()) + f" ({', '.join(axes)})"),
        (
            "voxel size",
            "not known; give --voxel-size" if size is None
            else f"{' x '.join(f'{s:g}' for s in size)} m ({', '.join(axes)}), of IN, {known['voxel_size_from']}",
        ),
        *(("WARNING", text) for text in known["warnings"]),
    ]
    if size is not None:
        edges = (f"{n * s:.4g}" for n, s in zip(known["shape"].values(), size))
        lines.append(("size", f"{' x '.join(edges)} m ({', '.join(axes)})"))
    if "threshold" in known:
        lines.append(("threshold", known["threshold"]))
    if "trimmed" in known:
        cut = " x ".join(map(str, known["trimmed"]))
        lines.append(("trimmed", f"{cut} voxels of solid border ({', '.join(axes)})"))
    if "filled" in known:
        lines.append(("filled", f"{known['filled']} voxels of other pores"))
    for value, count in list(known["labels"].items())[:20]:
        kind = "solid" if value in solid else "pore"
        lines.append((f"value {value}", f"{kind}, {count} voxels, {100 * count / total:.2f} %"))
    if len(known["labels"]) > 20:
        lines.append(
            ("", f"and {len(known['labels']) - 20} further values; are these grey values? --threshold")
        )
    through = [f"{axis} ({100 * known['percolating_porosity'][axis]:.2f} %)" for axis in axes if axes[axis]]
    unit = "voxels" if size is None else "m3" if len(axes) == 3 else "m2"
    pores = {value: count for value, count in known["labels"].items() if value not in solid}
    parts = ""
    if 1 < len(pores) <= 20:  # clear pores and microporous rock, or two fluids: the image does not say
        parts = f" ({', '.join(f'value {value} {100 * count / total:.2f} %' for value, count in pores.items())})"
    lines += [
        ("porosity", f"{100 * known['porosity']:.2f} %{parts}"),
        (
            "connected",
            f"{known['components']} pores; the largest holds {100 * known['largest_share']:.2f} % of all",
        ),
        ("through-going", ", ".join(through) if through else "along no axis"),
        ("pockets", f"{known['isolated_pockets']} closed, {known['isolated_volume']:.4g} {unit}"),
    ]
    if "picture" in known:
        lines.append(("picture", known["picture"]))
    return table(lines)


# -- relperm ---------------------------------------------------------------------------------------------


@main.command(epilog=EXIT_CODES, short_help="Relative permeability of both fluids of a run.")
@click.argument("folder", metavar="OUT", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--axis", type=click.Choice(["x", "y", "z"]), help="Of the flow. [default: that of the drive]")
@click.option("--part", callback=parser(lambda t: share_of(t), "0.3:1, smaller first"), default="0:1", metavar="A:B",
              help="Of the sample along the axis, as shares of its length. [default: 0:1]")  # fmt: skip
@click.option("--all", "every", is_flag=True, help="Of every snapshot, as comma-separated values. [default: the last]")
@threads_option
@guarded
def relperm(folder: Path, axis: str | None, part: tuple[float, float], every: bool, threads: int | None) -> None:
    """Relative permeability of both fluids as they lie in a snapshot of the run in OUT, with their saturations.

    A steady solve of each fluid, with the other one as a solid that does not slip, over one of both as a single fluid
    (docs/two_fluids.md). Nothing is written.

    \b
    isph relperm out/rock_drainage
    isph relperm out/rock_drainage --part 0:0.5
    isph relperm out/rock_drainage --all > relative_permeability.csv
    """
    set_threads(threads)
    from .output.clock import Clock
    from .runs.relative_permeability import relative_permeabilities

    found = relative_permeabilities(folder, Clock(), every, axis, part)
    click.echo(relative_table(found) if every else table(relative_lines(found[-1])))
    for one in found:
        for sentence in one.warnings:
            click.echo(f"warning: {f't = {one.time:g} s: ' if every else ''}{sentence}", err=True)


def share_of(text: str) -> tuple[float, float]:
    """'0.3:1' as (0.3, 1.0); raises ValueError for what is no part of a whole."""
    first, last = (float(word) for word in text.split(":"))
    if not 0.0 <= first < last <= 1.0:
        raise ValueError
    return first, last


def relative_lines(found: Relative) -> list[tuple[str, str]]:
    """The printed lines of one snapshot."""
    note = (", of both as one fluid, between walls taken from cells of a spacing; those of isph run are of the image "
            "(0.4 and 1.4 % apart in two pieces of Berea)")
    lines = [("time", f"{found.time:g} s"), (f"permeability {found.axis}", permeability(found.permeability) + note)]
    for k, (name, saturation, relative) in enumerate(zip(found.names, found.saturation, found.relative)):
        why = found.why_zero(k)
        shown = f"{relative:.{DIGITS}g}" + (f" ({why})" if why else "")
        lines += [(f"saturation {name}", f"{saturation:.4g}"), (f"k_r {name}", shown)]
    return lines


def relative_table(found: Sequence[Relative]) -> str:
    """Comma-separated values, a line per snapshot; leads_through_<fluid> is 1 where the fluid percolates, else 0."""
    a, b = found[0].names
    lines = [f"time,saturation_{a},saturation_{b},k_r_{a},k_r_{b},leads_through_{a},leads_through_{b}"]
    return "\n".join(lines + [",".join(f"{v:.6g}" for v in (f.time, *f.saturation, *f.relative, *f.leads_through))
                              for f in found])


# -- init, examples, report ---------------------------------------------------------------------------------


@main.command(epilog=EXIT_CODES, short_help="Write a commented case to begin with.")
@click.argument("source", metavar="[IMAGE | SPHERES]", type=click.Path(path_type=Path), required=False)
@click.argument("target", metavar="[CASE]", type=click.Path(path_type=Path), required=False)
@click.option("--drop", is_flag=True, help="A drop in a throat, two fluids, in place of a file: --drop [CASE].")
@click.option("--voxel-size", callback=parser(lengths, "5e-6, 5um or 5e-6,5e-6,1e-5"), metavar="M",
              help="Edge of a voxel of IMAGE, m; one number or x,y,z.")  # fmt: skip
@click.option("--radius", callback=parser(radius_of, "1e-4 or 0.1mm, above 0"), metavar="M",
              help="Radius of all SPHERES, m, where the file has no column for it.")  # fmt: skip
@guarded
def init(source: Path | None, target: Path | None, drop: bool, voxel_size: tuple[float, ...] | None,
         radius: float | None) -> None:  # fmt: skip
    """Write a commented case for an image, spheres, or a drop in a throat; say what was assumed.

    SPHERES is a table of centres and radii, or a dump of LAMMPS or LIGGGHTS.

    The case goes beside its data, under the name of the file; a file that is there is never replaced.

    \b
    isph init scan.npy --voxel-size 2.25e-6
    isph init pack.csv my_pack.yaml --radius 2.5e-4
    isph init dump.lammpstrj
    isph init --drop drop.yaml
    """
    if (source is None and not drop) or (drop and target is not None):
        raise click.UsageError("give an IMAGE or a list of SPHERES, or --drop")
    set_threads(None)
    from .scene import new_case

    path = (source or Path("drop.yaml")) if drop else target or named(source).with_suffix(".yaml")  # type: ignore[arg-type]
    if path.exists():
        raise Unusable(f"{path}: is there already; name another file for the case")
    if drop:
        made = new_case.case_for_drop()
    elif new_case.is_list_of_spheres(source):  # type: ignore[arg-type]
        made = new_case.case_for_spheres(source, path.parent, radius)  # type: ignore[arg-type]
    else:
        made = new_case.case_for_image(source, path.parent, voxel_size)  # type: ignore[arg-type]
    write_whole(path, made.text)
    for note in made.notes:
        complain(f"note: {note}")
    click.echo(f"{path} written; now: isph validate --check-only {shlex.quote(str(path))}")


def write_whole(path: Path, text: str) -> None:
    """Writes a new file, or none: what a full disk cut short would be refused later as there already."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        with contextlib.suppress(OSError):
            if path.stat().st_size < len(text):
                path.unlink()
        raise Unusable(f"{path}: cannot be written ({error.strerror}); name another file for the case") from None


@main.command(epilog=EXIT_CODES, short_help="List the cases that come with isph, or copy one.")
@click.argument("name", required=False)
@click.option("--copy", "folder", type=click.Path(path_type=Path, file_okay=False), metavar="DIR",
              help="Copy the case and its data into DIR. [default: only its text is printed]")  # fmt: skip
@guarded
def examples(name: str | None, folder: Path | None) -> None:
    """List the cases that come with isph; print one, or copy it with its data.

    \b
    isph examples
    isph examples berea
    isph examples berea --copy .
    """
    if name is None:
        if folder is not None:
            raise click.UsageError("name the example that is to be copied")
        from .case.examples import described_examples

        click.echo(table(described_examples()))
        return
    from .case.examples import copy_example, example_file

    if folder is None:
        click.echo(example_file(name).read_text(encoding="utf-8"), nl=False)
        return
    written = copy_example(name, folder)
    for path in written:
        complain(f"written: {path}")
    click.echo(f"now: isph run {written[0]}")


def may_write(target: Path, force: bool) -> None:
    """Raises Unusable where the file exists, unless `force` allows to replace it."""
    if target.exists() and not force:
        raise Unusable(f"{target}: is there already; name another file with --to, or replace it with --force")


@main.command(epilog=EXIT_CODES, short_help="One HTML page of a run, or of several side by side.")
@click.argument("directories", metavar="OUT...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--to", "target", type=click.Path(path_type=Path, dir_okay=False), default="report.html",
              metavar="FILE", show_default=True, help="The page to write.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace FILE where it exists.")
@guarded
def report(directories: tuple[Path, ...], target: Path, force: bool) -> None:
    """Write one HTML page of the runs in OUT...: of one what was asked, the answer, warnings, pictures and how to
    repeat it; of several what differs between their cases and results, side by side.

    A run leaves the page of its own as report.html beside its results.

    \b
    isph report out/coarse out/fine --to comparison.html
    """
    from .output.files import write_text
    from .output.report import read_run, report_page

    runs = [read_run(directory) for directory in directories]
    may_write(target, force)
    write_text(target, report_page(runs))
    click.echo(f"{target.absolute()} written")


# -- ladders ---------------------------------------------------------------------------------------------


def ladder_folder(path: Path, out: Path | None, kind: str, overwrite: bool) -> Path:
    """Where a ladder of runs goes; Unusable where something is there that may not be replaced."""
    folder = out or Path("out", f"{path.stem}_{kind}")
    check_directory(folder)
    if folder.exists() and any(folder.iterdir()) and not overwrite:
        raise Unusable(f"{folder}: is not empty; name another folder with --out, or replace its results with "
                       "--overwrite")
    return folder.absolute()


def ladder_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """--out, --overwrite, --threads, --set and --quiet of a command that runs a case several times."""
    for option in (quiet_option, set_option, threads_option,
                   click.option("--overwrite", is_flag=True, help="Replace the results that the folder holds."),
                   click.option("--out", type=click.Path(path_type=Path), help="Folder. [default: out/CASE_COMMAND]")):
        function = option(function)
    return function


@main.command(epilog=EXIT_CODES, short_help="Permeability and inertia (Forchheimer) over a ladder of forces.")
@click.argument("case_file", metavar="CASE", type=click.Path(path_type=Path))
@click.option("--factors", callback=parser(numbers, "1,10,30,100"), default="1,10,30,100", metavar="F,...",
              show_default=True, help="What the force of the case is multiplied with.")  # fmt: skip
@ladder_options
@guarded
def forchheimer(case_file: Path, factors: tuple[float, ...], out: Path | None, overwrite: bool, threads: int | None,
                overrides: tuple[str, ...], quiet: bool) -> None:
    """Run CASE with its force times each factor, and fit force = nu U / k + beta U^2, U the superficial velocity.

    CASE has flow: navier_stokes, a force in drive and time: {steady: 0.01}. Choose factors that make Reynolds numbers
    above one: below, inertia grows with another power of U.

    \b
    isph forchheimer array.yaml --factors 1,30,100,300
    """
    set_threads(threads, quiet)
    from .runs import ladders

    folder = ladder_folder(case_file, out, "forchheimer", overwrite)
    found = ladders.forchheimer(load(case_file, overrides), factors, folder, quiet, overwrite,
                                None if quiet else complain)
    lines = [("permeability", permeability(found.permeability)), ("beta", f"{found.beta:.{DIGITS}g} 1/m")]
    if found.errors is not None:
        lines[1:1] = [("  +-", f"{found.errors[0]:.2g} m2, by the scatter about the law")]
        lines.append(("  +-", f"{found.errors[1]:.2g} 1/m"))
    ends = f"{found.rows[0]['reynolds']:.3g} to {found.rows[-1]['reynolds']:.3g}"
    click.echo(table([*lines, ("Reynolds", f"{ends} (U sqrt(k) / nu)"), ("results", str(folder))]))


@main.command(epilog=EXIT_CODES, short_help="Slip of gas (Klinkenberg) over a ladder of slip lengths.")
@click.argument("case_file", metavar="CASE", type=click.Path(path_type=Path))
@click.option("--slip-lengths", callback=parser(lengths, "0,1e-7,2e-7"), required=True, metavar="M,...",
              help="Slip lengths of the walls, m unless a unit is named.")  # fmt: skip
@ladder_options
@guarded
def klinkenberg(case_file: Path, slip_lengths: tuple[float, ...], out: Path | None, overwrite: bool,
                threads: int | None, overrides: tuple[str, ...], quiet: bool) -> None:
    """Run CASE (stokes) with walls of several slip lengths s, and fit k(s) = k (1 + c s + ...).

    A gas whose slip length is S / p at the pressure p has the factor of Klinkenberg b = c S.

    \b
    isph klinkenberg rock.yaml --slip-lengths 0,50nm,100nm
    """
    set_threads(threads, quiet)
    from .runs import ladders

    folder = ladder_folder(case_file, out, "klinkenberg", overwrite)
    found = ladders.klinkenberg(load(case_file, overrides), slip_lengths, folder, quiet, overwrite,
                                None if quiet else complain)
    click.echo(table([("permeability", permeability(found.permeability) + " without slip"),
                      ("slope c", f"{found.slope:.{DIGITS}g} 1/m: b = c times slip length times pressure"),
                      ("results", str(folder))]))


@main.command(epilog=EXIT_CODES, short_help="Porosity and k of growing parts of an image (representative volume).")
@click.argument("case_file", metavar="CASE | IMAGE", type=click.Path(path_type=Path))
@click.option("--each", type=click.IntRange(1), default=3, show_default=True, help="Cubes of every edge.")
@ladder_options
@guarded
def rev(case_file: Path, each: int, out: Path | None, overwrite: bool, threads: int | None,
        overrides: tuple[str, ...], quiet: bool) -> None:
    """Solve growing cubes of an image, and say from which edge on porosity and permeability change no more.

    \b
    isph rev rock.yaml
    isph rev scan.tif --set geometry.voxels.voxel_size=2.25um --each 5
    """
    set_threads(threads, quiet)
    from .runs import ladders

    folder = ladder_folder(case_file, out, "rev", overwrite)
    rows = ladders.representative_volume(load(case_file, overrides), folder, each, True, None if quiet else complain)
    click.echo("voxels  edge, m     cubes  porosity            k, m2")
    for edge in sorted({row["voxels"] for row in rows}):
        of_edge = [row for row in rows if row["voxels"] == edge]
        shown = []
        for name in ("porosity", "permeability"):
            values = [row[name] for row in of_edge]
            mean = sum(values) / len(values)
            shown.append(f"{mean:.3g} ({min(values):.3g} to {max(values):.3g})")
        click.echo(f"{edge:<7d} {of_edge[0]['edge']:<11.3g} {len(of_edge):<6d} {shown[0]:<19} {shown[1]}")
    click.echo(f"results  {folder}")


# -- film ------------------------------------------------------------------------------------------------


@main.command(epilog=EXIT_CODES, short_help="A film of the snapshots of a run, gif or mp4.")
@click.argument("folder", metavar="OUT", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--to", "target", type=click.Path(path_type=Path, dir_okay=False), default="film.gif", metavar="FILE",
              show_default=True, help="The film: .gif, or .mp4 (needs imageio[ffmpeg]).")  # fmt: skip
@click.option("--rate", type=click.FloatRange(0, 50, min_open=True), default=10.0, show_default=True,
              help="Frames a second.")  # fmt: skip
@click.option("--view", type=click.Choice(["plane", "3d"]), default="plane", show_default=True,
              help="The middle plane, or rock cut open.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace FILE where it exists.")
@quiet_option
@guarded
def film(folder: Path, target: Path, rate: float, view: str, force: bool, quiet: bool) -> None:
    """Make a film of the snapshots of the run in OUT: of two fluids where each of them is, of one its speed.

    One frame per snapshot: `output.every` of the case says how often one is taken.

    \b
    isph film out/rock_drainage
    isph film out/rock_drainage --to drainage.mp4 --rate 20 --view 3d
    """
    may_write(target, force)
    set_threads(None)
    from .runs.film import make_film

    def seen(number: int, total: int) -> None:
        if number == total or number % 10 == 0:
            complain(f"frame {number} of {total}")

    click.echo(f"{target} written, {make_film(folder, target, rate, view, None if quiet else seen)} frames")


# -- keys ------------------------------------------------------------------------------------------------


@main.command(epilog=EXIT_CODES)
@click.argument("words", metavar="[NAME | WORD...]", nargs=-1)
@click.option("--schema", is_flag=True, help="Print the JSON schema of a case, for editors.")
@guarded
def keys(words: tuple[str, ...], schema: bool) -> None:
    """List the keys of a case, or find them.

    What is no name of a key or block is looked for in the names, their choices and explanations; of several words
    all have to be there.

    \b
    isph keys
    isph keys particles
    isph keys geometry.voxels.labels
    isph keys gravity
    isph keys contact angle
    """
    from .case.docs import keys_page, schema_text

    if schema:
        click.echo(schema_text(), nl=False)
        return
    known = list(documented_keys(keys_page()))
    asked = " ".join(words)
    found = [cells for cells in known if stands_below(asked, cells[0])]
    if not found:
        found = [cells for cells in known if all(word.lower() in " ".join(cells).lower() for word in words)]
        if not found:
            near = nearest_word(asked, known)
            raise Unusable(
                f"{asked}: no key has this name, and none speaks of it; "
                + (f"did you mean {near!r}?" if near else "`isph keys` lists all")
            )
        complain(f"{len(found)} of {len(known)} keys speak of {asked!r}:")
    for path, value, default, meaning in found:
        facts = [value] + (
            [f"default {default}"] if default.startswith(("`", '"')) else [default] * bool(default)
        )
        click.echo(f"{path}  ({', '.join(facts).replace('*', '').replace('`', '')})\n    {meaning}")


def nearest_word(text: str, known: Iterable[Sequence[str]]) -> str | None:
    """The known name that is spelt most like a text: a path if it has dots, else the name of a key or a word."""
    from difflib import get_close_matches

    paths = {cells[0].replace("[]", "").replace("<name>.", ""): cells[0] for cells in known}
    words = {name for path in paths for name in path.split(".")}
    words |= {word.lower() for cells in known for word in re.findall(r"[A-Za-z_]{4,}", " ".join(cells))}
    near = get_close_matches(text, paths if "." in text else sorted(words), 1, 0.75)
    return paths.get(near[0], near[0]) if near else None


def documented_keys(page: str) -> Iterable[list[str]]:
    """[path, value, default, meaning] of each key of docs/keys.md."""
    block = ""
    for line in page.splitlines():
        if line.startswith("## "):
            block = line.strip("#` ") + "." if "`" in line else ""
        elif line.startswith("| `"):
            cells = re.split(r" (?<!\\)\| ", line.strip("| "))
            yield [block + cells[0].strip("`"), *(c.replace("\\|", "|").strip() for c in cells[1:])]


def stands_below(name: str, path: str) -> bool:
    """Whether the documented path `fluids.<name>.density` is at or below `fluids.water`."""
    asked = [part for part in name.split(".") if part and not part.isdigit()]
    parts = path.replace("[]", "").split(".")
    return len(asked) <= len(parts) and all(a == p or p == "<name>" for a, p in zip(asked, parts))


if __name__ == "__main__":
    main()
