"""The documentation site is built without a warning, needs no network to be read, and is spelled well."""

import ast
import re
from html.parser import HTMLParser

import pytest

from isphcli.case.load import load_case

from .paths import ROOT

LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src"}  # what a browser fetches by itself


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built as `.ci/site` does, with notebooks that were not run."""
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    folder = tmp_path_factory.mktemp("site")
    config = load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder), strict=True)
    config.plugins.on_startup(command="build", dirty=False)
    build(config)
    return folder


class Loads(HTMLParser):
    """What pages load from outside of the site."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        address = dict(attributes).get(LOADED.get(tag, ""), "") or ""
        if "//" in address and dict(attributes).get("rel") not in ("canonical", "alternate"):
            self.found.append(address)


def test_what_a_page_loads_is_told():
    page = Loads()
    page.feed('<script src="https://a.b/c.js"></script><img src="x.png"><a href="https://a.b">d</a>')
    assert page.found == ["https://a.b/c.js"]


@pytest.mark.slow
def test_pages_load_nothing_from_outside(site):
    pages = list(site.rglob("*.html"))
    for path in pages:
        parser = Loads()
        parser.feed(path.read_text(encoding="utf-8"))
        assert not parser.found, path
    assert len(pages) > 50  # with a page of each case


@pytest.mark.slow
def test_every_document_has_its_page(site):
    """Strict building finds links that lead nowhere; this, a document that the hook or the navigation leaves out."""
    for path in [*(ROOT / "docs").glob("*.md"), ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]:
        assert (site / f"{path.stem}.html").is_file(), path.name
    for path in [*(ROOT / "cases").glob("*.yaml"), *(ROOT / "notebooks").glob("*.ipynb")]:
        assert (site / path.relative_to(ROOT).with_suffix(".html")).is_file(), path.name


@pytest.mark.slow
def test_the_search_needs_no_server(site):
    """A page that was opened from the disk reads the index as a script, and runs the search in a frame of its own."""
    index = (site / "search/search_index.js").read_text(encoding="utf-8")
    assert index.startswith("var __index = ") and "Klinkenberg" in index
    for page in ("index.html", "cases/berea.html"):
        (script,) = re.findall(r'<script src="([^"]*iframe-worker[^"]*)"', (site / page).read_text(encoding="utf-8"))
        assert "file:" in (site / page).parent.joinpath(script).read_text(encoding="utf-8")


@pytest.mark.slow
def test_formulas_are_drawn_without_a_script(site):
    page = (site / "method.html").read_text(encoding="utf-8")
    formulas = re.findall(r"\$\$.*?\$\$", (ROOT / "docs/method.md").read_text(encoding="utf-8"), re.DOTALL)
    assert page.count("<math") == len(formulas) and "$$" not in page and "arithmatex" not in page


@pytest.mark.slow
def test_the_options_of_every_command_are_there(site):
    from isphcli.cli import main

    page = (site / "commands.html").read_text(encoding="utf-8")
    for name, command in main.commands.items():
        assert f"isph {name}</h2>" in re.sub(r"<a class=\"headerlink\".*?</a>", "", page)
        for parameter in command.params:
            assert all(option in page for option in parameter.opts if option.startswith("--")), (name, parameter)


def test_what_notebooks_print_and_draw_is_shown(tmp_path, monkeypatch):
    from importlib.util import module_from_spec, spec_from_file_location

    spec = spec_from_file_location("site_pages", ROOT / "docs/site_pages.py")
    hook = module_from_spec(spec)
    spec.loader.exec_module(hook)
    outputs = [{"name": "stdout", "text": ["k = 1\n"]}, {"name": "stderr", "text": ["done in 2 s"]},
               {"data": {"image/png": "aGk=", "text/plain": ["<Figure>"]}}]
    cells = [{"cell_type": "markdown", "source": ["# Rock"]},
             {"cell_type": "code", "source": ["f()"], "outputs": outputs}]
    text, pictures = hook.notebook_page({"cells": cells}, "rock")
    assert text.startswith("# Rock\n\n```python\nf()\n```\n\n```text\nk = 1\n```\n\n![") and "done in" not in text
    assert pictures == {"rock_0.png": b"hi"} and "Figure" not in text


def test_words_are_spelled_well(monkeypatch, capsys):
    from codespell_lib import main

    monkeypatch.chdir(ROOT)
    folders = ("*.md", "docs/*.md", "notebooks/*.ipynb", "cases/*.yaml")
    texts = [path for pattern in folders for path in ROOT.glob(pattern)]
    assert main(*map(str, texts)) == 0, capsys.readouterr().out


def test_pictures_are_drawn_shown_and_small():
    """docs/gallery/draw.py draws each, docs/gallery.md shows it beside its case; together they keep below 1 MB."""
    program = ast.parse((ROOT / "docs/gallery/draw.py").read_text(encoding="utf-8"))
    table = next(node for node in program.body if isinstance(node, ast.Assign) and node.targets[0].id == "PICTURES")
    drawn = ast.literal_eval(table.value)
    there = {path.stem: path.stat().st_size for path in (ROOT / "docs/gallery").glob("*.png")}
    shown = (ROOT / "docs/gallery.md").read_text(encoding="utf-8")
    pairs = re.findall(r"\[Case\]\(\.\./cases/(\w+)\.yaml\)[^!]*!\[[^\]]+\]\(gallery/(\w+)\.png\)", shown)
    assert set(drawn) == set(there) == {case for case, _ in pairs} and all(case == name for case, name in pairs)
    assert sum(there.values()) < 1e6
    for case, (_, changes) in drawn.items():
        load_case(ROOT / f"cases/{case}.yaml", changes)
