"""What the texts of the repository name is there: links and their sections, paths and names of files, functions that
compute equations of the paper."""

import ast
import functools
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]
MADE = {"validation.md", "report.md", "cases/validation.md"}  # by runs, of which the texts speak
PATH = re.compile(r"(?<![\w/.-])(?:docs|benchmarks|cases|tests|isphcli|\.ci)/[\w./-]*\w")
NAME = re.compile(r"(?<![\w/.*-])[\w-]+\.(?:md|py)\b")
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
IN_PACKAGE = re.compile(r"`([a-z_]+(?:/[a-z_]+)*\.py)`")
SECTION = re.compile(r"method\.md\)?,? (?:section )?(\d+)")
EQUATIONS = 26  # numbered ones of the method of the paper; 27 and 28 are of its results
LISTS = re.compile(r"\beqs?\.? (\d+(?:(?:-|, | and | to )\d+)*)")


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


@functools.cache
def for_people(source):
    """Comments and docstrings of a program."""
    found = re.findall(r"(?:^|\s)(#.*)", source)  # and texts with a #: tokens would take most of the time of this file
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


HOSTS = {"json-schema.org", "github.com"}  # of addresses that somebody has looked at: the tests have no network


def test_web_addresses_are_well_formed_and_known():
    """Those of documents, cases and programs; a code host names an owner and a repository."""
    found = [(path, address.rstrip(".")) for path, text in texts()
             for address in re.findall(r"https?://[^\s)>\"'`*,;:]+|\bgithub\.com/[\w./-]+", text) if "[" not in address]
    assert found
    for path, address in found:
        scheme, _, rest = address.rpartition("://")
        host, *parts = rest.split("/")
        assert scheme in ("", "https") and (host in HOSTS or path.startswith("tests/")), f"{path}: {address}"
        assert host != "github.com" or len([part for part in parts if part]) >= 2, f"{path}: {address}"


def sections(file):
    """The anchors of the headings of a document, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_figures_are_drawn_named_and_small():
    """Those of docs/figures are the functions of its script, and each stands in docs/method.md with a text for those
    who do not see it. A picture of more than 60 kB has more points than anyone sees."""
    program = ast.parse((ROOT / "docs/figures/draw.py").read_text(encoding="utf-8"))
    drawn = {node.name for node in program.body
             if isinstance(node, ast.FunctionDef) and node.returns and ast.unparse(node.returns) == "Figure"}
    there = {path.stem: path for path in (ROOT / "docs/figures").glob("*.svg")}
    text = (ROOT / "docs/method.md").read_text(encoding="utf-8")
    named = re.findall(r"!\[[^\]]+\]\(figures/(\w+)\.svg\)", text)
    assert drawn == set(there) and sorted(named) == sorted(there)
    assert {name for name, path in there.items() if path.stat().st_size > 60_000} == set()
    for path in there.values():
        assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_every_library_is_imported_and_has_a_lowest_version():
    """And `.ci/oldest` asks for just these."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"]
    imported = "\n".join((ROOT / path).read_text(encoding="utf-8") for path in committed() if path.endswith(".py"))
    wanted = []
    for requirement in project["project"]["dependencies"] + extras["test"]:
        name, version = re.fullmatch(r"([\w-]+)>=([\d.]+)", requirement).groups()
        module = {"pyyaml": "yaml", "pillow": "PIL", "pynrrd": "nrrd",
                  "mkdocs-material": "mkdocs", "codespell": "codespell_lib"}.get(name, name)
        if name == "pytest-xdist":  # an option of the test command
            assert "-m pytest -n " in (ROOT / "README.md").read_text(encoding="utf-8")
        else:
            assert re.search(rf"^ *(import|from) {module}\b", imported, re.MULTILINE), f"no line imports {name}"
        wanted.append(f"{name}=={version}")
    assert set(extras) == {"images", "film", "mpi", "test", "docs", "dev"}
    done = subprocess.run([sys.executable, ROOT / ".ci/oldest", "--constraints"], capture_output=True, text=True)
    assert [line for line in done.stdout.split() if not line.startswith("setuptools")] == wanted


def test_what_is_not_there_is_found():
    """The patterns see the mentions that there were of a document which the repository does not have."""
    text = "(design.md 8) [x](keys.md#here), `benchmarks/none.py`; cases/none.yaml."
    assert NAME.findall(text) == ["design.md", "keys.md"] and LINK.findall(text) == [("keys.md", "here")]
    assert PATH.findall(text) == ["benchmarks/none.py", "cases/none.yaml"]
    assert for_people('"""Doc."""\nx = "a string"  # said\n') == "# said\nDoc."


def numbers(text):
    """Equations that a text names: 'eq. 6', 'eqs 2-4, 8-10', 'eqs 4 and 10'."""
    found = set()
    for run in LISTS.findall(text):
        for part in re.split(", | and ", run):
            first, _, last = part.replace(" to ", "-").partition("-")
            found |= set(range(int(first), int(last or first) + 1))
    return found


