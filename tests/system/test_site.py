"""The site is built without a warning, every page of it can be reached, and its reference has what the code has. `make docs`"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from support.paths import ROOT

import raygrid
from raygrid.host.cli.commands.schema import KINDS, schema_of
from raygrid.host.cli.main import cli

sys.path.insert(0, str(ROOT / "docs"))
sys.path.insert(0, str(ROOT / "docs" / "site"))

import make_gallery
import pages
import python_pages

HAS_SPHINX = all(importlib.util.find_spec(name) is not None for name in ("sphinx", "myst_nb", "furo"))
needs_sphinx = pytest.mark.skipif(not HAS_SPHINX, reason="Sphinx is not installed: the extra docs")
ORPHAN = """
import sys
sys.path[:0] = {folders!r}
import make_site, pages
pages.made = lambda: {{"orphan.md": "# No way leads here\\n"}}
sys.exit(make_site.main(["--into", {into!r}]))
"""


class Links(HTMLParser):
    """Where a page leads, and the places in it to which others may lead."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.ids: set[str] = set()
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.ids.add(value)
            if value and (tag, name) in (("a", "href"), ("img", "src")):
                self.targets.append(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as `make docs` builds it."""
    into = tmp_path_factory.mktemp("docs") / "site"
    build = [sys.executable, str(ROOT / "docs" / "site" / "make_site.py"), "--into", str(into)]
    done = subprocess.run(build, capture_output=True, text=True, timeout=280, env=os.environ | {"NO_COLOR": "1"})
    assert (done.returncode, done.stderr) == (0, "")
    return into


@needs_sphinx
def test_no_link_of_the_site_is_broken(site):
    found = {page.relative_to(site).as_posix(): Links(page) for page in site.rglob("*.html")}
    broken = []
    for name, links in found.items():
        for target in links.targets:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            path = os.path.normpath(Path(name).parent / unquote(parts.path)) if parts.path else name
            there = (site / path).exists()
            if not there or (parts.fragment and path in found and unquote(parts.fragment) not in found[path].ids):
                broken.append(f"{name}: {target}")
    assert not broken
    assert sum(len(links.targets) for links in found.values()) > 1000


@needs_sphinx
def test_every_page_can_be_reached_from_the_front(site):
    made = {path.relative_to(site).as_posix() for path in site.rglob("*.html") if "_static" not in path.parts}
    reached, new = set(), {"index.html"}
    while new:
        reached |= new
        targets = {
            os.path.normpath(Path(page).parent / urlsplit(target).path)
            for page in new
            for target in Links(site / page).targets
            if target.partition("#")[0].endswith(".html") and not urlsplit(target).scheme
        }
        new = (targets & made) - reached
    assert made - reached == {"search.html"}  # which the field on each page leads to
    assert len(reached) > 45


@needs_sphinx
def test_the_navigation_has_every_written_page(site):
    front = Links(site / "index.html").targets
    for page in pages.written():
        name = str(Path(pages.site_path(page)).with_suffix(".html"))
        assert name == "index.html" or name in front, page


@needs_sphinx
def test_a_page_to_which_no_way_leads_ends_the_build(tmp_path):
    folders = [str(ROOT / "docs" / "site"), str(ROOT / "docs")]
    program = ORPHAN.format(folders=folders, into=str(tmp_path / "site"))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=280)
    assert done.returncode == 1
    assert re.search(r"orphan\.md: WARNING: document isn't included in any toctree", done.stderr)


@needs_sphinx
def test_python_is_documented_with_its_docstrings(site):
    text = (site / "reference" / "python.html").read_text()
    for name in set(raygrid.__all__) - {"aio"}:
        assert f'id="raygrid.{name}"' in text, name
    for name in ("Machine.render", "Scene.mesh", "Service.submit", "aio.AsyncService.render", "Picture.linear"):
        assert f'id="raygrid.{name}"' in text, name
    assert "alias of" not in text
    assert "most packets a message" in text


def test_without_sphinx_it_is_said_what_is_wanted(tmp_path):
    hide = "import sys; sys.modules['sphinx'] = None; sys.path[:0] = [{!r}]; import make_site; sys.exit(make_site.main([]))"
    program = hide.format(str(ROOT / "docs" / "site"))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr == "Sphinx is not installed, wanted the extra docs: pip install '.[docs]' here\n"


def test_a_docstring_becomes_lists_and_examples():
    lines = [
        "Adds *one* `mesh_of`.",
        "",
        "    call(1)",
        "",
        "width, height  pixels,",
        "               at least 1",
        "up   as it is",
    ]
    assert python_pages.restructured([*lines, "Raises ValueError."]) == [
        "Adds \\*one\\* ``mesh_of``.", "",
        "::", "", "    call(1)", "",
        "``width, height``", "    pixels, at least 1", "",
        "``up``", "    as it is", "",
        "Raises ValueError.", "",
    ]  # fmt: skip


def test_commands_are_documented_with_all_options():
    made = pages.made()
    for name, command in cli.commands.items():
        page = made[f"reference/commands/{name}.md"]
        for parameter in command.params:
            for option in (*parameter.opts, *parameter.secondary_opts):
                assert option in page or not option.startswith("-"), f"{name} {option}"
        assert "Exit codes" in page
        assert "\b" not in page
        if "Example" in (command.epilog or ""):
            assert f"```text\nraygrid {name}" in page


def test_files_are_documented_with_all_keys():
    made = pages.made()
    for kind in KINDS:
        schema, page = schema_of(kind), made[f"reference/files/{kind}.md"]
        assert json.loads(made[f"reference/files/{kind}.schema.json"]) == schema
        for table in (schema, *schema.get("$defs", {}).values()):
            assert not [key for key in table.get("properties", {}) if f"| `{key}` |" not in page]


def test_links_are_those_of_the_site():
    there = {"README.md", "docs/a.md", "docs/b/c.md", "docs/p.png"}.__contains__
    assert pages.relinked("[x](docs/a.md#y) ![p](docs/p.png) [z](#here)", "README.md", there) == (
        "[x](a.md#y) ![p](p.png) [z](#here)"
    )
    assert pages.relinked("[x](../../README.md) [y](../a.md)", "docs/b/c.md", there) == "[x](../README.md) [y](../a.md)"
    left = "[w](https://example.org/a.md)\n```\n[x](nowhere.md)\n```\n"
    assert pages.relinked(left, "docs/a.md", there) == left
    with pytest.raises(ValueError, match=r"docs/a\.md links to nowhere\.md, which is no page or picture of the site"):
        pages.relinked("[x](nowhere.md)", "docs/a.md", there)


def test_a_public_name_without_a_section_is_named(monkeypatch):
    monkeypatch.setattr(raygrid, "__all__", [*raygrid.__all__, "novel"])
    with pytest.raises(ValueError, match=r"lack \['novel'\]"):
        python_pages.python_page()


def test_the_gallery_is_that_of_its_script(tmp_path):
    assert make_gallery.PAGE.read_text() == make_gallery.page(), "out of date: make gallery"
    assert make_gallery.main(["--check"]) == 0
    assert 8 <= len(make_gallery.OURS) <= 12
    assert make_gallery.more(tmp_path) == ("", [])
    (tmp_path / "spot.png").write_bytes(b"")
    text, pictures = make_gallery.more(tmp_path)
    assert pictures == [tmp_path / "spot.png"]
    assert "![Spot, the cow](gallery/spot.png)" in text


def test_pictures_of_the_gallery_are_small_and_of_scenes_that_are_here():
    from PIL import Image

    kept = sorted(make_gallery.PICTURES.iterdir())
    assert {path.name for path in kept} == {shot.file for shot in make_gallery.OURS}
    assert sum(path.stat().st_size for path in kept) < make_gallery.MOST_BYTES
    for path in kept:
        with Image.open(path) as picture:
            assert picture.width <= 320
            assert picture.height <= 240
    assert all((ROOT / shot.words.split()[0]).is_file() for shot in make_gallery.OURS)
