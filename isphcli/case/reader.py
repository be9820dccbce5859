"""Reads a tree of YAML nodes into the frozen dataclasses that declare a language.

It does not depend on the content of the language: a block is a dataclass, its keys are the fields declared with
`key(...)`, and all that can be checked of a single value (type, bounds, choices, spelling) is checked here.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
import re
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from . import expressions, units
from .yaml import Node, ProblemList, Where, as_key, shown

V = TypeVar("V")
_NUMBER = re.compile(r"[-+]?([0-9][0-9_]*(\.[0-9_]*)?|\.[0-9][0-9_]*)([eE][-+]?[0-9]+)?")
_BOOLS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
_SCALARS = (bool, int, float, str, Path)  # the order in which a union of them is tried
_MAX_INT = 2**53  # largest integer up to which all are exact in double precision


@dataclass(frozen=True, kw_only=True)
class Key:
    """The declaration of a key, besides its type and default."""

    doc: str
    unit: str = ""
    name: str = ""  # in the file, where Python reserves the word
    choices: tuple[str, ...] = ()
    names: tuple[str, ...] = ()  # of the entries of a Table
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    lengths: tuple[int, ...] = ()  # that a list may have
    per_axis: bool = False  # a list with one entry an axis
    single: bool = False  # one value stands for a list of one
    unique: bool = False
    formula: tuple[str, ...] = ()  # text is one for `expressions`, of these variables
    input: bool = False  # a file that must exist
    folder: bool = False  # which may be a folder
    part_of: type | None = None  # a block, of which any keys may be given and none is needed; read as a Table


def key(doc: str, *, default: Any = MISSING, factory: Any = MISSING, **spec: Any) -> Any:
    """A dataclass field that is a key of the language; without a default it is required."""
    return dataclasses.field(default=default, default_factory=factory, metadata={"key": Key(doc=doc, **spec)})


class Table(Mapping[str, V], Generic[V]):
    """A mapping that cannot change, keeps its order and can be hashed."""

    __slots__ = ("_entries",)

    def __init__(self, entries: Mapping[str, V] | Iterable[tuple[str, V]] = ()):
        self._entries = dict(entries)

    def __getitem__(self, name: str) -> V:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Table) and tuple(self.items()) == tuple(other.items())

    def __hash__(self) -> int:
        return hash(tuple(self.items()))

    def __repr__(self) -> str:
        return f"Table({self._entries!r})"


@dataclass(frozen=True)
class Declared:
    """One key of a block: its name in the file and in Python, its type and the arguments of `key`."""

    name: str
    attribute: str
    hint: Any
    spec: Key
    default: Any  # MISSING if required

    @property
    def required(self) -> bool:
        """Whether a case must state it."""
        return self.default is MISSING


@cache
def keys_of(cls: Any) -> dict[str, Declared]:
    """The keys of a block by their name in the file, in the order of declaration."""
    hints = typing.get_type_hints(cls)
    declared = {}
    for field in dataclasses.fields(cls):
        spec = field.metadata.get("key")
        if spec is None:
            continue
        default = field.default if field.default_factory is MISSING else field.default_factory()
        name = spec.name or field.name
        declared[name] = Declared(name, field.name, hints[field.name], spec, default)
    return declared


def options(hint: Any) -> tuple[Any, ...]:
    """The alternatives of a union, otherwise the type itself."""
    return typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)


def is_block(hint: Any) -> bool:
    """Whether a type is a block with keys of its own."""
    return dataclasses.is_dataclass(hint)


def describe(hint: Any, spec: Key) -> str:
    """A type in words, for messages and for the documentation."""
    return " or ".join(_describe(option, spec) for option in options(hint) if option is not type(None))


def _describe(hint: Any, spec: Key) -> str:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple:
        if args[-1] is not Ellipsis:
            return f"list of {len(args)} {_plural(_describe(args[0], spec))}"
        item = describe(args[0], spec)
        return f"{item} or list of {_plural(item)}" if spec.single else f"list of {_plural(item)}"
    if origin is Table:
        return "block" if spec.part_of else f"block of name: {describe(args[0], spec)}"
    if hint is str and spec.formula:
        return "formula"
    words = {bool: "true or false", int: "whole number", float: "number", str: "text", Path: "file path"}
    return words.get(hint, "block")


def _plural(noun: str) -> str:
    words = (re.sub(r"^(list|block|whole number|number|formula|text)\b", r"\1s", word) for word in noun.split(" or "))
    return " or ".join(words)


class _Bad(Exception):
    """A value is wrong and has been reported."""


class Reader:
    """Reads one tree; `places` then holds the file and line of each dotted path.

    A value with a problem becomes None, so that the rest can still be read and checked.
    """

    def __init__(self, directory: Path, problems: ProblemList):
        self.directory = directory  # that relative paths of inputs start from
        self.problems = problems
        self.places: dict[str, Where] = {}

    def read(self, cls: type, root: Node) -> Any:
        """The whole tree as a `cls`, or None; what is wrong with it is in the problems."""
        try:
            return self.block(cls, Node({}, root.where) if root.is_null or root.is_empty else root)
        except _Bad:
            return None

    def block(self, cls: type, node: Node, path: str = "") -> Any:
        """An instance of the dataclass `cls`; what is wrong with it is in the problems."""
        self.places[path] = node.where
        if not isinstance(node.value, dict):
            raise self._bad(node, path, f"expected a block of keys, found {_found(node)}")
        declared = keys_of(cls)
        children = node.entries
        meant = {self._unknown(n, node, path, declared, "key") for n in children if n not in declared}
        values = {}
        for d in declared.values():
            child = children.get(d.name)
            values[d.attribute] = None if d.required else d.default
            if child is not None and child.is_null and not d.required:
                self.places[_join(path, d.name)] = child.where  # as if the key was not there
            elif child is not None:
                values[d.attribute] = self._attempt(d.hint, child, _join(path, d.name), d.spec)
            elif d.required:
                self._missing(d, node, path, said=d.name in meant)
        self._one_of(cls, children, meant, node.where, path)
        return cls(**values)

    def _part(self, cls: type, node: Node, path: str) -> Table:
        """The keys of a block that are given, as they are in a `cls`; blocks in it are parts too, null is None."""
        declared = keys_of(cls)
        values: dict[str, Any] = {}
        for name, child in node.entries.items():
            if name not in declared:
                self._unknown(name, node, path, declared, "key")
            elif child.is_null:
                values[name] = None
            else:
                hint, spec = declared[name].hint, declared[name].spec
                inner = next((option for option in options(hint) if is_block(option)), None)
                if inner is not None:
                    spec = dataclasses.replace(spec, part_of=inner)
                values[name] = self._attempt(hint, child, _join(path, name), spec)
        return Table(values)

    def _missing(self, declared: Declared, node: Node, path: str, said: bool) -> None:
        """Report a required key, unless the message about an unknown one has already named it."""
        child_path = _join(path, declared.name)
        if said:
            self.problems.broken.add(child_path)
        else:
            self.problems.add(node.where, child_path, "missing", _summary(declared.spec))

    def _one_of(self, cls: type, children: dict[str, Node], meant: set, where: Where, path: str) -> None:
        names: tuple[str, ...] = getattr(cls, "ONE_OF", ())
        # an empty block says nothing: `labels: {}` stands in the case.yaml of a run of a grey image
        given = [name for name in names
                 if name in children and not children[name].is_null and children[name].value != {}]
        if len(given) > 1:
            self.problems.add(where, path, f"{' and '.join(given)} exclude each other", "keep one of them")
        elif names and not given and not meant.intersection(names):
            self.problems.add(where, path, f"needs one of {', '.join(names)}")

    def _attempt(self, hint: Any, node: Node, path: str, spec: Key) -> Any:
        try:
            return self._value(hint, node, path, spec)
        except _Bad:
            return None

    def _value(self, hint: Any, node: Node, path: str, spec: Key) -> Any:
        """The value of a node as `hint` declares it; raises `_Bad` after reporting what is wrong."""
        self.places[path] = node.where
        alternatives = options(hint)
        if node.is_null and type(None) in alternatives:
            return None
        if node.is_null or node.is_empty:
            raise self._bad(node, path, "has no value", "give one or remove the key")
        if isinstance(node.value, dict):
            return self._mapping(hint, node, path, spec)
        if isinstance(node.value, list):
            return self._list(hint, node, path, spec)
        return self._scalar(hint, node, path, spec)

    def _mapping(self, hint: Any, node: Node, path: str, spec: Key) -> Any:
        if spec.part_of is not None:
            return self._part(spec.part_of, node, path)
        for option in options(hint):
            if is_block(option):
                return self.block(option, node, path)
            if typing.get_origin(option) is Table:
                return self._table(option, node, path, spec)
        raise self._bad(node, path, f"expected {describe(hint, spec)}, found a block")

    def _table(self, hint: Any, node: Node, path: str, spec: Key) -> Table:
        (item,) = typing.get_args(hint)
        entries = {}
        for name, child in node.entries.items():
            if spec.names and name not in spec.names:
                self._unknown(name, node, path, spec.names, "name")
            else:
                entries[name] = self._attempt(item, child, _join(path, as_key(name)), spec)
        return Table(entries)

    def _list(self, hint: Any, node: Node, path: str, spec: Key) -> tuple:
        option = next((o for o in options(hint) if typing.get_origin(o) is tuple), None)
        if option is None:
            raise self._bad(node, path, f"expected {describe(hint, spec)}, found a list")
        args = typing.get_args(option)
        lengths = spec.lengths if args[-1] is Ellipsis else (len(args),)
        if lengths and len(node.items) not in lengths:
            wanted = " or ".join(map(str, lengths))
            raise self._bad(node, path, f"expected {wanted} entries, found {len(node.items)}")
        inner = dataclasses.replace(spec, lengths=())
        found = [self._attempt(args[0], n, f"{path}.{i}", inner) for i, n in enumerate(node.items)]
        if any(value is None for value in found):
            raise _Bad
        if spec.unique and len(set(found)) < len(found):
            raise self._bad(node, path, "an entry is given twice", "keep one of them")
        return tuple(found)

    def _scalar(self, hint: Any, node: Node, path: str, spec: Key) -> Any:
        kinds = [kind for kind in _SCALARS if kind in options(hint)]
        measured = bool(spec.unit) and units.is_quantity(node.text)
        if str in kinds and _number(node.text) is None and not (float in kinds and measured):
            kinds = [str]
        if kinds:
            return getattr(self, _CONVERT[kinds[0]])(node, path, spec)
        if spec.single:
            return self._list(hint, Node([node], node.where), path, spec)
        raise self._bad(node, path, f"expected {describe(hint, spec)}, found {_found(node)}")

    def _bool(self, node: Node, path: str, spec: Key) -> bool:
        value = _BOOLS.get(node.text.lower()) if node.plain else None
        if value is None:
            raise self._bad(node, path, f"expected true or false, found {_found(node)}")
        return value

    def _int(self, node: Node, path: str, spec: Key) -> int:
        value = self._float(node, path, spec, kind="whole number")
        if not value.is_integer() or abs(value) > _MAX_INT:
            raise self._bad(node, path, f"expected a whole number, found {_found(node)}")
        return int(value)

    def _float(self, node: Node, path: str, spec: Key, kind: str = "number") -> float:
        value = _number(node.text)
        if value is None and units.is_quantity(node.text):
            value = self._with_unit(node, path, spec)
        if value is None:
            meant = kind == "number" and node.text[:1].isdigit()  # such as 1,5 or 1e-3m: how a number is written
            fix = "write it as 0.001 or 1e-3" if meant else f"give a {kind}"
            raise self._bad(node, path, f"expected a {kind}, found {_found(node)}",
                            f"{fix}, in {spec.unit}" if spec.unit else fix)
        if not math.isfinite(value):
            raise self._bad(node, path, f"{_found(node)} is not finite")
        for limit, wrong, words in (
            (spec.above, lambda a, b: a <= b, "above"),
            (spec.at_least, lambda a, b: a < b, "at least"),
            (spec.below, lambda a, b: a >= b, "below"),
            (spec.at_most, lambda a, b: a > b, "at most"),
        ):
            if limit is not None and wrong(value, limit):
                raise self._bad(node, path, f"must be {words} {limit:g}, found {_found(node)}")
        return value

    def _with_unit(self, node: Node, path: str, spec: Key) -> float:
        if not spec.unit:
            raise self._bad(node, path, f"{_found(node)} has a unit, and this number has none", "give the number alone")
        try:
            return units.number_in(node.text, spec.unit)
        except units.UnitError as error:
            fix = f"give it in {spec.unit} or a unit of the same kind, such as {_example(spec.unit)}"
            if spec.formula:
                fix += f"; a formula has a sign between its parts (2*{spec.formula[0]})"
            raise self._bad(node, path, str(error), fix) from None

    def _str(self, node: Node, path: str, spec: Key) -> str:
        text = node.text
        if spec.choices and text not in spec.choices:
            raise self._bad(node, path, f"{_found(node)} is not a choice", suggest(text, spec.choices))
        if spec.formula:
            try:
                expressions.check(text, spec.formula)
            except expressions.ExpressionError as error:
                raise self._bad(node, path, str(error)) from None
        return text

    def _path(self, node: Node, path: str, spec: Key) -> Path:
        """Inputs are relative to the case file, outputs to the working directory."""
        base = self.directory if spec.input else Path()
        value = os.path.abspath(base / node.text)
        if spec.input and not os.path.isfile(value) and not (spec.folder and os.path.isdir(value)):
            raise self._bad(node, path, f"no such file: {value}", "paths start from the case file")
        return Path(value)

    def _unknown(self, name: str, node: Node, path: str, known: Iterable[str], what: str) -> str | None:
        """Report an unknown entry of `node`; returns the name that was probably meant."""
        if self.problems.full:
            return None  # looking for similar names is not free
        self.problems.add(
            node.entries[name].where, _join(path, as_key(name)), f"unknown {what}", suggest(name, known)
        )
        return closest(name, known)

    def _bad(self, node: Node, path: str, message: str, fix: str = "") -> _Bad:
        self.problems.add(node.where, path, message, fix)
        return _Bad()


_CONVERT = {bool: "_bool", int: "_int", float: "_float", str: "_str", Path: "_path"}


def closest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is spelt most like `name`, if any is."""
    return next(iter(difflib.get_close_matches(name[:40], list(known), n=1)), None)


