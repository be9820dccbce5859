"""Runs a case: prepares the folder of its results and calls the steady or the moving flow."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from threading import get_ident
from typing import TYPE_CHECKING, Any

from ..case.yaml import CaseError, Problem
from ..domain.communicator import current, on_first
from ..output import folder, progress, restart
from ..output.clock import Clock
from ..output.environment import one_blas_thread
from .results import Look, files_of

if TYPE_CHECKING:
    from ..case.blocks import Case
    from ..references.result import Result


def run_case(case: Case, quiet: bool = False, resume: str | Path | None = None, overwrite: bool = False,
             look: Look | None = None) -> dict[str, Any]:
    """As `solve_case`; returns the summary alone."""
    return solve_case(case, quiet, resume, overwrite, look)[0]


def solve_case(case: Case, quiet: bool = False, resume: str | Path | None = None, overwrite: bool = False,
               look: Look | None = None) -> tuple[dict[str, Any], Result]:
    """Runs a case and leaves its files (docs/output.md) in case.output.directory. Returns (summary, flow at the end).

    resume: directory whose restart.npz a run of moving particles goes on from.
    overwrite: replace results that the directory holds, those files that its manifest names.
    Where mpiexec started several processes (`domain.communicator.join`) all of them call it; the files are written by
    rank 0 but for the snapshots, and the flow that is returned is that of the particles of each.
    look: preflight.look.look, which prints the warnings of the check of the case before anything is solved (in the
    summary as `warnings`); None: no check.

    Raises ValueError (CaseError, VoxelError, ShapeError, ParticleError, NoFlowError, FolderError, RestartError) for a
    case that cannot run, before anything is written; SolveError, StepError or RunError for one that had to stop.
    """
    assert case.output.directory is not None
    directory = Path(case.output.directory)
    if resume is not None:
        if case.flow == "stokes":
            raise CaseError((Problem(*case.place_of("flow"), "flow", "a steady solve has nothing to go on from",
                                     "run it without --restart"),))
        restart.require(Path(resume) / restart.NAME)
    goes_on = resume is not None and Path(resume).resolve() == directory.resolve()
    with ExitStack() as held:
        name = str(case.path) if case.path else None
        place = folder.Folder(directory, files_of(case), name, goes_on, overwrite)
        on_first(lambda: bool(held.enter_context(place)))
        if current().size > 1:  # the check reads the whole image
            look, quiet = None, quiet or current().rank > 0
        with one_blas_thread():
            return _run(case, quiet, resume, look)


def _run(case: Case, quiet: bool, resume: str | Path | None, look: Look | None) -> tuple[dict[str, Any], Result]:
    clock = Clock()
    with clock("compile"):
        from .second_compiler import scene_of, second_compiler
    with second_compiler(scene_of(case)) as second, _compile_listener(clock, second):
        if case.flow == "stokes":
            with clock("compile"):  # imports only what the flow needs
                from .steady_case import run_steady
            return run_steady(case, clock, quiet, look)
        with clock("compile"):
            from .moving_case import run_moving
        return run_moving(case, clock, quiet, resume, look)


@contextmanager
def _compile_listener(clock: Clock, missing: Callable[[], None]) -> Iterator[None]:
    """Counts the time of the compiler as `compile`, at the cost of the section in which a kernel is first used; tells
    the display of kernels that are not in the cache, and calls `missing` then."""
    from numba.core import event

    collects, runs = gc.isenabled(), get_ident()

    class Compiling(event.Listener):
        depth = 0
        section: AbstractContextManager[None]

        def on_start(self, _: event.Event) -> None:
            if get_ident() != runs:  # threads that share a loop ask for its kernel at the same time
                return
            if self.depth == 0:
                self.section = clock("compile")
                self.section.__enter__()
            self.depth += 1

        def on_end(self, _: event.Event) -> None:
            if get_ident() != runs:
                return
            self.depth -= 1
            if self.depth == 0:
                self.section.__exit__(None, None, None)

    class NotInCache(event.Listener):
        depth = 0

        def on_start(self, _: event.Event) -> None:
            gc.disable()  # the search for cycles of references takes an eighth of the compiler's time, and finds few
            self.depth += 1
            missing()
            progress.compiling(True)

        def on_end(self, _: event.Event) -> None:
            self.depth -= 1
            if self.depth == 0 and collects:
                gc.enable()
            progress.compiling(self.depth > 0)

    with event.install_listener("numba:compiler_lock", Compiling()):
        with event.install_listener("numba:compile", NotInCache()):
            try:
                yield
            finally:
                if collects:  # the compiler may have been interrupted
                    gc.enable()
