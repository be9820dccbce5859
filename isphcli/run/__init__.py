"""From a case to its results. `isphcli.run(case)` runs one: see `isphcli.api.run`."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..api import RunResult


class _Room(ModuleType):
    """This package, which can be called: `isphcli.run` is the name of the function for users, and Python gives it to
    this package, too, as soon as a module of it is imported."""

    def __call__(self, *args: Any, **options: Any) -> RunResult:
        from .. import api

        return api.run(*args, **options)


sys.modules[__name__].__class__ = _Room
