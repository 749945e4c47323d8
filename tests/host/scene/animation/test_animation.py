"""Shots: keys of a scene file, turntables, and the jobs of frames."""

from __future__ import annotations

import numpy as np
import pytest
from support.render import SCENES

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.host.render.animation_jobs import jobs_of
from raygrid.host.render.frame import render_job
from raygrid.host.render.job import Settings, make_job
from raygrid.host.scene.animation.motions import about, after, motion, moved_point
from raygrid.host.scene.animation.scene_frames import animation_bounds
from raygrid.host.scene.animation.turntable import turntable
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry.lattice import HALF
from raygrid.node.geometry.quaternion import quaternion_of_angles
from raygrid.node.geometry.rigid_motion import moved_rows, placed
from raygrid.node.geometry.surfaces import Kind

pytestmark = pytest.mark.usefixtures("quick_records")

SHOT = """
[shot]
frames = 9
[image]
width = 40
height = 30
[camera]
from = [0, 2, 9]
at = [0, 1, 0]
[[camera.keys]]
frame = 1
from = [0, 2, 9]
fov = 40
[[camera.keys]]
frame = 9
from = [3, 3, 8]
fov = 50
[materials.paint]
colour = [1, 0, 0]
[[materials.paint.keys]]
frame = 1
colour = [1, 0, 0]
[[materials.paint.keys]]
frame = 9
colour = [0, 0, 1]
specular = 0.5
[materials.same]
colour = [1, 0, 0]
[[lights]]
kind = "point"
position = [3, 6, 4]
[[lights.keys]]
frame = 1
intensity = 1
[[lights.keys]]
frame = 9
intensity = 0.5
position = [-3, 6, 4]
[[lights]]
kind = "directional"
towards = [0, 1, 0]
[[lights.keys]]
frame = 1
towards = [0, 1, 0]
[[lights.keys]]
frame = 5
towards = [1, 1, 0]
[groups.body]
pivot = [0, 1, 0]
[[groups.body.keys]]
frame = 1
translate = [-2, 0, 0]
[[groups.body.keys]]
frame = 9
translate = [2, 0, 0]
rotate = [0, 90, 0]
[groups.moon]
parent = "body"
interpolation = "smooth"
[[groups.moon.keys]]
frame = 1
scale = 1
[[groups.moon.keys]]
frame = 9
scale = 2
rotate = [0, 360, 0]
[[surfaces]]
kind = "box"
low = [-4, -0.1, -4]
high = [4, 0, 4]
[[surfaces]]
kind = "box"
group = "body"
material = "paint"
low = [-0.5, 0.5, -0.5]
high = [0.5, 1.5, 0.5]
[[surfaces]]
kind = "sphere"
group = "moon"
material = "same"
centre = [1.2, 1, 0]
radius = 0.3
[[surfaces]]
kind = "cone"
group = "moon"
base = [-1.2, 1, 0]
base_radius = 0.3
apex = [-1.2, 2, 0]
[[meshes]]
file = "ball.obj"
group = "body"
translate = [0, 2, 0]
"""
BALL = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nf 1 2 3\nf 1//1 2//1 4//1\n"


@pytest.fixture
def read(tmp_path):
    def read(text=SHOT):
        (tmp_path / "ball.obj").write_text(BALL)
        (tmp_path / "shot.toml").write_text(text)
        return load_scene(tmp_path / "shot.toml")

    return read


def in_memory(shape):
    array = MemoryArray(shape)
    array.driver.patience = 60.0  # a first run compiles
    array.driver.ready()
    return array


# --- motions -------------------------------------------------------------------------------------


def test_motions_one_after_the_other():
    rng = np.random.default_rng(1)
    for _ in range(20):
        a = motion(quaternion_of_angles(rng.uniform(-180, 180, 3)), float(rng.uniform(0.1, 3)), rng.normal(size=3))
        b = motion(quaternion_of_angles(rng.uniform(-180, 180, 3)), float(rng.uniform(0.1, 3)), rng.normal(size=3))
        point = rng.normal(size=3)
        assert np.allclose(moved_point(after(b, a), point), moved_point(b, moved_point(a, point)))
    assert np.allclose(moved_point(motion(quaternion_of_angles([90, 0, 0])), [0, 1, 0]), [0, 0, 1])
    assert np.allclose(moved_point(motion(quaternion_of_angles([90, 0, 90])), [0, 0, 1]), [1, 0, 0])  # x first, then z
    assert np.allclose(moved_point(about([1, 2, 3], quaternion_of_angles([10, 20, 30]), 5.0), [1, 2, 3]), [1, 2, 3])


