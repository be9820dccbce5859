"""isphcli: flow through rock and other complex solids by consistent implicit incompressible SPH.

In Python (docs/python.md): `isphcli.run(case)`, `isphcli.permeability(image, voxel_size=...)`,
`isphcli.load_case(...)`. No numerical library is imported before one of them is called.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import RunResult, load_case, permeability, run

    __version__: str

__all__ = ["COMPLETE", "RunResult", "__version__", "load_case", "permeability", "run"]

COMPLETE = ("finished", "steady")  # status of a run that has what was asked for


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name in __all__:
        from . import api

        return getattr(api, name)
    raise AttributeError(f"module 'isphcli' has no attribute {name!r}")


def _version() -> str:
    """The version that was installed, which pyproject.toml has from the tags of git."""
    from importlib import metadata

    try:
        return metadata.version("isphcli")
    except metadata.PackageNotFoundError:  # a copy of the source that was not installed
        return "unknown"


def __dir__() -> list[str]:
    return sorted(__all__)
