"""What is installed: every room of the package, and what its files need."""

import tomllib
from pathlib import Path

from isphcli import __version__
from isphcli.output.machine import LIBRARIES

from .paths import CASES, ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SETUP = PROJECT["tool"]["setuptools"]


def test_every_room_is_installed():
    rooms = {".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / "isphcli").rglob("__init__.py")}
    assert rooms | {"isphcli.cases", "isphcli.cases.data"} == set(SETUP["packages"])


def test_all_cases_and_data_are_installed():
    for name, folder in SETUP["package-dir"].items():
        installed = {path for pattern in SETUP["package-data"][name] for path in (ROOT / folder).glob(pattern)}
        assert {path for path in (ROOT / folder).iterdir() if path.is_file()} == {p for p in installed if p.is_file()}
    assert (ROOT / SETUP["package-dir"]["isphcli.cases"]) == CASES
    data = {path for pattern in SETUP["package-data"]["isphcli"] for path in (ROOT / "isphcli").glob(pattern)}
    assert {path for path in (ROOT / "isphcli/data").iterdir() if path.is_file()} < data
    assert ROOT / "isphcli/py.typed" in data


def test_one_version_everywhere():
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert PROJECT["project"]["version"] == __version__ and f"version: {__version__}\n" in cited
    assert f"## {__version__}" in Path(ROOT, "CHANGELOG.md").read_text(encoding="utf-8")


def test_versions_of_all_libraries_are_kept():
    needed = {text.split(">=")[0] for text in PROJECT["project"]["dependencies"]}
    assert needed | {"isphcli"} == set(LIBRARIES)
