"""Every command that the documents show can be typed: commands and options are there, and so are the cases and the keys
that they name. Those that take no time are run."""

import itertools
import os
import re
import shlex
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from isphcli.case.load import load_case, read_case
from isphcli.cli import main

from .paths import CASES, ROOT

TEXTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(?:bash)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"(?<!`)`(isph [^`]+)`")
PARTS = re.compile(r"\s(?:&&|\||>|2>)\s.*")  # what follows goes to a shell
WORDS = {"CASE", "COMMAND", "IMAGE", "OUT", "DIR", "NAME", "IN"}  # stand for something
SHORT = ("examples", "keys", "init", "convert-voxels", "validate --check-only")  # begin commands of a second
# Pages that a newcomer types along with: their steady runs are done on corners of the same images,
# and checks of these too
TYPED = ("README.md", "first_permeability.md", "my_image.md", "sphere_packs.md", "paraview.md", "resolution.md")
CORNERS = {"berea": "[[44,54],[44,54],[44,54]]", "scan": "[[0,8],[0,8],[0,8]]"}
RAN = set()


def commands(text):
    """The words after `isph` of each command in a document."""
    lines = [line for block in FENCE.findall(text) for line in block.replace("\\\n", " ").splitlines()]
    inline = [found.replace("\n", " ") for found in INLINE.findall(text)]
    found = []
    for line in lines + inline:
        for part in line.split(" && "):
            if part.startswith(("isph ", ".venv/bin/isph ", "python -m isphcli ")):
                words = shlex.split(PARTS.sub("", part), comments=True)
                found.append(tuple(words[3 if words[0] == "python" else 1 :]))
    return found


def all_commands():
    return [(path.name, words) for path in TEXTS for words in commands(path.read_text(encoding="utf-8"))]


def parsed(words):
    """(click command, its context) of a command that is to be there with all its options."""
    context = main.make_context("isph", list(words[:1]))
    name, command, _ = main.resolve_command(context, list(words))
    return command, command.make_context(name, list(words[1:]), parent=context)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the files that the documents let users have."""
    import numpy as np
    import tifffile

    monkeypatch.chdir(tmp_path)
    (tmp_path / "cases").symlink_to(CASES)
    image = (np.indices((52, 52, 52)).sum(axis=0) % 6 < 3).astype(np.uint8)  # [z, y, x], layers, open along all axes
    np.save("scan.npy", image)
    tifffile.imwrite("scan.tif", image)
    (tmp_path / "pack.csv").write_text("x,y,z,radius\n1e-4,1e-4,1e-4,5e-5\n3e-4,1e-4,1e-4,5e-5\n", encoding="utf-8")
    return tmp_path


def test_commands_are_found():
    text = "```bash\npython3 x && isph run a.yaml --set 'b=[1, 2]' > c  # d\n```\n`isph keys\ngravity` and isph no"
    assert commands(text) == [("run", "a.yaml", "--set", "b=[1, 2]"), ("keys", "gravity")]


def test_every_command_can_be_typed(folder, monkeypatch):
    """click parses it. Folders of results are not there: that they exist is not asked."""
    monkeypatch.setattr(click.Path, "convert", lambda self, value, *_: Path(value))
    wrong, names = [], set()
    for file, words in all_commands():
        if words[0] in WORDS or words[0].startswith("-"):
            continue
        names.add(words[0])
        try:
            if len(words) > 1 or words[0] not in main.commands:  # a name alone speaks of the command
                parsed(words)
        except click.ClickException as error:
            if isinstance(error, click.MissingParameter) and WORDS & set(words):
                continue  # a heading, which leaves options out
            wrong.append(f"{file}: isph {' '.join(words)}: {error.format_message()}")
        wrong += [f"{file}: {word} is not there" for word in words
                  if word.startswith("cases/") and not (ROOT / word).exists()]
    assert not wrong, "\n".join(wrong)
    assert names == set(main.commands)  # each is shown somewhere


def test_what_is_set_can_be_set():
    """`isph run` and `isph validate` of cases that come along, with --set: the changed case is read."""
    seen = 0
    for _, words in all_commands():
        cases = [word for word in words if word.startswith("cases/") and word.endswith(".yaml")]
        changes = [value for option, value in itertools.pairwise(words) if option == "--set"]
        for case in cases if changes else ():
            load_case(ROOT / case, tuple(changes))
            seen += 1
    assert seen > 5


def small(words):
    """A command `isph run` of a steady case with a corner of its image, without pictures; None of others."""
    name = Path(words[1]).stem
    steady = name in CORNERS or name == "pack"
    if words[0] != "run" or not steady or not os.path.exists(words[1]):
        return None
    corner = f"geometry.voxels.crop={CORNERS[name]}" if name in CORNERS else "particles.spacing=2e-5"
    return [*words, "--set", corner, "--set", "output.plots=false", "--quiet", "--overwrite"]


@pytest.mark.parametrize("path", TEXTS, ids=[path.name for path in TEXTS])
@pytest.mark.slow
def test_short_commands_run(path, folder):
    """In their order, so that one finds what the one before it wrote; not those of files that only the user has."""
    for words in dict.fromkeys(commands(path.read_text(encoding="utf-8"))):
        files = [word for word in words[1:] if re.fullmatch(r"[\w/]+\.(npy|csv|tif|mhd|raw|yaml)", word)]
        alone = words[0] in ("convert-voxels", "validate", "init") and not files  # speaks of the command
        stands_for = WORDS & set(words) or "[" in " ".join(words)
        if " ".join(words).startswith(SHORT) and not alone and not stands_for and all(map(os.path.exists, files)):
            checked = [Path(word).stem for word in words[2:]] if words[0] == "validate" else []
            corner = [f"--set=geometry.voxels.crop={CORNERS[name]}" for name in checked if name in CORNERS]
            done = CliRunner().invoke(main, [*words, *corner])
            assert done.exit_code == 0, f"isph {' '.join(words)}\n{done.output}"
            RAN.add(words[0])
        elif path.name in TYPED and len(words) > 1 and (corner := small(words)) is not None:
            done = CliRunner().invoke(main, corner)
            assert done.exit_code == 0 and "permeability" in done.stdout, f"isph {' '.join(words)}\n{done.output}"
            RAN.add("run")


@pytest.mark.slow
def test_some_of_each_ran():
    """After the ones above, in the order of the file."""
    assert RAN >= {"examples", "keys", "init", "validate", "convert-voxels", "run"}


def test_cases_of_the_documents_can_be_read():
    """Whole cases that are shown; parts of cases have no fluids."""
    seen = 0
    for path in TEXTS:
        for text in re.findall(r"^```yaml\n(.*?)^```$", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
            blocks = {line.split()[0] for line in text.splitlines() if line}
            if {"geometry:", "particles:", "fluids:", "drive:"} <= blocks:
                read_case(text.encode(), CASES / "shown.yaml", ())
                seen += 1
    assert seen >= 3
