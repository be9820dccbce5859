"""Parts of all reports of `isph validate`: date, command and machine; lists and tables of Markdown."""

from __future__ import annotations

import contextlib
import datetime
import os
import platform
import re
import shlex
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..output.machine import versions


def origin() -> dict[str, str]:
    """Date, command and machine."""
    program = Path(sys.argv[0]).name if sys.argv else ""
    command = ["isph", *sys.argv[1:]] if program in ("isph", "__main__.py") else sys.argv
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "command": shlex.join(command),
        "machine": f"{_processor()}, {os.cpu_count()} cores, {platform.system()}",
        "versions": ", ".join(f"{name} {number}" for name, number in versions().items()),
    }


def _processor() -> str:
    with contextlib.suppress(OSError, StopIteration):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line for line in file if line.startswith("model name")).split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return [
        "| " + " | ".join(re.sub(r"\s*\n\s*", " ", c).replace("|", r"\|") for c in r) + " |" for r in lines
    ]


def items(texts: Iterable[str]) -> list[str]:
    """A Markdown list."""
    return [f"- {text}" for text in texts]
