"""Writes the files generated from the case language: `docs/keys.md` and `docs/case.schema.json`.

Run `python -m isphcli.case.docs` after a change of the language; a test compares the files.
"""

from __future__ import annotations

import json
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from . import units
from .blocks import Case, plain
from .reader import Declared, Key, Table, describe, is_block, keys_of, options

DOCS = Path(__file__).parents[2] / "docs"
_JSON_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string", Path: "string"}
_INTRODUCTION = """\
# Keys of a case

Generated from `isphcli/case/blocks.py` by `python -m isphcli.case.docs`: do not edit.

A case is a YAML file of nested blocks. A block that is absent switches its physics off. Bare numbers are in the unit
that stands in the table (SI), or in any consistent set; a number with a unit is converted to that of its key:
`voxel_size: 2.25 um`, `viscosity: 1 cP`, `tension: 30 mN/m`, `pressure_drop: {x: 1 kPa}`. Every key can be set on the
command line, `--set particles.spacing=1e-5`; items of lists go by their number, `--set
geometry.shapes.0.sphere.radius=0.1`; `null` stands for an absent key. Paths of inputs start from the directory of the
case file, `output.directory` from the working directory. `docs/case.schema.json` gives editors completion and checks:
put `# yaml-language-server: $schema=<path to it>` at the head of the file.
"""


def keys_page() -> str:
    """The page of keys, Markdown."""
    sections = [_INTRODUCTION, *(_section(path, cls) for path, cls in _blocks(Case, ""))]
    return "\n".join(sections)


def schema() -> dict[str, Any]:
    """The JSON schema (2020-12) of a case."""
    definitions = {cls.__name__: _object(cls) for _, cls in _blocks(Case, "")}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "isph case",
        **definitions.pop("Case"),
        "$defs": definitions,
    }


def schema_text() -> str:
    """The schema as it is written to its file."""
    return json.dumps(schema(), indent=1) + "\n"


def generated() -> dict[Path, str]:
    """The text that each generated file should have."""
    return {
        DOCS / "keys.md": keys_page(),
        DOCS / "case.schema.json": schema_text(),
    }


def _blocks(cls: type, path: str) -> Iterator[tuple[str, type]]:
    """Each block of the language and where it stands, outer ones first."""
    yield path, cls
    for declared in keys_of(cls).values():
        child, suffix = _block_in(declared.hint)
        if child is not None:
            yield from _blocks(child, f"{path}.{declared.name}{suffix}".lstrip("."))


def _block_in(hint: Any) -> tuple[type | None, str]:
    """The block that a type holds and how its place is written: `.<name>` or `[]` below the key."""
    for option in options(hint):
        if is_block(option):
            return option, ""
        origin, args = typing.get_origin(option), typing.get_args(option)
        if origin in (Table, tuple) and is_block(args[0]):
            return args[0], ".<name>" if origin is Table else "[]"
    return None, ""


def _section(path: str, cls: type) -> str:
    heading = f"## `{path}`" if path else "## The case"
    one_of = getattr(cls, "ONE_OF", ())
    lines = [heading, "", str(cls.__doc__), ""]
    if one_of:
        lines += [f"Exactly one of {', '.join(f'`{name}`' for name in one_of)}.", ""]
    lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
    lines += [_row(declared, one_of) for declared in keys_of(cls).values()]
    return "\n".join(lines) + "\n"


def _row(declared: Declared, one_of: tuple[str, ...]) -> str:
    spec = declared.spec
    value = " \\| ".join(spec.choices) if spec.choices else describe(declared.hint, spec)
    if spec.choices and "list" in describe(declared.hint, spec):
        own_word = str in options(declared.hint)  # beside the list, not in it
        value = describe(declared.hint, spec).replace("text", value) if own_word else f"list of {value}"
    value += "".join(f", {part}" for part in (spec.unit, *_bounds_in_words(spec)) if part)
    if declared.required:
        default = "**required**"
    elif declared.name in one_of:
        default = "one of"
    else:
        default = "" if declared.default is None else f"`{json.dumps(plain(declared.default))}`"
    if is_block(declared.hint):
        default = "**required**" if declared.required else ""
    return f"| `{declared.name}` | {value} | {default} | {spec.doc} |"


def _bounds_in_words(spec: Key) -> Iterator[str]:
    for sign, limit in ((">", spec.above), ("≥", spec.at_least), ("<", spec.below), ("≤", spec.at_most)):
        if limit is not None:
            yield f"{sign} {limit:g}"


def _object(cls: type) -> dict[str, Any]:
    keys = keys_of(cls)
    block: dict[str, Any] = {
        "description": cls.__doc__,
        "type": "object",
        "properties": {name: _property(declared) for name, declared in keys.items()},
        "required": [name for name, declared in keys.items() if declared.required],
        "additionalProperties": False,
    }
    if one_of := getattr(cls, "ONE_OF", ()):
        block["oneOf"] = [{"required": [name]} for name in one_of]
    return block


def _property(declared: Declared) -> dict[str, Any]:
    spec = declared.spec
    description = f"{spec.doc} [{spec.unit}]" if spec.unit else spec.doc
    value = {"description": description, **_type(declared.hint, spec)}
    if not declared.required and declared.default is not None:
        value["default"] = plain(declared.default)
    return value


def _type(hint: Any, spec: Key) -> dict[str, Any]:
    alternatives = [_option(option, spec) for option in options(hint)]
    return alternatives[0] if len(alternatives) == 1 else {"anyOf": alternatives}


def _option(hint: Any, spec: Key) -> dict[str, Any]:
    if hint is type(None):
        return {"type": "null"}
    if is_block(hint):
        return {"$ref": f"#/$defs/{hint.__name__}"}
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if spec.part_of is not None:
        return {"type": "object", "propertyNames": {"enum": list(keys_of(spec.part_of))}}
    if origin is Table:
        table = {"type": "object", "additionalProperties": _type(args[0], spec)}
        return table | ({"propertyNames": {"enum": list(spec.names)}} if spec.names else {})
    if origin is tuple:
        return _array(args, spec)
    if spec.choices and hint is str:
        return {"enum": list(spec.choices)}
    if spec.formula:
        return {"type": ["string", "number"]}
    if hint is float and spec.unit:
        return {"type": ["number", "string"], "pattern": f"^{units.NUMBER}\\s*{units.UNIT}$", **_bounds(spec)}
    return {"type": _JSON_TYPES[hint], **(_bounds(spec) if hint in (int, float) else {})}


def _array(args: tuple[Any, ...], spec: Key) -> dict[str, Any]:
    item = _type(args[0], spec)
    lengths = spec.lengths if args[-1] is Ellipsis else (len(args),)
    if spec.per_axis:
        lengths = (2, 3)
    if typing.get_origin(args[0]) is tuple:
        item = _array(typing.get_args(args[0]), spec)
    array: dict[str, Any] = {"type": "array", "items": item}
    if lengths:
        array |= {"minItems": min(lengths), "maxItems": max(lengths)}
    if spec.unique:
        array["uniqueItems"] = True
    return {"anyOf": [item, array]} if spec.single else array


def _bounds(spec: Key) -> dict[str, float]:
    words = {
        "exclusiveMinimum": spec.above,
        "minimum": spec.at_least,
        "exclusiveMaximum": spec.below,
        "maximum": spec.at_most,
    }
    return {word: limit for word, limit in words.items() if limit is not None}


def main() -> None:
    """Writes the generated files over the old ones and prints their paths."""
    for path, text in generated().items():
        path.write_text(text, encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
