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


def test_every_library_has_a_lower_bound():
    extras = PROJECT["optional-dependencies"]
    assert {"docs", "test", "dev", "exr", "law", "plots", "prometheus"} <= set(extras)
    listed = [*PROJECT["dependencies"], *(wanted for extra in extras.values() for wanted in extra)]
    assert not [wanted for wanted in listed if not re.fullmatch(r"[A-Za-z][\w-]*>=[0-9.]+(,<[0-9.]+)?", wanted)]


def test_what_is_said_of_the_package_is_whole():
    """Linux alone, the licence, what it is about. There are no URLs, since it has no public home: none is invented."""
    said = PROJECT["classifiers"]
    assert [one for one in said if one.startswith("Operating System")] == ["Operating System :: POSIX :: Linux"]
    assert len(said) == len(set(said))
    for topic in ("Development Status", "Environment", "Intended Audience", "Programming Language", "Topic", "Typing"):
        assert any(one.startswith(f"{topic} :: ") for one in said), topic
    assert not [one for one in said if one.startswith("License")]  # which the licence's own key says
    assert (PROJECT["license"], PROJECT["license-files"]) == ("MIT", ["LICENSE"])
    assert {"description", "readme", "keywords", "requires-python"} <= set(PROJECT)
    assert all(url.startswith("https://") for url in PROJECT.get("urls", {}).values())


@pytest.mark.parametrize("name", INSIDES)
def test_what_is_used_from_within_has_an_upper_bound(name):
    assert re.fullmatch(rf"{name}>=[0-9.]+,<[0-9.]+", WANTED[name])
