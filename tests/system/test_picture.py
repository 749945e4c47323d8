"""The picture of the packages is that of the sources: `make picture` draws it."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree

import pytest
from support.modules import Import, read_modules
from support.paths import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import make_picture

MODULES = read_modules(ROOT)


def test_the_picture_is_that_of_the_sources():
    assert make_picture.draw(MODULES) == make_picture.PICTURE.read_text(), "out of date: make picture"
    assert make_picture.main(["--check"]) == 0


def test_it_is_a_picture_of_all_packages():
    drawn = ElementTree.fromstring(make_picture.PICTURE.read_text())
    words = [text.text for text in drawn.iter("{http://www.w3.org/2000/svg}text")]
    assert {name.partition(".")[2] for name in make_picture.PLACES} <= set(words)


def test_another_import_gives_another_picture():
    front = MODULES["host.text.tables"]
    other = front._replace(imports=(*front.imports, Import("node.tracing.step", "step", 1)))
    assert ("host.text", "node.tracing") not in make_picture.arrows(MODULES)
    assert ("host.text", "node.tracing") in make_picture.arrows({**MODULES, "host.text.tables": other})


def test_arrows_that_a_longer_way_implies_are_left_out():
    drawn = make_picture.arrows(MODULES)
    assert ("node.tracing", "node.protocol") in drawn
    assert ("node.tracing", "node.geometry") not in drawn


def test_a_package_without_a_place_is_named():
    attic = MODULES["node.errors"]._replace(name="node.attic.old")
    with pytest.raises(ValueError, match=r"differ: \['node.attic'\]"):
        make_picture.draw({**MODULES, "node.attic.old": attic})