@pytest.mark.parametrize("kind", list(Kind))
def test_surfaces_keep_their_shape(kind):
    """Distances grow by the scale, normals turn, and radii keep their sign."""
    rng = np.random.default_rng(2)
    by = motion(quaternion_of_angles([10, 200, -70]), 1.7, [0.1, 0.2, -0.4])
    columns = {Kind.TRIANGLE: 9, Kind.SMOOTH: 18, Kind.POLYGON: 3, Kind.SPHERE: 4}.get(kind, 8)
    data = rng.normal(size=(5, columns))
    now = moved_rows(kind, data, np.tile(by, (5, 1)))
    for first in (0, 3, 6) if kind in (Kind.TRIANGLE, Kind.SMOOTH) else (0, 4) if columns == 8 else (0,):
        expected = [moved_point(by, point) for point in data[:, first : first + 3]]
        assert np.allclose(now[:, first : first + 3], expected)
    if kind == Kind.SMOOTH:
        assert np.allclose(np.linalg.norm(now[:, 9:12], axis=1), np.linalg.norm(data[:, 9:12], axis=1))
    if columns in (4, 8):
        assert np.allclose(now[:, 3::4], 1.7 * data[:, 3::4])


# --- the scene file ------------------------------------------------------------------------------


def test_keys_of_a_scene_file(read):
    scene = read()
    shot = scene.shot
    assert (shot.frames, shot.fps, shot.names) == (9, 24.0, ("body", "moon"))
    first, middle, last = shot.at(1), shot.at(5), shot.at(9)
    assert first.camera.eye == (0, 2, 9)
    assert middle.camera.eye == (1.5, 2.5, 8.5)
    assert np.degrees(2 * np.arctan(last.camera.half)) == pytest.approx(50)
    assert middle.lights["intensity"][0].tolist() == [0.75] * 3
    assert middle.lights["place"][0].tolist() == [-3, 6, 4]  # its only key
    assert np.allclose(middle.lights["place"][1], [0.5**0.5, 0.5**0.5, 0])
    red = [row for row in range(len(first.materials)) if first.materials["diffuse"][row].tolist() == [1, 0, 0]]
    assert len(red) == 2  # what changes is never one with what is equal now
    assert sorted(last.materials["diffuse"][red].tolist()) == [[0, 0, 1], [1, 0, 0]]
    assert np.allclose(moved_point(middle.motions[0], [0, 1, 0]), [0, 1, 0])  # the pivot, half way
    assert np.allclose(moved_point(last.motions[0], [1, 1, 0]), [2, 1, -1])
    assert last.motions[1, 4] == 2.0
    assert np.allclose(moved_point(last.motions[1], [0, 0, 0]), moved_point(last.motions[0], [0, 0, 0]))


def test_groups_name_the_surfaces_that_were_put_in_them(read):
    scene = read()
    number = {int(i): int(g) for b in scene.surfaces for i, g in zip(b.ids, scene.shot.groups.of(b.ids), strict=True)}
    kinds = {int(i): b.kind for b in scene.surfaces for i in b.ids}
    assert [number[i] for i in sorted(number)] == [-1] * 6 + [0] * 6 + [1, 1] + [0, 0]
    assert [kinds[i] for i in (12, 13)] == [Kind.SPHERE, Kind.CONE]


