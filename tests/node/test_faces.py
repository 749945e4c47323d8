"""What a package gives is what its stub says to a type checker, and is loaded when it is asked for."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from importlib import import_module

import pytest
from support.paths import ROOT

from raygrid.node.faces import read_stub

STUBS = sorted(
    path.relative_to(ROOT) for layer in ("node", "emulator", "host") for path in ROOT.glob(f"{layer}/**/*.pyi")
)


def by_parser(text):
    """What a type checker reads: name -> module, of relative imports of names that are given on."""
    found = {}
    for line in ast.parse(text).body:
        assert isinstance(line, ast.ImportFrom)
        assert line.level == 1
        assert line.module is not None
        for alias in line.names:
            assert alias.asname == alias.name  # or it is not given on
            assert alias.name not in found
            found[alias.name] = line.module
    return found


def test_there_are_stubs():
    assert len(STUBS) >= 14


@pytest.mark.parametrize("stub", STUBS, ids=lambda stub: str(stub.parent))
def test_a_stub_is_read_as_type_checkers_read_it(stub):
    text = (ROOT / stub).read_text()
    assert read_stub(text) == by_parser(text) != {}


@pytest.mark.parametrize("stub", STUBS, ids=lambda stub: str(stub.parent))
def test_a_package_gives_what_its_stub_lists(stub):
    package = import_module("raygrid." + ".".join(stub.parent.parts))
    listed = read_stub((ROOT / stub).read_text())
    assert dir(package) == sorted(listed)
    for name, module in listed.items():
        inner = import_module(f"{package.__name__}.{module}")
        assert getattr(package, name) is getattr(inner, name)


@pytest.mark.parametrize(
    "line",
    [
        "from .cache import Keeping as Kept",
        "from .cache import Keeping",
        "from cache import Keeping as Keeping",
        "import cache as cache",
        "from .cache import Keeping as Keeping, REMEDY as REMEDY",
        "__all__ = []",
        "",
    ],
)
def test_a_line_of_another_form_is_refused(line):
    with pytest.raises(ValueError, match="a stub has the line"):
        read_stub(f"from .cache import NAME as NAME\n{line}\n")


def test_what_no_stub_lists_is_no_attribute():
    from raygrid.node import jit

    with pytest.raises(AttributeError, match=r"raygrid\.node\.jit gives no sieve"):
        jit.sieve  # noqa: B018
    assert not hasattr(jit, "__all__")
    with pytest.raises(ImportError, match="sieve"):
        from raygrid.node.jit import sieve  # noqa: F401


def test_a_name_is_loaded_when_it_is_asked_for():
    look = """
import sys
from raygrid.node import geometry
assert "raygrid.node.geometry.spanning_tree" not in sys.modules
from raygrid.node.geometry import corners
assert "raygrid.node.geometry.spanning_tree" in sys.modules
assert vars(geometry)["corners"] is corners
assert "raygrid.node.geometry.bvh" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", look], check=True, timeout=60)


@pytest.mark.parametrize("layer", ["node", "emulator"])
def test_the_map_of_a_layer_names_its_packages_and_what_they_give(layer):
    text = ast.get_docstring(ast.parse((ROOT / layer / "__init__.py").read_text()))
    lines = [line.split(maxsplit=1) for line in text.splitlines() if line.startswith("    ")]
    packages = {path.parent.name for path in ROOT.glob(f"{layer}/*/__init__.pyi")}
    assert {package for package, _ in lines} == packages
    for package, told in lines:
        given = read_stub((ROOT / layer / package / "__init__.pyi").read_text())
        names = re.findall(r"`(\w+)`", told)
        assert names
        assert set(names) <= set(given)