def suggest(name: str, known: Iterable[str]) -> str:
    """Advice on what to write instead of an unknown name."""
    known = list(known)
    near = closest(name, known)
    return f"did you mean {near!r}?" if near else f"known are {', '.join(known)}"


_EXAMPLES = {"m": "2.25 um", "m/s": "1 mm/s", "m/s2": "9.81 m/s2", "kg/m3": "1 g/cm3", "Pa s": "1 cP", "m2/s": "1 cSt",
             "N/m": "30 mN/m", "Pa": "1 kPa", "s": "5 ms", "rad/s": "10 rad/s", "degrees": "1.2 rad"}  # fmt: skip


def _example(unit: str) -> str:
    return _EXAMPLES.get(unit, f"1 {unit}")


def _number(text: str) -> float | None:
    """The number that a text stands for (maybe infinite), or None."""
    return float(text.replace("_", "")) if len(text) <= 60 and _NUMBER.fullmatch(text) else None


def _found(node: Node) -> str:
    if isinstance(node.value, str):
        return shown(node.value)
    return "a list" if isinstance(node.value, list) else "a block"


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _summary(spec: Key) -> str:
    """The purpose of a key: its doc up to the first full stop or semicolon."""
    text = "give " + re.split(r"[.;](?:\s|$)", spec.doc)[0]
    return f"{text}, in {spec.unit}" if spec.unit else text