def test_a_bent_polygon_in_a_group_is_cut_where_a_still_one_is_kept(read):
    polygon = '[[surfaces]]\nkind = "polygon"\npoints = [[0, 3, 0], [0.1, 3, 0], [0.1, 3.1, 6e-7], [0, 3.1, 0]]\n'
    still, moving = read(SHOT + polygon), read(SHOT + polygon + 'group = "moon"\n')
    assert still.surfaces.count(Kind.POLYGON) == moving.surfaces.count(Kind.POLYGON) + 1
    assert moving.shot.groups.of(np.array([14, 15])).tolist() == [1, 1]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "frame = 9\nscale = 2",
            "frame = 1\nscale = 2",
            r"line \d+: groups.moon.keys is .*, wanted keys in ascending order of frames, key 1 is at 1 after 1",
        ),
        ("frame = 9\nscale = 2", "frame = 9\nscale = 0", r"groups.moon.keys\[1\].scale is 0, wanted greater than 0"),
        ("frame = 9\nscale = 2", "frame = 9\nscale = nan", r"groups.moon.keys\[1\].scale is nan, wanted"),
        (
            "frame = 9\nscale = 2",
            "frame = 9\nskale = 2",
            r"the key groups.moon.keys\[1\].skale is unknown, wanted one of: frame, translate, rotate, scale",
        ),
        ("translate = [2, 0, 0]", "translate = [inf, 0, 0]", r"groups.body.keys\[1\].translate\[0\] is inf, wanted"),
        ('parent = "body"', 'parent = "bodi"', r"line \d+: groups.moon.parent is 'bodi', wanted one of: body, moon"),
        ('parent = "body"', 'parent = "moon"', "leads back to 'moon', wanted no circle"),
        ('group = "moon"', 'group = "mon"', r"line \d+: surfaces\[2\].group is 'mon', wanted one of: body, moon"),
        ("frames = 9", "frames = 0", r"line 3: shot.frames is 0, wanted greater than or equal to 1"),
        (
            "frame = 9\nintensity = 0.5",
            "frame = 9\ntowards = [0, 1, 0]",
            r"the key lights\[0\].keys\[1\].towards is unknown",
        ),
        ("fov = 50", "orthographic = 3", "wanted either fov or orthographic, not both"),
    ],
)
def test_wrong_keys_are_told_with_their_line(read, old, new, said):
    assert old in SHOT
    with pytest.raises(SceneError, match=said):
        read(SHOT.replace(old, new))


def test_a_light_that_turns_through_nothing_is_an_error_of_that_frame(read):
    scene = read(SHOT.replace("frame = 5\ntowards = [1, 1, 0]", "frame = 5\ntowards = [0, -1, 0]"))
    scene.shot.at(2)
    with pytest.raises(SceneError, match="frame 3: a light of the kind directional shines nowhere"):
        scene.shot.at(3)
    with pytest.raises(SceneError, match="frame 10 came, wanted one of the shot's frames 1 to 9"):
        scene.shot.at(10)


# --- boxes and jobs ------------------------------------------------------------------------------


def test_the_world_box_is_that_of_all_frames_and_of_no_more(read):
    scene = read()
    box = animation_bounds(scene)
    frames = []
    for job in jobs_of(scene, (1, 1, 1), Settings()):
        now = [placed(batch, job.moves).bounds() for batch in job.surfaces]
        frames.append(np.concatenate(now).reshape(-1, 3) / job.world.scale + job.world.centre)
        half = HALF * np.array(job.space.step)
        assert all((np.abs(boxes) < half).all() for boxes in now)
    points = np.concatenate(frames)
    assert np.allclose([points.min(0), points.max(0)], box, atol=1e-5)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 2, 2), (3, 2, 1)])
def test_frames_one_after_the_other_have_the_bits_of_frames_alone(read, shape):
    scene, settings = read(), Settings()
    array, alone = in_memory(shape), in_memory(shape)
    sums = []
    for job in jobs_of(scene, shape, settings):
        picture = render_job(array.driver, job)
        (single,) = jobs_of(scene, shape, settings, [job.number])
        assert np.array_equal(render_job(alone.driver, single).sums, picture.sums), job.number
        assert picture.stats["frame"] == job.number
        sums.append(picture.sums.tobytes())
    assert len(set(sums)) == 9
    backwards = list(jobs_of(scene, shape, Settings(split="uniform"), range(9, 0, -2)))
    assert [job.number for job in backwards] == [9, 7, 5, 3, 1]
    for job in backwards:
        assert render_job(array.driver, job).sums.tobytes() == sums[job.number - 1]


def test_a_still_scene_between_frames_and_a_frame_after_it(read):
    scene, settings = read(), Settings(size=(24, 18))
    still = make_job(load_scene(SCENES / "tiny.nff"), (2, 2, 1), settings)
    one, two, three = jobs_of(scene, (2, 2, 1), settings, [1, 2, 3])
    array, alone = in_memory((2, 2, 1)), in_memory((2, 2, 1))
    for job in (one, still, two, three, still, one):
        assert np.array_equal(render_job(array.driver, job).sums, _loaded_afresh(alone, job))


def _loaded_afresh(array, job):
    array.driver.held = None
    return render_job(array.driver, job).sums


