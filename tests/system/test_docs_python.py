"""Every Python snippet of README and docs runs, as a reader would type it, with the scenes beside it and an array that is up."""

import logging
import warnings
from pathlib import Path

import pytest
from support.cli import warm_kernels
from support.docs import PAGES, ROOT, files_of, snippets
from support.service import lasting

__all__ = ["warm_kernels"]

SNIPPETS = [
    pytest.param(snippet, shown, page, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, (snippet, shown) in enumerate(snippets(page), 1)
]


@pytest.fixture(scope="module")
def film(warm_kernels, tmp_path_factory):
    with lasting(tmp_path_factory.mktemp("state"), "film") as name:
        yield name


@pytest.mark.parametrize(("snippet", "shown", "page"), SNIPPETS)
def test_a_snippet_runs(snippet, shown, page, film, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("scenes").symlink_to(ROOT / "scenes")
    Path("out").mkdir()
    for name, text in files_of(page).items():
        Path(name).write_text(text)
    monkeypatch.setattr(logging, "basicConfig", lambda **_: None)  # it would stay for other tests
    with warnings.catch_warnings():
        exec(compile(snippet, "<snippet>", "exec", dont_inherit=True), {"__name__": "snippet"})
    assert shown in ("", capsys.readouterr().out)


def test_the_snippets_are_found():
    assert len(SNIPPETS) > 5
    assert any(snippet.values[1] for snippet in SNIPPETS)
