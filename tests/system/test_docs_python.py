"""Every Python snippet of README and docs runs, as a reader would type it, with the scenes beside it and an array that is up."""

import logging
import re
import warnings
from pathlib import Path

import pytest
from support.cli import warm_kernels
from support.docs import PAGES, ROOT, files_of
from support.service import lasting

__all__ = ["warm_kernels"]

SNIPPETS = [
    pytest.param(found, page, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, found in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S), 1)
]
SMALL = {"640, 480": "64, 48", "800, 600": "64, 48", "frames=(1, 48)": "frames=(1, 2)", '"2x2x2"': '"2x1x1"'}


@pytest.fixture(scope="module")
def film(warm_kernels, tmp_path_factory):
    with lasting(tmp_path_factory.mktemp("state"), "film") as name:
        yield name


@pytest.mark.parametrize(("snippet", "page"), SNIPPETS)
def test_a_snippet_runs(snippet, page, film, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("scenes").symlink_to(ROOT / "scenes")
    Path("out").mkdir()
    for name, text in files_of(page).items():
        Path(name).write_text(text)
    for large, little in SMALL.items():
        snippet = snippet.replace(large, little)
    monkeypatch.setattr(logging, "basicConfig", lambda **_: None)  # it would stay for other tests
    with warnings.catch_warnings():
        exec(compile(snippet, "<snippet>", "exec", dont_inherit=True), {"__name__": "snippet"})


def test_the_snippets_are_found():
    assert len(SNIPPETS) > 5
