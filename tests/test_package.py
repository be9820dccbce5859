"""What is installed: every room of the package, and what its files need."""

import re
import tomllib
from importlib import metadata

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


def test_the_version_is_that_of_the_tags():
    """Without tags it is one before the first release. CITATION and CHANGELOG name the release that is next or last."""
    cited = re.search(r"^version: ([\d.]+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)[1]
    newest = re.search(r"^## ([\d.]+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)[1]
    assert PROJECT["project"]["dynamic"] == ["version"] and "version" not in PROJECT["project"]
    assert newest == cited and PROJECT["tool"]["setuptools_scm"]["fallback_version"].startswith(cited)
    assert __version__ == metadata.version("isphcli")


def test_versions_of_all_libraries_are_kept():
    needed = {text.split(">=")[0] for text in PROJECT["project"]["dependencies"]}
    assert needed | {"isphcli"} == set(LIBRARIES)
