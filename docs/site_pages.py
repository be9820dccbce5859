"""Pages of the site that are not files of docs/: a hook of mkdocs, which mkdocs.yml names.

What docs/ links to outside of itself comes along under its own path: Markdown as a page, a case as a page that shows
it, all else as a file. The options of the commands are those that click prints; notebooks become pages, with what they
print and draw where `ISPH_NOTEBOOKS` names a folder with copies that were run.
"""

from __future__ import annotations

import base64
import json
import os
import posixpath
import re
from html import unescape
from pathlib import Path

import click
import yaml
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from isphcli.cli import main as isph

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"(?<=\]\()([^)#\s]+)(?=[)#])")
FORMULA = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)
BESIDE = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")  # pages that are not in docs/


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Pages of docs/ that the navigation of mkdocs.yml does not name stand at its end."""
    named = re.findall(r"[\w/]+\.md", repr(config.nav))
    others = sorted(path.name for path in (ROOT / "docs").glob("*.md") if path.name not in named)
    if others:
        config.nav.append({"More": others})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the generated pages, and what is linked to outside of docs/."""

    def page(path: str, text: str) -> None:
        files.append(File.generated(config, path, content=text))

    for name in BESIDE:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    page("commands.md", commands_page())
    for case in sorted((ROOT / "cases").glob("*.yaml")):
        page(f"cases/{case.stem}.md", case_page(case))
    folder = Path(os.environ.get("ISPH_NOTEBOOKS", ROOT / "notebooks"))
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text, pictures = notebook_page(json.loads((folder / notebook.name).read_text(encoding="utf-8")), notebook.stem)
        page(f"notebooks/{notebook.stem}.md", text)
        files.append(File.generated(config, f"notebooks/{notebook.name}", abs_src_path=str(notebook)))
        for name, picture in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    for target in sorted(linked()):
        if in_site(target) == target and (ROOT / target).is_file() and files.get_file_from_path(target) is None:
            files.append(File.generated(config, target, abs_src_path=str(ROOT / target)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The links of a page as they are within the site."""
    here = page.file.src_uri
    source = f"docs/{here}" if (ROOT / "docs" / here).exists() else here

    def moved(found: re.Match[str]) -> str:
        target = resolved(source, found[1])
        return found[1] if target is None else posixpath.relpath(in_site(target), posixpath.dirname(here) or ".")

    items = re.sub(r"(?m)^( {2,3}\S.*\n)(?=\d+\. )", r"\1\n", markdown)  # GitHub asks for less space around the
    items = re.sub(r"(?<=\n\n) {2,3}(?=\S)", "    ", items)  # paragraphs of an item
    return LINK.sub(moved, items)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Formulas as MathML, which browsers draw by themselves."""
    return FORMULA.sub(lambda found: convert(unescape(found[1]).strip(), display="block"), html)


def resolved(source: str, link: str) -> str | None:
    """Path in the repository that a link of the file `source` leads to; None where it leads to no file of it."""
    target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
    return None if "://" in link or not (ROOT / target).exists() else target


def in_site(path: str) -> str:
    """Where a file of the repository is in the site."""
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path == "cases":
        return "gallery.md"
    if re.fullmatch(r"cases/\w+\.yaml|notebooks/\w+\.ipynb", path):
        return str(Path(path).with_suffix(".md"))
    return path


def linked() -> set[str]:
    """Files outside of docs/ that a page of the site links to."""
    sources = [*BESIDE, *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]
    found = {resolved(source, link) for source in sources for link in LINK.findall((ROOT / source).read_text("utf-8"))}
    return {path for path in found if path and not path.startswith("docs/") and path not in BESIDE}


def commands_page() -> str:
    """The help of every command, as `isph COMMAND --help` prints it."""
    parts = ["# Options of all commands\n\nWhat `isph COMMAND --help` prints. [The command line](cli.md) says more.\n"]
    context = click.Context(isph, info_name="isph")
    for name in isph.list_commands(context):
        command = isph.get_command(context, name)
        inner = click.Context(command, info_name=name, parent=context, max_content_width=100, terminal_width=100)
        parts.append(f"## isph {name}\n\n```text\n{command.get_help(inner)}\n```\n")
    return "\n".join(parts)


def case_page(path: Path) -> str:
    """A case, with the command that runs it."""
    text = path.read_text(encoding="utf-8")
    title = yaml.safe_load(text).get("title") or path.stem
    return f"# {title}\n\n```bash\nisph run cases/{path.name}\n```\n\n```yaml title=\"cases/{path.name}\"\n{text}```\n"


def notebook_page(notebook: dict, name: str) -> tuple[str, dict[str, bytes]]:
    """(Markdown, {file: picture}) of a notebook of nbformat 4."""
    parts, pictures = [], {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                file = f"{name}_{len(pictures)}.png"
                pictures[file] = base64.b64decode("".join(data["image/png"]))
                parts.append(f"![what the cell above draws]({file})")
            elif output.get("name") != "stderr":
                text = "".join(output.get("text", data.get("text/plain", ())))
                parts.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts) + f"\n\nThe notebook: [{name}.ipynb]({name}.ipynb).\n", pictures
