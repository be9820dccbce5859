"""What the scripts of benchmarks/ take from the package is there; running them is not for the tests."""

import ast
import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"
SCRIPTS = sorted(FOLDER.rglob("*.py"))


def missing(module: str, name: str) -> bool:
    """Whether `from module import name` fails."""
    if hasattr(importlib.import_module(module), name):
        return False
    try:
        importlib.import_module(f"{module}.{name}")
    except ModuleNotFoundError:
        return True
    return False


def taken(source: str) -> list[tuple[str, str]]:
    """(module, name) of what a script imports from the package, in functions too."""
    return [(node.module, alias.name) for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)
            and (node.module or "").split(".")[0] == "isphcli" for alias in node.names]


def timed(source: str) -> list[str]:
    """Dotted names below isphcli of the functions that benchmarks/memory.py watches."""
    lists = [node.value for node in ast.parse(source).body if isinstance(node, ast.Assign)
             and node.targets[0].id.startswith("PARTS")]
    return [name for value in lists for name in value.func.value.value.split()]


def test_names_of_the_package_in_scripts_are_there():
    assert missing("isphcli.flow.state", "Nothing") and not missing("isphcli.flow", "state")
    wrong = [f"{script.name}: {module}.{name}" for script in SCRIPTS for module, name in taken(script.read_text())
             if missing(module, name)]
    assert len(SCRIPTS) > 40 and not wrong


def test_functions_that_the_memory_script_watches_are_there():
    names = timed((FOLDER / "memory.py").read_text())
    assert len(names) > 15
    for name in names:
        room, module, *rest = name.split(".")
        if room == "solvers" and module == "petsc":
            pytest.importorskip("petsc4py")
        holder = importlib.import_module(f"isphcli.{room}.{module}")
        for part in rest:
            holder = getattr(holder, part)
