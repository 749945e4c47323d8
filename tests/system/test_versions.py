"""Which versions of libraries are allowed: bounds in pyproject.toml, and the oldest of them, which `make check-oldest` installs."""

from __future__ import annotations

import re
import tomllib

import pytest
from support import paths

PROJECT = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
WANTED = {re.split("[<>=]", wanted)[0]: wanted for wanted in PROJECT["dependencies"]}
INSIDES = ("numba", "llvmlite", "pyzmq", "xxhash")  # of which something is used that they do not document


def test_the_oldest_are_those_that_the_bounds_allow():
    listed = [line for line in (paths.ROOT / ".ci" / "oldest.txt").read_text().splitlines() if not line.startswith("#")]
    assert listed == [re.sub(r">=([^,]+).*", r"==\1", wanted) for wanted in WANTED.values()]


@pytest.mark.parametrize("name", INSIDES)
def test_what_is_used_from_within_has_an_upper_bound(name):
    assert re.fullmatch(rf"{name}>=[0-9.]+,<[0-9.]+", WANTED[name])
