"""Puts the pages of the site together: those that are written, in the order of the map, and those that are made from the code.

Written pages stand in README.md, CHANGELOG.md, CONTRIBUTING.md and docs/, as plain Markdown that a forge shows as it is. On
the site docs/ lies at the top, and the three beside it, so links are rewritten. The map, docs/index.md, is the front page, and
what its sections link to is what the navigation has.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import make_gallery
from command_pages import FOLDER as COMMANDS
from command_pages import command_pages
from python_pages import PAGE as PYTHON
from python_pages import python_page
from schema_pages import FOLDER as FILES
from schema_pages import schema_pages

ROOT = Path(__file__).parents[2]
TOP = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")
MAP = "docs/index.md"
PAGES, PICTURES = ("*.md", "*.ipynb"), ("*.png", "*.svg", "*.webp", "*.jpg")
LINK = re.compile(r"(?<=\]\()([^)#:\s]+)(?=[)#])")
REFERENCE = {
    "Commands": (f"{COMMANDS}/index.md", "every command with every option"),
    "Python": (PYTHON, "every public name, from its docstring"),
    "Files and messages": (f"{FILES}/index.md", "scene files, cost models, requests and samples, from their schemas"),
}


def written() -> list[str]:
    """Paths of the pages that are written, below the project's root."""
    below = (path.relative_to(ROOT).as_posix() for kind in PAGES for path in (ROOT / "docs").rglob(kind))
    return [*TOP, *sorted(path for path in below if ".ipynb_checkpoints" not in path)]


def site_path(path: str) -> str:
    """Where a page or picture of the project is on the site."""
    return path.removeprefix("docs/")


def relinked(text: str, page: str, there: Callable[[str], bool]) -> str:
    """A page with its links as they must be on the site. Raises ValueError for a link to what the site does not have."""

    def target(link: re.Match[str]) -> str:
        path = os.path.normpath(PurePosixPath(page).parent / link[0])
        if not there(path):
            raise ValueError(f"{page} links to {link[0]}, which is no page or picture of the site")
        return os.path.relpath(site_path(path), PurePosixPath(site_path(page)).parent)

    parts = re.split(r"(^```.*?^```$)", text, flags=re.M | re.S)
    return "".join(part if part.startswith("```") else LINK.sub(target, part) for part in parts)


def navigation(text: str) -> str:
    """The map with what Sphinx needs: for each section the pages that it links to, and the reference."""
    parts = [re.sub(r"^\| [^|]+ \|$", "", text).rstrip()]
    for section in re.split(r"^## ", text, flags=re.M)[1:]:
        links = dict.fromkeys(link for link in LINK.findall(section) if link.endswith((".md", ".ipynb")))
        if links:
            parts.append(_toctree(section.splitlines()[0], list(links)))
    rows = [f"| [{title}]({path}) | {what} |" for title, (path, what) in REFERENCE.items()]
    parts += ["## Reference, made from the code", "\n".join(["| of | has |", "|---|---|", *rows])]
    parts.append(_toctree("Reference", [*(path for path, _ in REFERENCE.values()), "genindex"]))
    return "\n\n".join(parts) + "\n"


def _toctree(caption: str, pages: list[str]) -> str:
    return "\n".join(["```{toctree}", ":hidden:", f":caption: {caption}", "", *pages, "```"])


def made() -> dict[str, str]:
    """Path below the site -> text, of all that is made from the code."""
    return {**command_pages(), PYTHON: python_page(), **schema_pages()}


def put_together(into: Path) -> list[str]:
    """Write all that Sphinx reads into a folder, which is emptied before; what is in it, by its path on the site."""
    shutil.rmtree(into, ignore_errors=True)
    pictures = [path for kind in PICTURES for path in (ROOT / "docs").rglob(kind)]
    pages = written()
    known = {*pages, *(path.relative_to(ROOT).as_posix() for path in pictures)}
    texts = {}
    for page in pages:
        text = (ROOT / page).read_text()
        text = text if page.endswith(".ipynb") else relinked(text, page, known.__contains__)
        texts[site_path(page)] = navigation(text) if page == MAP else text
    gallery, others = make_gallery.more()
    texts["gallery.md"] += gallery
    texts |= made()
    for name, text in texts.items():
        path = into / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    for picture in pictures:
        path = into / site_path(picture.relative_to(ROOT).as_posix())
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(picture, path)
    for picture in others:
        shutil.copyfile(picture, into / "gallery" / picture.name)
    return sorted(texts)
