"""Scenes as .glb, .obj, .ply and .stl: what is read of them again, that round surfaces are round, and what is said to differ."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from support.render import SCENES, psnr, rendered

import raygrid
from raygrid.host.cli.main import cli
from raygrid.host.export.scene_file import export_file
from raygrid.host.export.tessellation import tessellated, upright
from raygrid.host.scene.cameras import usual_front
from raygrid.host.scene.finish import Y_UP, Z_UP
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import OutputError, SceneError
from raygrid.node.geometry import Kind


def one(kind, *numbers, **options):
    scene = raygrid.Scene()
    getattr(scene, kind)(*numbers, **options)
    return load_scene(scene)


def area_and_volume(parts):
    a, b, c = np.moveaxis(np.concatenate([part.corners for part in parts]), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0, np.einsum("ni,ni->", np.cross(a, b), c) / 6.0


@pytest.mark.parametrize("radius", [2.0, -2.0])
def test_a_ball_of_triangles_is_a_ball(radius):
    (part,) = tessellated(one("sphere", (1, 2, 3), radius).surfaces, "x")
    offsets = part.corners - (1, 2, 3)
    assert np.allclose(np.linalg.norm(offsets, axis=2), 2.0)
    assert np.allclose(part.normals, offsets / radius)
    area, volume = area_and_volume([part])
    assert area == pytest.approx(16 * np.pi, rel=5e-3)
    assert volume == pytest.approx(np.sign(radius) * 32 / 3 * np.pi, rel=1e-2)


@pytest.mark.parametrize(
    "numbers", [((0, 0, 0), 2, (1, 3, 2)), ((0, 0, 0), 1, (0, 4, 0), 0.5), ((0, 0, 1), 0.5, (0, 0, 0), 2)]
)
def test_the_side_of_a_cone_has_its_area_and_normals_that_point_out(numbers):
    (part,) = tessellated(one("cone", *numbers).surfaces, "x")
    base, wide, apex, narrow = (*numbers, 0.0)[:4]
    height = np.linalg.norm(np.subtract(apex, base))
    assert area_and_volume([part])[0] == pytest.approx(
        np.pi * (wide + narrow) * np.hypot(height, wide - narrow), rel=3e-3
    )
    flat = np.cross(part.corners[:, 1] - part.corners[:, 0], part.corners[:, 2] - part.corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.einsum("nij,nj->ni", part.normals, flat).min() > 0.99
    middle = (np.asarray(base) + apex) / 2.0
    assert (np.einsum("nj,nj->n", part.corners.mean(axis=1) - middle, flat) > 0).all()


def test_a_cylinder_is_open_and_a_polygon_is_cut():
    (side,) = tessellated(one("cylinder", (0, 0, 0), (0, 3, 0), 1.0).surfaces, "x")
    assert area_and_volume([side])[0] == pytest.approx(6 * np.pi, rel=1e-3)
    star = [(0, 0, 0), (4, 0, 0), (4, 4, 0), (2, 1, 0)]
    (flat,) = tessellated(one("polygon", star).surfaces, "x")
    assert flat.normals is None
    assert area_and_volume([flat])[0] == pytest.approx(6.0)


def plain_scene():
    """What a .glb can hold: matte surfaces, a sun and parallel rays or a lens."""
    scene = raygrid.Scene(background=(0.18, 0.20, 0.24), size=(96, 72))
    scene.material("red", diffuse=(0.7, 0.2, 0.1))
    scene.material("mirror", diffuse=0, specular=0.75)
    scene.sphere((0, 1, 0), 1, material="red")
    scene.cone((2, 0, 0), 0.7, (2, 2, 0), material="mirror")
    scene.polygon([(-5, 0, 5), (5, 0, 5), (5, 0, -5), (-5, 0, -5)])
    scene.directional_light((-1, 2, 1))
    scene.camera((0, 2, 8), (0, 1, 0), fov=35)
    return scene


AXES = [tuple(row) for row in (*np.eye(3), *-np.eye(3))]


def stood(scene, up):
    """The box of a scene, (2, 3), turned so that it stands upright where `up` points up."""
    turn = upright(scene, up)
    return scene.surfaces.bounds() if turn is None else np.sort(scene.surfaces.bounds() @ turn[0].T, axis=0)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("up", [Y_UP, Z_UP])
def test_a_scene_is_turned_and_not_mirrored_and_its_front_stays_the_front(axis, up):
    made = upright(replace(one("sphere", (0, 0, 0), 1), up=(0.3 * np.roll(axis, 1) + axis)), up)
    if axis == up:
        assert made is None
        return
    turn, told = made
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert sorted(np.abs(turn).ravel()) == [0.0] * 6 + [1.0] * 3
    assert (turn @ axis == up).all()
    assert (turn @ usual_front(axis) == usual_front(up)).all()
    assert told.endswith(f"in the scene and +{'xyz'[up.index(1.0)]} in files of this kind")


def tall_scene(up):
    """A cone that stands on a floor, where y or z is up, with something on its right and before it."""
    place = (lambda x, y, z: (x, y, z)) if up == Y_UP else (lambda x, y, z: (x, -z, y))
    scene = raygrid.Scene(background=(0.18, 0.20, 0.24), size=(72, 72))
    scene.material("red", diffuse=(0.7, 0.2, 0.1))
    scene.cone(place(0, 0, 0), 1, place(0, 3, 0), material="red")
    scene.sphere(place(2, 0.5, 0), 0.5)
    scene.sphere(place(0, 0.25, 1.5), 0.25, material="red")
    scene.polygon([place(*point) for point in ((-3, 0, 3), (3, 0, 3), (3, 0, -3), (-3, 0, -3))])
    scene.directional_light(place(-1, 2, 1))
    scene.camera(place(0, 2, 9), place(0, 1, 0), up=up, fov=40)
    return scene


@pytest.mark.parametrize("view", [{}, {"fit": "three-quarter"}, {"fit": "left"}])
def test_a_glb_of_a_scene_where_z_is_up_stands_upright(tmp_path, view):
    """It failed: it lay on its side for --fit, and in every other program."""
    told = []
    path = export_file(tall_scene(Z_UP), tmp_path / "a.glb", tell=told.append)
    assert told[-1] == "raygrid.Scene: turned, as what is up is +z in the scene and +y in files of this kind"
    pictures = [rendered(load_scene(given, **view), (1, 1, 1), size=(72, 72)) for given in (tall_scene(Z_UP), path)]
    assert psnr(*(picture.linear() for picture in pictures)) > 30.0


@pytest.mark.parametrize("up", [Y_UP, Z_UP])
@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
def test_a_scene_stands_upright_in_every_kind_as_it_is_read_again(tmp_path, suffix, up):
    scene = load_scene(export_file(tall_scene(up), tmp_path / f"a{suffix}"))
    assert scene.up == (Z_UP if suffix == ".stl" else Y_UP)
    assert np.allclose(scene.surfaces.bounds(), load_scene(tall_scene(scene.up)).surfaces.bounds(), atol=1e-6)


def test_a_glb_gives_the_picture_again(tmp_path):
    told = []
    path = export_file(plain_scene(), tmp_path / "a.glb", tell=told.append)
    pictures = [rendered(load_scene(given), (2, 1, 1), size=(96, 72)) for given in (plain_scene(), path)]
    assert psnr(*(picture.linear() for picture in pictures)) > 30.0
    assert told == [
        "raygrid.Scene: 2 round surfaces cut into triangles, 64 round the axis",
        "raygrid.Scene: 1 polygon cut into triangles",
        "raygrid.Scene: 1 material brought near: the format has no such weights",  # polished metal has a highlight there
        "raygrid.Scene: readers choose an exposure: only how bright lights are beside each other is said",
        "raygrid.Scene: the background is left out: the format has none",
    ]


def test_a_glb_keeps_camera_lights_and_materials(tmp_path):
    before, after = load_scene(plain_scene()), load_scene(export_file(plain_scene(), tmp_path / "a.glb"))
    for field in ("eye", "forward", "up", "half"):
        assert getattr(after.camera, field) == pytest.approx(getattr(before.camera, field), abs=1e-6)
    assert np.allclose(after.lights["place"], before.lights["place"])
    for field in ("diffuse", "specular", "transmission"):
        kept = [np.array(sorted(one.materials[field].tolist())) for one in (before, after)]
        assert np.allclose(*kept, atol=1e-6), field
    assert np.allclose(after.surfaces.bounds(), before.surfaces.bounds(), atol=2e-3)


@pytest.mark.parametrize("name", ["glass.toml", "kinds.nff", "lights.toml", "room.glb", "mobile.toml"])
def test_the_scenes_of_ours_are_written_and_read(tmp_path, name):
    scene = load_scene(export_file(SCENES / name, tmp_path / "a.glb"))
    own = load_scene(SCENES / name)
    assert len(scene.lights) == len(own.lights)
    if own.shot is None:
        assert np.allclose(scene.surfaces.bounds(), stood(own, Y_UP), rtol=1e-2, atol=1e-2)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_other_kinds_hold_the_triangles(tmp_path, suffix):
    told = []
    path = export_file(SCENES / "glass.toml", tmp_path / f"a{suffix}", tell=told.append)
    scene, own = load_scene(path), load_scene(SCENES / "glass.toml")
    assert scene.surfaces.count(Kind.TRIANGLE) + scene.surfaces.count(Kind.SMOOTH) > 1000
    assert np.allclose(scene.surfaces.bounds(), stood(own, scene.up), atol=1e-2)
    assert (len(scene.materials) > 3) == (suffix == ".ply")
    assert "left out: the format has none" in told[0]


@pytest.mark.parametrize(("own", "asked", "shine"), [(True, None, True), (True, False, False), (False, True, True)])
def test_highlights_are_written_as_they_are_asked_for(tmp_path, own, asked, shine):
    """It failed: a .glb had those of the scene, whatever was asked for."""
    scene = raygrid.Scene(highlights=own)
    scene.material("shiny", diffuse=0.5, highlight=0.4, shine=60)
    scene.sphere((0, 0, 0), 1, material="shiny")
    path = export_file(scene, tmp_path / "a.glb", highlights=asked)
    assert load_scene(path).materials["highlight"].any() == shine


def test_what_cannot_be_written_is_said(tmp_path):
    with pytest.raises(
        OutputError, match=r"a.txt: the file has the suffix '.txt', wanted one of: .pov .glb .obj .ply .stl"
    ):
        export_file(SCENES / "tiny.nff", tmp_path / "a.txt")
    for suffix in (".glb", ".ply", ".pov"):
        with pytest.raises(SceneError, match="surfaces of a program came, wanted a scene without"):
            export_file(SCENES / "rings.toml", tmp_path / f"a{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_the_command_says_what_differs(tmp_path):
    path = tmp_path / "a.glb"
    ran = CliRunner().invoke(
        cli, ["export", str(SCENES / "tiny.nff"), "-o", str(path), "--fit", "top"], catch_exceptions=False
    )
    assert ran.exit_code == 0, ran.output
    assert "note: tiny.nff: 5 round surfaces cut into triangles" in ran.output
    assert "note: tiny.nff: turned, as what is up is +z in the scene and +y in files" in ran.output
    assert load_scene(path).camera.forward == pytest.approx((0.0, -1.0, 0.0))


@pytest.mark.parametrize("suffix", [".glb", ".pov"])
def test_numbers_of_materials_for_a_program_are_said_to_be_left_out(tmp_path, suffix):
    told = []
    path = export_file(SCENES / "marble.toml", tmp_path / f"a{suffix}", tell=told.append)
    said = (tmp_path / path).read_text().splitlines() if suffix == ".pov" else told
    assert any("rules of a program are left out" in line for line in said)
