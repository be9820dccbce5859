"""Reads, completes and writes a case.

The blocks are declared in `blocks`. A `None` that the case itself can decide (`support`, `lattice`,
`output.directory`, ...) is filled in by `load_case`; the properties of `Case` decide it for cases that were
made in Python.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from .blocks import Case, plain
from .reader import Reader
from .yaml import MAX_BYTES, CaseError, Problem, ProblemList, Where, override, parse


def load_case(path: str | Path, overrides: Sequence[str] = ()) -> Case:
    """Read a case file, with the `key.sub=value` of each `--set` put in.

    Raises `CaseError` with everything that is wrong with it.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        if Path(path).is_dir():
            reason = "is a folder; name the case.yaml in it, or give --restart to go on with a run of moving particles"
        raise CaseError((Problem(str(path), None, "", f"cannot be read: {reason}"),)) from None
    return read_case(data, path, overrides)


def read_case(data: bytes, path: str | Path, overrides: Sequence[str] = ()) -> Case:
    """As `load_case`, from the bytes of the file; `path` is for messages and relative paths."""
    from .checks import check_case

    problems = ProblemList()
    root = parse(data, Where(str(path), 1), problems)
    if root is not None:
        for text in overrides:
            override(root, text, problems)
        source = Path(path).absolute()
        reader = Reader(source.parent, problems)
        case = reader.read(Case, root)
        if case is not None:
            case = replace(case, path=source, places=reader.places)
            check_case(case, problems)
    problems.raise_if_any()
    return case.completed()


def dump_case(case: Case) -> str:
    """The case as YAML, defaults filled in and what is absent left out; `load_case` reads it back."""
    return yaml.safe_dump(
        plain(case), sort_keys=False, allow_unicode=True, default_flow_style=None, width=110
    )
