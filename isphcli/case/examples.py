"""The cases that come with the package, and copies of them to begin with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from .load import load_case
from .reader import Table

# of an installed package within it (pyproject.toml puts it there), of a checkout beside it
FOLDERS = (Path(__file__).parents[1] / "cases", Path(__file__).parents[2] / "cases")


class ExampleError(ValueError):
    """An example that is not there, or cannot be copied."""


def example_files() -> tuple[Path, ...]:
    """The files of all examples by name. Raises ExampleError where the package came without them."""
    for folder in FOLDERS:
        if found := tuple(sorted(folder.glob("*.yaml"))):
            return found
    raise ExampleError("the cases are missing from this installation; install isphcli again")


def example_file(name: str) -> Path:
    """The file of one example, named with or without .yaml. Raises ExampleError for an unknown name."""
    from difflib import get_close_matches

    known = {path.stem: path for path in example_files()}
    wanted = name.removesuffix(".yaml")
    if wanted in known:
        return known[wanted]
    near = get_close_matches(wanted, known, 1, 0.5)
    raise ExampleError(f"{name}: no example has this name; "
                       + (f"did you mean {near[0]!r}?" if near else "`isph examples` lists all"))


def described_examples() -> list[tuple[str, str]]:
    """(name, title) of each example."""
    return [(path.stem, load_case(path).title) for path in example_files()]


def copy_example(name: str, folder: Path) -> list[Path]:
    """Copies an example and the data that it reads into a folder, which is made; the files, the case first.

    Raises ExampleError, before anything is written, where a file of these names is there already.
    """
    source = example_file(name)
    data = [path for path in _inputs(load_case(source))]
    pairs = [(source, folder / source.name), *((p, folder / p.relative_to(source.parent)) for p in data)]
    there = [target for origin, target in pairs if target.exists() and not _same(origin, target)]
    if there:
        raise ExampleError(f"{there[0]}: is there already, and is another file; name another folder with --copy")
    for origin, target in pairs:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(origin, target)
    return [target for _, target in pairs]


def _same(one: Path, other: Path) -> bool:
    return other.is_file() and one.read_bytes() == other.read_bytes()


def _inputs(block: Any) -> Iterator[Path]:
    """Files that a case reads: every path in its blocks except the output directory and the case file itself."""
    if isinstance(block, Path):
        yield block
    elif isinstance(block, Table):
        for value in block.values():
            yield from _inputs(value)
    elif isinstance(block, tuple):
        for value in block:
            yield from _inputs(value)
    elif is_dataclass(block):
        for field in fields(block):
            if field.name not in ("path", "directory"):
                yield from _inputs(getattr(block, field.name))
