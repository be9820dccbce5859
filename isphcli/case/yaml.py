"""YAML text -> a tree of nodes that know where they were written, and the list of problems.

The types of scalars are left to the reader, which knows what each key should be: `1e-5` is a number
where a number belongs (PyYAML reads a string), and `no` is a title where a title belongs. The tree is
built from PyYAML's event stream without recursion and within stated bounds, so that no input can
exhaust memory, time or the stack. Bytes and brackets are counted before PyYAML sees the text: its versions
have bounds of their own, and each refuses in other words. Aliases, tags and directives have no use in a
case and are refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import yaml

# Bounds of a case file, far above those of real cases: any file is refused or read in less than seconds
MAX_BYTES = 1_000_000
MAX_NODES = 100_000
MAX_DEPTH = 32
MAX_PROBLEMS = 100  # problems of a case that are listed
_TOO_DEEP = f"nested more than {MAX_DEPTH} deep"
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# characters that text may not contain: some control a terminal, others PyYAML does not write back, none has a use
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\ufeff\ud800-\udfff]")
# quoted text and comments, whose brackets open nothing; openers and closers of lists and blocks
_QUOTED = r'(?<![^\s,\[{:])(?:"(?:[^"\\]|\\.)*+"|\'(?:[^\']|\'\')*+\')'
_BRACKETS = re.compile(_QUOTED + r"|(?<!\S)#[^\n]*|(?P<open>[\[{])|(?P<close>[\]}])", re.DOTALL)
_COMPACT = re.compile(r"(?:[-?] +)*")  # `- - - x`: each opens a list, or a block
_NULLS = ("~", "null", "Null", "NULL")


class Where(NamedTuple):
    """Where something was written: a file and a line, or `--set key` and no line."""

    file: str
    line: int | None = None

    def __str__(self) -> str:
        return self.file if self.line is None else f"{self.file}:{self.line}"


@dataclass(frozen=True)
class Problem:
    """One thing wrong with a case; `key` is the dotted path, `fix` what to do about it."""

    file: str
    line: int | None
    key: str
    message: str
    fix: str = ""

    def __str__(self) -> str:
        where = str(Where(self.file, self.line))
        parts = [where] if not self.key or self.file == f"--set {self.key}" else [where, self.key]
        return ": ".join([*parts, self.message]) + (f"; {self.fix}" if self.fix else "")


class CaseError(ValueError):
    """A case that cannot be used; `problems` lists everything that is wrong with it."""

    def __init__(self, problems: tuple[Problem, ...]):
        super().__init__(problems)
        self.problems = tuple(problems)

    def __str__(self) -> str:
        return "\n".join(map(str, self.problems))


@dataclass
class ProblemList:
    """Collects the problems of one case, at most `MAX_PROBLEMS`, and the keys without a usable value."""

    problems: list[Problem] = field(default_factory=list)
    broken: set[str] = field(default_factory=set)

    @property
    def full(self) -> bool:
        """Whether further problems are no longer listed."""
        return len(self.problems) >= MAX_PROBLEMS

    def add(self, where: Where, key: str, message: str, fix: str = "") -> None:
        """Adds a problem of a key (dotted path); fix: what to do about it."""
        self.broken.add(key)
        if not self.full:
            self.problems.append(Problem(where.file, where.line, key, message, fix))

    def clear_of(self, *keys: str) -> bool:
        """True if no problem lies at, above or below any of the keys; False once problems are no longer recorded."""
        return not self.full and not any(
            bad == key or bad.startswith(key + ".") or key.startswith(bad + ".")
            for bad in self.broken
            for key in keys
        )

    def raise_if_any(self) -> None:
        """Raises CaseError with the problems in the order of the file."""
        if self.problems:
            in_order = sorted(self.problems, key=lambda p: (p.line is None, p.line or 0))
            raise CaseError(tuple(in_order))


@dataclass(slots=True)
class Node:
    """A value of the file: a dict of nodes, a list of nodes or the text of a scalar."""

    value: dict[str, Node] | list[Node] | str
    where: Where  # of the key, if it has one
    plain: bool = True  # a scalar without quotes

    @property
    def entries(self) -> dict[str, Node]:
        """Of a block; asserts that it is one."""
        assert isinstance(self.value, dict)
        return self.value

    @property
    def items(self) -> list[Node]:
        """Of a list; asserts that it is one."""
        assert isinstance(self.value, list)
        return self.value

    @property
    def text(self) -> str:
        """Of a scalar; asserts that it is one."""
        assert isinstance(self.value, str)
        return self.value

    @property
    def is_null(self) -> bool:
        """Whether the file says null; a quoted one is text."""
        return self.plain and self.value in _NULLS

    @property
    def is_empty(self) -> bool:
        """Whether nothing follows the key."""
        return self.plain and self.value == ""


def shown(text: str) -> str:
    """Text of a user in a message: quoted, without control characters, not too long."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def as_key(text: str) -> str:
    """A key of a user in a message: bare if that is readable."""
    return text if text.isprintable() and 0 < len(text) <= 40 else shown(text)


