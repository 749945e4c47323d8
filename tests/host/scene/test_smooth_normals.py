"""Normals of meshes without any: smooth where edges bend little, sharp elsewhere, and the same however faces are cut."""

import numpy as np
import pytest
import trimesh

from raygrid.host.scene.load import load_scene
from raygrid.host.scene.smooth_normals import CREASE, crease_asked, crease_for, crease_of_file, smooth_normals
from raygrid.node.geometry import Kind


def corners_of(mesh):
    return np.asarray(mesh.vertices)[np.asarray(mesh.faces)]


def test_a_ball_has_the_normals_of_a_sphere():
    corners = corners_of(trimesh.creation.icosphere(3))
    normals, bent = smooth_normals(corners, CREASE)
    assert bent.all()
    assert np.abs(np.linalg.norm(normals, axis=2) - 1.0).max() < 1e-12
    assert np.einsum("nij,nij->ni", normals, corners).min() > np.cos(np.radians(0.5))


@pytest.mark.parametrize(("crease", "smooth"), [(0.0, 0), (40.0, 0), (89.0, 0), (91.0, 12)])
def test_a_cube_has_facets_until_its_right_angles_are_smooth(crease, smooth):
    assert smooth_normals(corners_of(trimesh.creation.box()), crease)[1].sum() == smooth


def test_the_normal_of_a_cube_does_not_depend_on_how_its_faces_are_cut():
    corners = corners_of(trimesh.creation.box())
    normals, _ = smooth_normals(corners, 100.0)
    assert np.allclose(normals, np.sign(corners) / np.sqrt(3.0))


def test_a_cylinder_is_round_and_its_ends_are_flat():
    corners = corners_of(trimesh.creation.cylinder(1.0, 2.0, sections=12))
    normals, bent = smooth_normals(corners, CREASE)
    flat = np.abs(np.ptp(corners[..., 2], axis=1)) < 1e-9
    assert (bent == ~flat).all()
    assert np.abs(normals[~flat][..., 2]).max() < 1e-12


def test_what_shares_an_edge_with_two_others_stays_flat_there():
    fin = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0.1]], [[1, 0, 0], [0, 0, 0], [0, -1, 0.1]],
                    [[1, 0, 0], [0, 0, 0], [0, 0.1, 1]]], np.float64)  # fmt: skip
    assert smooth_normals(fin[:2], CREASE)[1].all()
    assert not smooth_normals(fin, CREASE)[1].any()


def test_faces_without_area_and_turned_ones_harm_nobody():
    clean = corners_of(trimesh.creation.icosphere(2))
    corners = np.concatenate((clean, clean[:1, (0, 0, 1)], clean[5:6, ::-1] + 0.0))
    normals, _ = smooth_normals(corners, CREASE)
    assert np.isfinite(normals).all()
    shared = np.concatenate((clean[0, :2], clean[5]))  # corners of the edge and the triangle that came twice
    apart = ~(clean[:, :, None] == shared).all(axis=3).any(axis=(1, 2))
    assert apart.sum() > 250
    assert np.abs(normals[:-2][apart] - smooth_normals(clean, CREASE)[0][apart]).max() < 1e-12


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_size_does_not_matter(scale):
    corners = corners_of(trimesh.creation.icosphere(1))
    assert np.allclose(smooth_normals(corners * scale, CREASE)[0], smooth_normals(corners, CREASE)[0])


def test_a_strip_that_winds_on_and_on_is_one():
    steps = np.arange(5001) * 0.01
    edge = np.stack((np.cos(steps), np.sin(steps), 0.001 * steps), axis=1)
    inner, outer = edge, edge * (1.0, 1.0, 1.0) + (0.0, 0.0, 1.0)
    corners = np.stack((inner[:-1], inner[1:], outer[1:]), axis=1)
    other = np.stack((inner[:-1], outer[1:], outer[:-1]), axis=1)
    normals, bent = smooth_normals(np.concatenate((corners, other)), CREASE)
    assert bent.all()
    assert np.allclose(np.linalg.norm(normals, axis=2), 1.0)


def test_who_asks_for_a_crease_is_heard_before_the_file():
    assert crease_for(7.0) == 7.0
    with crease_of_file(30.0):
        assert crease_for(7.0) == 30.0
        with crease_asked(0.0):
            assert crease_for(7.0) == 0.0
    assert crease_for(7.0) == 7.0


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb"])
def test_files_without_normals_are_smooth_unless_their_format_says_flat(tmp_path, suffix):
    ball = trimesh.creation.icosphere(2)
    path = tmp_path / f"ball{suffix}"
    kept = {".stl": {}, ".ply": {"vertex_normal": False}}.get(suffix, {"include_normals": False})
    made = ball.export(file_type=suffix[1:], **kept)
    path.write_bytes(made.encode() if isinstance(made, str) else made)
    usual = load_scene(path).surfaces
    assert usual.count(Kind.SMOOTH) == (0 if suffix == ".glb" else 320)
    assert load_scene(path, crease=0).surfaces.count(Kind.SMOOTH) == 0
    assert load_scene(path, crease=60).surfaces.count(Kind.SMOOTH) == 320


def test_a_scene_file_says_the_crease_of_a_mesh(tmp_path):
    (tmp_path / "ball.stl").write_bytes(trimesh.creation.icosphere(2).export(file_type="stl"))
    for crease, smooth in (("", 320), ("crease = 0", 0)):
        (tmp_path / "s.toml").write_text(f'[[meshes]]\nfile = "ball.stl"\n{crease}\n')
        assert load_scene(tmp_path / "s.toml").surfaces.count(Kind.SMOOTH) == smooth
    assert load_scene(tmp_path / "s.toml", crease=20).surfaces.count(Kind.SMOOTH) == 320
