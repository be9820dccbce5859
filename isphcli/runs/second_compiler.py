"""Compiles kernels in a second process, while the run compiles too.

A kernel that another process has put into numba's cache is loaded in 10 ms. The run compiles kernels in the order in
which it needs them; the second process goes through the same ones from the last to the first, of a list that
`benchmarks/kernel_list.py` makes from runs (isphcli/data/kernels.txt). A kernel that is not on the list, or is compiled
for other types by now, is compiled by the run: what may be lost is time.
"""

from __future__ import annotations

import ast
import gc
import hashlib
import os
import pkgutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import types
from numba.core import config
from numba.np.numpy_support import from_dtype

from ..case.blocks import SOLID
from ..domain.communicator import current

try:
    from numba.core.caching import IndexDataCacheFile
except ImportError:  # no part of numba's interface
    IndexDataCacheFile = None  # type: ignore[assignment, misc]

if TYPE_CHECKING:
    from ..case.blocks import Case

LIST = Path(__file__).parents[1] / "data/kernels.txt"
NICE = 5  # steps of priority below the run, so that other programs come first
_begun: set[str] = set()  # scenes of this process: what its first run has not found listed, the second will not either


def scene_of(case: Case) -> str:
    """What decides which kernels a run needs: its flow, its fluids, its walls."""
    solids = any(shape.what == SOLID for shape in case.geometry.shapes)
    walls = solids or len(case.geometry.repeats) < (case.dim or 0)
    kind = case.wall_distance if walls or case.geometry.voxels else "free"
    return f"{case.flow} {'one' if len(case.fluids) == 1 else 'two'} {kind}"


@contextmanager
def second_compiler(scene: str) -> Iterator[Callable[[], None]]:
    """Yields what starts the second process, to be called when the first kernel is missing in the cache; the process
    ends with the block, or with this process, however that ends."""
    begun: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        if scene in _begun or not _numba_is_known():
            return
        _begun.add(scene)
        IndexDataCacheFile.save = save  # type: ignore[method-assign]
        if _cores() < 2 or current().size > 1 or not sys.executable:
            return
        quiet = subprocess.DEVNULL
        with suppress(OSError):  # -P: no modules of the folder in which the run was begun
            begun.append(subprocess.Popen([sys.executable, "-P", "-m", __name__, scene], stdin=subprocess.PIPE,
                                          stdout=quiet, stderr=quiet, env=_environment()))

    try:
        yield start
    finally:
        for process in begun:
            process.kill()
            process.communicate()


def _environment() -> dict[str, str]:
    """Of the second process: it finds modules where this one does, and the same cache."""
    cache = config.CACHE_DIR  # type: ignore[attr-defined]
    path = os.pathsep.join(str(folder or os.getcwd()) for folder in sys.path)
    return {**os.environ, **({"NUMBA_CACHE_DIR": cache} if cache else {}), "PYTHONPATH": path}


def _numba_is_known() -> bool:
    """Whether numba has what `save` is made of, which is no part of its interface: another version may not."""
    names = ("save", "_data_name", "_save_data", "_save_index", "_load_index")
    return all(hasattr(IndexDataCacheFile, name) for name in names)


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def save(self: Any, key: Any, data: Any) -> None:
    """`IndexDataCacheFile.save` for processes that write at the same time. numba numbers the files of a function and
    writes their list first: two processes could give two kernels one number, or read an older kernel under a new one.
    Here a file is named after its key and is there before it is listed; the worst is that one misses in the list. A
    cache that is full misses kernels too: they are compiled, and the run goes on."""
    name = self._data_name(int.from_bytes(hashlib.sha256(repr(key).encode()).digest()[:6]))
    with suppress(OSError):
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})


# -- the list ----------------------------------------------------------------------------------------------


def listed(scene: str, path: Path = LIST) -> Iterator[tuple[Any, tuple[types.Type, ...]]]:
    """(kernel, types of its arguments) of a scene, from the last to the first that a run needs. Lines of the list:
    `scene LETTER WORDS`, `tuple NAME MODULE CLASS TYPES` of a namedtuple, `kernel LETTERS MODULE NAME TYPES`."""
    named: dict[str, list[str]] = {}
    kernels, letter = [], "?"
    for line in path.read_text(encoding="utf-8").splitlines():
        what, word, rest = line.split(" ", 2)
        if what == "scene" and rest == scene:
            letter = word
        if what == "kernel" and letter in word:
            kernels.append(rest.split(" ", 2))
        if what == "tuple":
            named[word] = rest.split(" ", 2)
    for module, name, text in reversed(kernels):
        yield _ours(module, name), _types(text, named)


def _ours(module: str, name: str) -> Any:
    """What a module of this package holds; no code here depends on it."""
    return pkgutil.resolve_name(f"{__package__.partition('.')[0]}.{module}:{name}")


def _types(text: str, named: Mapping[str, Sequence[str]]) -> tuple[types.Type, ...]:
    """Of text such as `(int64, float64[2, C], (bool, T5,),)`; named: module, class and types of namedtuples, which are
    imported where they are asked for."""
    return tuple(_type(node, named) for node in ast.parse(text, mode="eval").body.elts)  # type: ignore[attr-defined]


def _type(node: ast.expr, named: Mapping[str, Sequence[str]]) -> types.Type:
    match node:
        case ast.Name(id=name) if name in named:
            module, cls, text = named[name]
            return types.BaseTuple.from_types(_types(text, named), _ours(module, cls))
        case ast.Name(id=name):
            return from_dtype(np.dtype(name))
        case ast.Tuple(elts=parts):
            return types.BaseTuple.from_types([_type(part, named) for part in parts])
        case ast.Subscript(value=ast.Name(id=name), slice=ast.Tuple(elts=[ast.Constant(value=int(dim)),
                                                                          ast.Name(id=layout), *readonly])):
            kind: Any = types.Array
            return kind(from_dtype(np.dtype(name)), dim, layout, readonly=bool(readonly))
    raise ValueError(ast.unparse(node))


def main(scene: str) -> None:
    """Compiles what is listed of a scene, until the process that started this one closes its pipe."""
    threading.Thread(target=lambda: (sys.stdin.buffer.read(), os._exit(0)), daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(NICE)
    gc.disable()
    IndexDataCacheFile.save = save  # type: ignore[method-assign]
    try:
        for kernel, arguments in listed(scene):
            with suppress(Exception):  # a line of an older list: the run compiles that kernel
                kernel.compile(arguments)
    finally:
        os._exit(0)  # as the thread does: it holds the lock of the pipe, and Python ends by SIGABRT where one is held


if __name__ == "__main__":
    main(sys.argv[1])