def parse(text: str | bytes, where: Where, problems: ProblemList) -> Node | None:
    """The tree of a YAML text, or None after reporting why there is none.

    A line in `where` means that lines are counted; without it (a `--set` value) all nodes have the same
    place. An empty text is an empty scalar.
    """
    if len(text) > MAX_BYTES:
        problems.add(Where(where.file), "", f"longer than {MAX_BYTES} bytes", "put long lists in a file")
        return None
    try:
        text = text.decode() if isinstance(text, bytes) else text
        _refuse_deep(text, where)
        return _Builder(where, problems).build(yaml.parse(text, Loader=_LOADER))
    except UnicodeDecodeError as error:
        newlines = error.object.count(b"\n", 0, error.start)
        problems.add(Where(where.file, newlines + 1), "", "not text", "save it as UTF-8")
    except _Refused as refused:
        problems.add(refused.where, "", *refused.args)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = None if mark is None or where.line is None else mark.line + 1
        message = ", ".join(filter(None, (error.context, error.problem)))
        fix = "indent with spaces, not tabs" if _tab_at(text, mark) else ""
        problems.add(Where(where.file, line), "", f"not YAML: {message}", fix)
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        problems.add(where, "", f"not YAML: {str(error).splitlines()[0]}")
    return None


def override(root: Node, text: str, problems: ProblemList) -> None:
    """Put the `key.sub=value` of a `--set` into the tree; blocks that are missing are made."""
    name, equals, value = text.partition("=")
    parts = name.strip().split(".")
    where = Where(f"--set {as_key(name.strip())}")
    if not equals or not all(parts):
        problems.add(where, "", "not of the form key.sub=value")
        return
    node = parse(value, where, problems)
    if node is None:
        return
    parent = root
    for depth, part in enumerate(parts):
        child = node if depth == len(parts) - 1 else _child(parent, part, where)
        if not _put(parent, part, child):
            above = as_key(".".join(parts[:depth])) if depth else "the case"
            problems.add(where, "", f"{above} has no entry {shown(part)}", _entries_of(parent))
            return
        parent = child


def _child(parent: Node, name: str, where: Where) -> Node:
    """The block or list of that name in `parent`, or a new block."""
    child = None
    if isinstance(parent.value, dict):
        child = parent.value.get(name)
    elif isinstance(parent.value, list) and name in map(str, range(len(parent.value))):
        child = parent.value[int(name)]
    return Node({}, where) if child is None or child.is_null or child.is_empty else child


def _put(parent: Node, name: str, child: Node) -> bool:
    """Make `child` the entry `name`; False if `parent` cannot have such an entry."""
    if isinstance(parent.value, dict):
        parent.value[name] = child
    elif isinstance(parent.value, list) and name in map(str, range(len(parent.value) + 1)):
        parent.value[int(name) : int(name) + 1] = [child]
    else:
        return False
    return True


def _entries_of(node: Node) -> str:
    if isinstance(node.value, list):
        return f"it is a list: use 0 to {len(node.value)}"
    return "it is a single value"


def _tab_at(text: str | bytes, mark: yaml.Mark | None) -> bool:
    lines = text.splitlines()
    if mark is None or mark.line >= len(lines):
        return False
    line = lines[mark.line]
    return "\t" in line[: len(line) - len(line.lstrip())] or line[mark.column : mark.column + 1] == "\t"


class _Refused(Exception):
    """Valid YAML that a case may not contain: (message, fix)."""

    def __init__(self, where: Where, message: str, fix: str = ""):
        super().__init__(message, fix)
        self.where = where


