"""The table of files that begin first names files that are there, once each, and puts them first."""

from __future__ import annotations

import pytest
from support.order import FIRST, place_of


def test_the_table_names_files_that_are_there_and_each_once(pytestconfig: pytest.Config) -> None:
    there = {path.stem for path in (pytestconfig.rootpath / "tests").rglob("test_*.py")}
    assert not set(FIRST) - there
    assert len(set(FIRST)) == len(FIRST)


def test_files_that_are_not_named_come_after_all_that_are() -> None:
    assert [place_of(name) for name in FIRST] == list(range(len(FIRST)))
    assert place_of("test_order") == place_of("test_of_nothing") == len(FIRST)