def equations():
    """(number, [(file, function)], status) of the rows of the table of equations in docs/method.md."""
    text = (ROOT / "docs/method.md").read_text(encoding="utf-8")
    rows = []
    for number, where, status in re.findall(r"^\| (\d+) \| [^|]+ \| ([^|]+) \| ([^|]+) \|", text, re.MULTILINE):
        places = []
        for part in where.split(";"):
            file, names = part.split(":")
            places += [(file.strip().strip("`"), name) for name in re.findall(r"`([\w.]+)`", names)]
        rows.append((int(number), places, status.strip()))
    return rows


def defined(file):
    """{name: its lines} of the functions, classes and methods of a file of the package, methods as Class.method."""
    source = (ROOT / "isphcli" / file).read_text(encoding="utf-8")
    lines = source.splitlines()
    found = {}

    def enter(body, prefix):
        for node in body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                found[prefix + node.name] = "\n".join(lines[node.lineno - 1 : node.end_lineno])
                enter(node.body, f"{prefix}{node.name}.")

    enter(ast.parse(source).body, "")
    return found


def words():
    """(word, [(file, function)]) of the rows of the glossary."""
    text = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [(cells[0], re.findall(r"`([\w/]+\.py)`: `([\w.]+)`", cells[-1])) for cells in rows if cells[0] != "word"]


def test_every_word_of_the_glossary_has_a_place_in_the_code():
    """And stands once, with a letter, a unit or neither, and what it is."""
    text = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
    assert len(words()) > 60 and len({word for word, _ in words()}) == len(words())
    assert {line.count(" |") for line in text.splitlines() if line.startswith("| ")} == {5}
    wrong = [f"{word}: {file}: {name}" for word, places in words() for file, name in places or [("no file", "")]
             if not (ROOT / "isphcli" / file).is_file() or name not in defined(file)]
    assert not wrong, "\n".join(wrong)


def test_every_equation_of_the_paper_has_one_row():
    rows = [number for number, _, _ in equations()]
    assert rows == sorted(set(rows)) and set(range(1, EQUATIONS + 1)) <= set(rows)


@pytest.mark.parametrize(("number", "places", "status"), equations(), ids=[f"eq{row[0]}" for row in equations()])
def test_the_table_of_equations_names_what_computes_them(number, places, status):
    """The text of each function bears the number of its equation, whole or in a range."""
    assert places and status in ("same", "changed", "not used")
    for file, name in places:
        assert name in defined(file), f"eq. {number}: {file} has no {name}"
        if status != "not used":
            assert number in numbers(defined(file)[name]), f"eq. {number}: {name} of {file} does not bear its number"


def test_numbers_of_equations_are_read():
    assert numbers("(eq. 6) eqs 2-4, 8-10; eqs 4 and 10, eqs 5 to 7; eq 12") == {2, 3, 4, 5, 6, 7, 8, 9, 10, 12}
    assert numbers("frequency 3, eq. 3-48") >= {3} and numbers("6 eqs") == set()


def test_files_of_the_package_are_named_with_their_rooms():
    """Paths from the folder of the package, `flow/step.py`, which the patterns above do not see."""
    files = [f"/{path}" for path in committed()]
    named = {(path, found) for path, text in texts() for found in IN_PACKAGE.findall(text)}
    missing = [f"{path}: {found}" for path, found in named if not any(file.endswith(f"/{found}") for file in files)]
    assert named and not missing, "\n".join(missing)


def test_the_table_of_rooms_has_every_file_once():
    room, listed = "", []
    table = (ROOT / "docs/architecture.md").read_text(encoding="utf-8").split("## Rooms")[1].split("\n## ")[0]
    for cell in re.findall(r"^\| (.+?) \|", table, re.MULTILINE):
        if cell.startswith("**"):
            room = cell.strip("*/") + "/" if cell.endswith("/**") else ""
        listed += [f"isphcli/{room}{name}" for name in IN_PACKAGE.findall(cell)]
    files = [path for path in committed() if path.startswith("isphcli/") and path.endswith(".py")]
    assert sorted(listed) == sorted(path for path in files if "/__" not in path)


def test_sections_of_the_method_are_there():
    heads = set(re.findall(r"^## (\d+) ", (ROOT / "docs/method.md").read_text(encoding="utf-8"), re.MULTILINE))
    named = {(path, number) for path, text in texts() for number in SECTION.findall(text)}
    assert named and {(path, number) for path, number in named if number not in heads} == set()


def test_names_in_comments_are_there():
    """`file.name` and file.Class, wherever a comment or docstring of the package says so."""
    known, rooms = {}, {path.split("/")[1] for path in committed() if path.startswith("isphcli/")}
    for path in committed():
        if path.startswith("isphcli/") and path.endswith(".py"):
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            names = known.setdefault(Path(path).stem, set())
            names |= {node.name for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
            names |= {target.id for node in ast.walk(tree) if isinstance(node, (ast.Assign, ast.AnnAssign))
                      for target in ast.walk(node) if isinstance(target, ast.Name)}
    missing = []
    for path, text in texts():
        if path.startswith("isphcli/") and path.endswith(".py"):
            found = re.findall(r"`(?:\w+\.)?(\w+)\.(\w+)`", text) + re.findall(r"\b(\w+)\.([A-Z]\w+)", text)
            missing += [f"{path}: {file}.{name}" for file, name in found if name not in known.get(file, {name})
                        or (file not in known and file in rooms and name[0].isupper())]
    assert not missing, "\n".join(missing)
