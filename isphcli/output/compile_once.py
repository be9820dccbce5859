"""Of several processes on a machine one compiles a kernel; the others wait for it and load what it has left.

All of them come to the same kernels at the same time, and each would compile all of them: N processes would share the
cores for N times the work.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from .environment import private_folder


def compile_once(lock: Path | None = None) -> None:
    """Lets numba compile what is not in its cache only while this process has a file locked. lock: that file, by
    default one of this user on this machine. Does nothing where files cannot be locked (Windows)."""
    try:
        import fcntl

        from numba.core.compiler_lock import global_compiler_lock
        from numba.core.dispatcher import Dispatcher
    except ImportError:  # the latter two are no part of numba's interface
        return
    path, usual, held = lock or private_folder() / "compile.lock", Dispatcher.compile, list[int]()
    if hasattr(usual, "alone"):
        return

    @contextlib.contextmanager
    def locked() -> Iterator[None]:
        held.append(1)  # what a kernel calls is compiled within it
        try:
            with open(path, "w", encoding="utf-8") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                yield
        finally:
            held.pop()

    def compile_alone(self: Any, signature: Any) -> Any:
        # numba's own lock first, as always: the threads of a process never wait for each other in two orders
        with global_compiler_lock:
            if held or _is_known(self, signature):
                return usual(self, signature)
            with locked():
                return usual(self, signature)  # it looks into the cache again

    compile_alone.alone = usual  # type: ignore[attr-defined]
    Dispatcher.compile = compile_alone  # type: ignore[method-assign, assignment]


def _is_known(kernel: Any, signature: Any) -> bool:
    """Whether a kernel need not be compiled for a signature: processes that only load must not wait for each other."""
    find: Callable[..., Any] | None = getattr(kernel._cache, "_index_key", None)
    if find is None:  # not to be kept: an overload without a cache, compiled in a moment
        return True
    try:
        key = find(signature, kernel.targetctx.codegen())
        return key in kernel._cache._cache_file._load_index()
    except (AttributeError, OSError, TypeError):  # another version of numba, a cache that cannot be read
        return False
