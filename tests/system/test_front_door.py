"""The ways in are kept: one target checks all, wherever it is called from, and documents name files that are there."""

from __future__ import annotations

import re
import subprocess
import tomllib

import pytest
from support.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
FOLDERS = "node|emulator|host|tests|benchmarks|scenes|docs"
NAMED = re.compile(rf"(?<![\w/.-])((?:{FOLDERS})(?:/[\w.*-]+)+/?)")


def paths_named(text: str) -> set[str]:
    """Files and folders of the project in a page's code, without examples such as node/*.py."""
    code = re.findall(r"`([^`\n]+)`", text)
    return {path.rstrip("/.") for part in code for path in NAMED.findall(part) if "*" not in path}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_a_page_names_are_there(page):
    missing = {path for path in paths_named(page.read_text()) if not (ROOT / path).exists()}
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_of_a_page_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text())
    assert not [link for link in links if not (page.parent / link).exists()]


def test_paths_are_found():
    """So that no page above passes for want of them."""
    assert paths_named("`node/a.py` and `see tests/b/c.py, docs/d.md`; `x/node/e.py`; node/f.py; `node/*.py`") == {
        "node/a.py",
        "tests/b/c.py",
        "docs/d.md",
    }
    assert sum(len(paths_named(page.read_text())) for page in PAGES) > 150


def test_the_map_has_every_page():
    docs = ROOT / "docs"
    linked = set(re.findall(r"\]\(([\w/-]+\.(?:md|ipynb))\)", (docs / "index.md").read_text()))
    there = {page.relative_to(docs).as_posix() for kind in ("*.md", "*.ipynb") for page in docs.rglob(kind)}
    assert linked == there - {"index.md"}


def test_one_target_checks_all():
    called = subprocess.run(["make", "--dry-run", "check"], cwd=ROOT, capture_output=True, text=True, timeout=60).stdout
    order = [called.find(tool) for tool in ("ruff check", "mypy --config-file", "-m pytest")]
    assert -1 not in order
    assert order == sorted(order)
    assert (ROOT / ".ci" / "run").read_text().splitlines()[-1] == "exec make check"


def test_a_forge_calls_the_same_target_on_the_oldest_and_newest_python():
    job = (ROOT / ".github" / "workflows" / "check.yml").read_text()
    assert re.findall(r"- run: (.*)", job) == ["make check", "make ${{ matrix.target }}"]
    assert re.findall(r"target: \[(.*)\]", job) == ["check-oldest, check-newest"]
    assert {"check-oldest", "check-newest"} <= TARGETS
    python = re.compile(r"Programming Language :: Python :: (3\.\d+)")
    known = [found[1] for known in PROJECT["classifiers"] if (found := python.fullmatch(known))]
    assert re.findall(r'python: \["(.*)", "(.*)"\]', job) == [(known[0], known[-1])]
    assert PROJECT["requires-python"] == f">={known[0]}"


def test_hooks_before_a_commit_are_targets_too():
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    called = re.findall(r"entry: make --no-print-directory (\S+)", hooks)
    assert called == ["style", "types"]
    assert set(called) <= TARGETS


def test_targets_that_contributing_names_are_there():
    page = (ROOT / "CONTRIBUTING.md").read_text()
    named = {word for line in re.findall(r"`?\bmake ((?:[a-z-]+ ?)+)", page) for word in line.split()[:1]}
    assert len(named) > 5
    assert {"check", "style", "picture", "wheel-check", "test-long"} <= named & TARGETS