def _refuse_deep(text: str, where: Where) -> None:
    """Raises _Refused where more than `MAX_DEPTH` brackets or columns of indentation are open at once.

    A lower bound of the depth that YAML gives the text, far from which no library's own bound lies: the exact
    depth is counted by `_Builder`.
    """
    at = 0 if where.line is None else 1
    depth = 0
    for found in _BRACKETS.finditer(text):
        depth = max(depth + (found["open"] is not None) - (found["close"] is not None), 0)
        if depth > MAX_DEPTH:
            raise _Refused(_line(where, at and at + text.count("\n", 0, found.start())), _TOO_DEEP)
    columns: list[int] = []
    for number, line in enumerate(text.split("\n")):
        start = len(line) - len(line.lstrip(" "))
        if start == len(line) or line[start] == "#":
            continue
        while columns and columns[-1] >= start:
            columns.pop()
        compact = _COMPACT.match(line, start).group()  # type: ignore[union-attr]
        columns += [start, *(start + k + 1 for k, sign in enumerate(compact) if sign != " ")]
        if len(columns) > MAX_DEPTH + 1:  # the last one is that of a value
            raise _Refused(_line(where, at and at + number), _TOO_DEEP)


def _line(where: Where, number: int) -> Where:
    return Where(where.file, number or None)


class _Builder:
    """Builds the tree with explicit stacks for the open collections."""

    def __init__(self, where: Where, problems: ProblemList):
        self.start = where
        self.problems = problems
        self.root: Node | None = None
        self.stack: list[Node] = []
        self.keys: list[Node | None] = []  # the key that waits for its value, for each of them
        self.path: list[str] = []  # the name of each of them
        self.nodes = 0

    def build(self, events: Iterator[yaml.Event]) -> Node:
        for event in events:
            self._take(event)
        return self.root or Node("", self.start)

    def _take(self, event: yaml.Event) -> None:
        where = self._where(event)
        if isinstance(event, yaml.AliasEvent):
            raise _Refused(where, "aliases (*name) are not used in cases", "write the value out")
        if getattr(event, "tag", None) not in (None, "!"):
            raise _Refused(where, "tags (!name) are not used in cases", "write the plain value")
        if isinstance(event, yaml.ScalarEvent):
            if _CONTROL.search(event.value):
                raise _Refused(where, "control characters are not text", "remove them")
            self._place(Node(event.value, where, plain=not event.style))
        elif isinstance(event, yaml.CollectionStartEvent):
            self._open(Node({} if isinstance(event, yaml.MappingStartEvent) else [], where))
        elif isinstance(event, yaml.CollectionEndEvent):
            for stack in (self.stack, self.keys, self.path):
                stack.pop()
        elif isinstance(event, yaml.DocumentStartEvent):
            if self.root is not None:
                raise _Refused(where, "a second document", "one case a file: remove the ---")
            if event.version or event.tags:
                raise _Refused(where, "directives (%) are not used in cases", "remove the line")

    def _where(self, event: yaml.Event) -> Where:
        line = None if self.start.line is None or not event.start_mark else event.start_mark.line + 1
        return Where(self.start.file, line)

    def _open(self, node: Node) -> None:
        if self.stack and isinstance(self.stack[-1].value, dict) and self.keys[-1] is None:
            raise _Refused(node.where, "a key must be a plain word")
        if len(self.stack) >= MAX_DEPTH:
            raise _Refused(node.where, _TOO_DEEP)
        self.path.append(self._name())
        self._place(node)
        self.stack.append(node)
        self.keys.append(None)

    def _name(self) -> str:
        """The key of the next value in its parent, or its number in a list."""
        if not self.stack:
            return ""
        parent, key = self.stack[-1].value, self.keys[-1]
        return str(len(parent)) if key is None else as_key(key.text)

    def _place(self, node: Node) -> None:
        """Put a node where it belongs: the root, an item of a list, a key or the value of a key."""
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise _Refused(node.where, f"more than {MAX_NODES} values", "put long lists in a file")
        if not self.stack:
            self.root = node
            return
        parent = self.stack[-1]
        if isinstance(parent.value, list):
            parent.value.append(node)
        elif self.keys[-1] is None:
            self.keys[-1] = node
        else:
            key, self.keys[-1] = self.keys[-1], None
            self._insert(parent.entries, key, node)

    def _insert(self, parent: dict[str, Node], key: Node, node: Node) -> None:
        name, node.where = key.text, key.where
        if name in parent:
            path = ".".join([*self.path[1:], as_key(name)])
            first = parent[name].where
            self.problems.add(key.where, path, f"given twice, first in line {first.line}", "keep one of them")
        else:
            parent[name] = node
