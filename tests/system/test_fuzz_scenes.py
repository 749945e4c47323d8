"""Scenes with numbers at their extremes: a small share of `benchmarks/fuzz_scenes.py`, and what it has found."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from support import paths
from support.render import EIGHT, ONE, rendered

from raygrid.host.scene.lights import directional_light
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import SceneError

sys.path.insert(0, str(paths.ROOT / "benchmarks"))
from fuzz_scenes import LIMIT, REFUSED, RIGHT, in_memory, tried
from fuzz_scenes_texts import FORMATS, NUMBER, make_case

SHARE = 42  # scenes
VIEW = "v\nfrom 0 0 5\nat 0 0 0\nup 0 1 0\nangle {angle}\nhither 1\nresolution 9 9\nl 1 2 5\n"
BOX = """p 4 -1 -1 1 1 -1 1 1 1 1 -1 1 1
p 4 -1 1 -1 1 1 -1 1 -1 -1 -1 -1 -1
p 4 -1 -1 -1 1 -1 -1 1 -1 1 -1 -1 1
p 4 -1 1 1 1 1 1 1 1 -1 -1 1 -1
p 4 1 -1 1 1 -1 -1 1 1 -1 1 1 1
p 4 -1 -1 -1 -1 -1 1 -1 1 1 -1 1 -1
"""


@pytest.fixture(scope="module")
def arrays():
    return in_memory()


def test_numbers_at_their_extremes_give_the_same_bits_or_one_sentence(arrays, tmp_path):
    wrong = []
    seen = set()
    for number in range(SHARE):
        case = make_case(2024, number)
        (tmp_path / str(number)).mkdir()
        outcome = tried(case.write(tmp_path / str(number)), arrays)
        seen.add(outcome.what)
        if outcome.what not in (RIGHT, REFUSED) or outcome.seconds > LIMIT:
            wrong.append((number, outcome, case.changes))
    assert not wrong
    assert seen == {RIGHT, REFUSED}


@pytest.mark.parametrize("name", FORMATS)
def test_every_text_of_the_fuzz_is_rendered_as_it_stands(name, arrays, tmp_path):
    case = make_case(0, list(FORMATS).index(name))
    plain = {file: NUMBER.sub(lambda match: match[1], text) for file, text in FORMATS[name].items()}
    if "glTF" in name:
        from fuzz_scenes_texts import _finished

        plain = {file: _finished(file, text) for file, text in plain.items()}
    outcome = tried(case._replace(files=plain).write(tmp_path), {ONE: arrays[ONE]})
    assert outcome.what == RIGHT, outcome


# --- what it has found -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ior", ["1e16", "1e-30", "1000.1", "0.00099", "0", "-1"])
def test_an_index_of_refraction_has_bounds_in_nff(ior, tmp_path):
    path = tmp_path / "box.nff"
    path.write_text(VIEW.format(angle=40) + f"f 1 1 1 0.2 0 0 0.9 {ior}\n" + BOX)
    with pytest.raises(SceneError, match=r"line 9: a transparent fill's index of refraction must be 0\.001 to 1000"):
        load_scene(path)


def test_an_index_of_refraction_has_bounds_in_mtl(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl glass\nillum 7\nd 0.5\nNi 1e16\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl glass\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(
        SceneError, match=r"a\.obj: a material has the index of refraction 1e\+16, wanted 0\.001 to 1000"
    ):
        load_scene(tmp_path / "a.obj")


@pytest.mark.parametrize("ior", [0.001, 1000.0, 999.7])
def test_glass_at_the_bounds_has_the_same_bits_on_all_arrays(ior, tmp_path):
    path = tmp_path / "box.nff"
    path.write_text(VIEW.format(angle=40) + f"f 1 1 1 0.2 0.1 0 0.9 {ior}\n" + BOX)
    scene = load_scene(path)
    one, eight = (rendered(scene, shape, size=(15, 11), depth=6) for shape in (ONE, EIGHT))
    assert np.array_equal(one.sums, eight.sums)
    assert one.sums.any()


@pytest.mark.parametrize("size", [1e16, 1e-30, 0.0])
def test_no_index_whatever_spins_in_the_array(size, tmp_path):
    """What readers refuse cannot reach the nodes, but who hands over a scene in Python could: rays stay numbers."""
    path = tmp_path / "box.nff"
    path.write_text(VIEW.format(angle=40) + "f 1 1 1 0.2 0 0 0.9 1.5\n" + BOX)
    scene = load_scene(path)
    scene.materials["ior"] = size
    one, eight = (rendered(scene, shape, size=(15, 11), depth=6) for shape in (ONE, EIGHT))
    assert np.array_equal(one.sums, eight.sums)


def test_a_view_so_wide_that_it_loses_its_axis_is_refused(tmp_path):
    path = tmp_path / "box.nff"
    path.write_text(VIEW.format(angle="179.99999999999997") + BOX)
    with pytest.raises(
        SceneError, match=r"line 1: the camera's angle is 179\.99999999999997 degrees, wanted at most 179\.99"
    ):
        load_scene(path)


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1.0, 1e200])
def test_a_light_has_a_direction_however_long_the_vector_is(size):
    towards = directional_light((0.0, 0.6 * size, 0.8 * size), 1.0)["place"][0]
    assert np.linalg.norm(towards) == pytest.approx(1.0)


@pytest.mark.parametrize("scale", ["5e-324", "1e-310"])
def test_a_mesh_shrunk_to_nothing_is_one_sentence(scale, tmp_path):
    lines = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n"
    (tmp_path / "a.obj").write_text(lines)
    (tmp_path / "a.toml").write_text(f'[[meshes]]\nfile = "a.obj"\nscale = {scale}\n')
    with pytest.raises(SceneError, match=r"a\.toml, line 2: meshes\[0\]\.file cannot be placed: its scale is so small"):
        load_scene(tmp_path / "a.toml")


def test_a_camera_beyond_all_digits_is_one_sentence(tmp_path):
    path = tmp_path / "far.nff"
    path.write_text((VIEW.format(angle=40) + BOX).replace("from 0 0 5", "from 0 0 5e10"))
    with pytest.raises(
        SceneError, match=r"far\.nff: the camera's rays begin 4\.99e\+10 times .* wanted at most 1e\+09"
    ):
        rendered(load_scene(path), size=(3, 3))
