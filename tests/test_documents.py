"""What the texts of the repository name is there: links and their sections, paths and names of files."""

import ast
import io
import re
import subprocess
import sys
import tokenize
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MADE = {"validation.md", "report.md", "cases/validation.md"}  # by runs, of which the texts speak
PATH = re.compile(r"(?<![\w/.-])(?:docs|benchmarks|cases|tests|isphcli|\.ci)/[\w./-]*\w")
NAME = re.compile(r"(?<![\w/.*-])[\w-]+\.(?:md|py)\b")
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")


def committed():
    done = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a checkout of the repository")
    return done.stdout.split()


def texts():
    """(path, text) of documents and cases whole, and of programs what is written for people."""
    for path in committed():
        if path.endswith((".md", ".yaml", ".toml", ".csv")) or path.startswith(".ci/"):
            yield path, (ROOT / path).read_text(encoding="utf-8")
        elif path.endswith(".py"):
            yield path, for_people((ROOT / path).read_text(encoding="utf-8"))


def for_people(source):
    """Comments and docstrings of a program."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    found = [token.string for token in tokens if token.type == tokenize.COMMENT]
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    found += [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(source)) if isinstance(node, kinds)]
    return "\n".join(found)


def test_files_that_are_named_exist():
    files = set(committed())
    names = {Path(path).name for path in files}
    folders = {str(parent) for path in files for parent in Path(path).parents}
    missing = []
    for path, text in texts():
        for found in PATH.findall(text):
            if found not in files | folders | MADE and f"isphcli/{found}" not in files:
                missing.append(f"{path}: {found}")
        missing += [f"{path}: {found}" for found in NAME.findall(text) if found not in names | MADE]
    assert not missing, "\n".join(missing)


def test_links_lead_somewhere():
    broken = []
    for path, text in texts():
        for target, section in LINK.findall(text) if path.endswith(".md") else ():
            if "://" in target:
                continue
            file = (ROOT / path).parent / target if target else ROOT / path
            if not file.exists() or (section and section not in sections(file)):
                broken.append(f"{path}: {target}#{section}")
    assert not broken, "\n".join(broken)


def sections(file):
    """The anchors of the headings of a document, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_every_library_is_imported_and_has_a_lowest_version():
    """And `.ci/oldest` asks for just these."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"]
    imported = "\n".join((ROOT / path).read_text(encoding="utf-8") for path in committed() if path.endswith(".py"))
    wanted = []
    for requirement in project["project"]["dependencies"] + extras["test"]:
        name, version = re.fullmatch(r"([\w-]+)>=([\d.]+)", requirement).groups()
        module = {"pyyaml": "yaml"}.get(name, name)
        assert re.search(rf"^ *(import|from) {module}\b", imported, re.MULTILINE), f"no line imports {name}"
        wanted.append(f"{name}=={version}")
    assert set(extras) == {"test", "dev"}
    done = subprocess.run([sys.executable, ROOT / ".ci/oldest", "--constraints"], capture_output=True, text=True)
    assert [line for line in done.stdout.split() if not line.startswith("setuptools==")] == wanted


def test_what_is_not_there_is_found():
    """The patterns see the mentions that there were of a document which the repository does not have."""
    text = "(design.md 8) [x](keys.md#here), `benchmarks/none.py`; cases/none.yaml."
    assert NAME.findall(text) == ["design.md", "keys.md"] and LINK.findall(text) == [("keys.md", "here")]
    assert PATH.findall(text) == ["benchmarks/none.py", "cases/none.yaml"]
    assert for_people('"""Doc."""\nx = "a string"  # said\n') == "# said\nDoc."
