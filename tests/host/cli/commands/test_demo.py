"""The scene that every installation has: it is rendered, and it can be begun with."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.cli import here, warm_kernels
from support.render import rendered

from raygrid.host.cli.commands.demo import demo_path
from raygrid.host.scene.load import load_scene

__all__ = ["warm_kernels"]


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_it_is_rendered_as_render_does(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RAYGRID_SPLIT", "uniform")
    outcome = here("demo", "--array", "2x1x1", "--size", "32x24", "--samples", "1")
    assert (outcome.code, outcome.out) == (0, "demo.png\n")
    picture = rendered(load_scene(demo_path()), (1, 1, 1), size=(32, 24), samples=1)
    assert np.array_equal(np.asarray(Image.open("demo.png")), picture.bytes())
    assert picture.blank() is None
    again = here("demo", "--array", "2x1x1", "--size", "32x24", "--samples", "1", "-q", "-o", "a.npy", "-o", "b.png")
    assert again.out.split() == ["a.npy", "b.png"]
    assert np.array_equal(np.load("a.npy"), picture.sums)


def test_what_is_printed_is_the_file(tmp_path):
    printed = here("demo", "--print")
    assert (printed.code, printed.err) == (0, "")
    mine = tmp_path / "mine.toml"
    mine.write_text(printed.out)
    assert mine.read_bytes() == Path(demo_path()).read_bytes()
    scene = load_scene(mine)
    assert (scene.size, scene.samples, scene.remarks) == ((640, 480), 4, ())