def test_a_small_group_described_far_away_keeps_its_shape(read):
    """In coordinates of its own it loses no digits; in the scene's it would be off by a hundredth of its size."""
    text = SHOT[: SHOT.index("[groups.body]")] + (
        "[groups.far]\npivot = [1e6, 0, 0]\n[[groups.far.keys]]\nframe = 1\ntranslate = [-1e6, 0, 0]\n"
        '[[surfaces]]\nkind = "triangle"\ngroup = "far"\npoints = [[1e6, 0, 0], [1000001.0, 0, 0], [1e6, 1, 0]]\n'
        '[[surfaces]]\nkind = "triangle"\npoints = [[0, 0, 1], [1, 0, 1], [0, 1, 1]]\n'
    )
    (job,) = jobs_of(read(text), (1, 1, 1), Settings(), [1])
    (rows,) = (placed(batch, job.moves) for batch in job.surfaces)
    moving, still = (rows.data[k].reshape(3, 3) / job.world.scale + job.world.centre for k in (0, 1))
    assert np.allclose(moving, still - [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("frames", "said"), [([10], "frame 10 came, wanted frames 1 to 9"), ([0], "frame 0 came"), ([], "no frame came")]
)
def test_frames_that_the_shot_has_not(read, frames, said):
    with pytest.raises(SceneError, match=said):
        next(jobs_of(read(), (1, 1, 1), Settings(), frames))


def test_a_still_scene_has_one_job_without_a_number():
    scene = load_scene(SCENES / "tiny.nff")
    (job,) = jobs_of(scene, (2, 1, 1), Settings(size=(8, 8)))
    assert (job.number, job.moves) == (None, None)
    with pytest.raises(SceneError, match="for a scene that does not change"):
        next(jobs_of(scene, (2, 1, 1), Settings(), [2]))


# --- turntables ----------------------------------------------------------------------------------


@pytest.mark.parametrize("turn_scene", [False, True])
def test_turntables_see_the_same_from_all_sides(turn_scene):
    """The camera round the scene sees what it sees of the scene turned the other way: each point at the same place."""
    scene = load_scene(SCENES / "tiny.nff")
    shot = turntable(scene, 8, turn_scene).shot
    still = shot.at(1)
    points = np.concatenate([b.data[:, :3] for b in scene.surfaces if b.kind == Kind.SPHERE])
    assert still.camera == scene.camera
    for frame in range(1, 9):
        pose = shot.at(frame)
        camera = pose.camera
        there = np.array([moved_point(pose.motions[0], p) for p in points]) if turn_scene else points
        seen = (there - np.array(camera.eye)) @ np.array([camera.right, camera.up, camera.forward]).T
        other = turntable(scene, 8, not turn_scene).shot.at(frame)
        there = points if turn_scene else np.array([moved_point(other.motions[0], p) for p in points])
        camera = other.camera
        assert np.allclose(seen, (there - np.array(camera.eye)) @ np.array([camera.right, camera.up, camera.forward]).T)
    assert len(shot.names) == int(turn_scene)


def test_the_turned_scene_has_the_bits_of_fresh_loads():
    scene, settings = turntable(load_scene(SCENES / "kinds.nff"), 5, True), Settings(size=(32, 24))
    array, alone = in_memory((2, 2, 2)), in_memory((1, 1, 1))
    jobs = zip(jobs_of(scene, (2, 2, 2), settings), jobs_of(scene, (1, 1, 1), settings), strict=True)
    for job, other in jobs:
        assert np.array_equal(render_job(array.driver, job).sums, _loaded_afresh(alone, other))


def test_wrong_turntables(read):
    with pytest.raises(SceneError, match="moves by itself"):
        turntable(read(), 3)
    with pytest.raises(SceneError, match="0 frames"):
        turntable(load_scene(SCENES / "tiny.nff"), 0)


@pytest.mark.parametrize(
    ("name", "text", "axis"),
    [
        ("s.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", (0, 1, 0)),
        (
            "s.stl",
            "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid",
            (0, 0, 1),
        ),
        ("s.nff", "v from 0 -1 9 at 0 0 0 up 0 0 1 angle 40 hither 1 resolution 8 8\ns 0 0 0 1\n", (0, 0, 1)),
        (
            "s.toml",
            '[camera]\nfrom = [0, 9, 1]\nat = [0, 0, 0]\n[[surfaces]]\nkind = "sphere"\ncentre = [0, 0, 0]\nradius = 1\n',
            (0, 1, 0),
        ),
    ],
)
def test_a_turntable_turns_about_what_is_up_in_the_world_however_the_camera_is_tilted(tmp_path, name, text, axis):
    (tmp_path / name).write_text(text)
    scene = load_scene(tmp_path / name)
    shot = turntable(scene, 4).shot
    heights = [float(np.dot(shot.at(frame).camera.eye, axis)) for frame in range(1, 5)]
    assert np.allclose(heights, heights[0])
    assert not np.allclose(shot.at(1).camera.eye, shot.at(3).camera.eye)
