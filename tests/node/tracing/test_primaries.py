"""Each sample whose ray enters the world box is born at its home, once, and coarse comes before fine."""

from __future__ import annotations

import numpy as np
import pytest
from support.cameras import bad_places, random_cameras
from support.frames import make_frame, perspective
from support.kernels import Samples, all_samples
from support.packets import rows
from support.space import UNEVEN_STEP, Index, even_space, indices, uneven_space

from raygrid.node.geometry.bvh import DEPTH
from raygrid.node.geometry.lattice import HALF, LONGEST_STEP, SLOW, Space, coordinate, make_cell
from raygrid.node.protocol import decoding, packets, packing
from raygrid.node.protocol.counters import BORN, COUNTS
from raygrid.node.protocol.frame_tables import Frame
from raygrid.node.tracing.camera import TRIES
from raygrid.node.tracing.framebuffer import Pixels, make_pixels, slot
from raygrid.node.tracing.local_geometry import empty_surfaces
from raygrid.node.tracing.output_queues import make_outputs
from raygrid.node.tracing.primaries import DONE, new_cursor, spawn_primaries
from raygrid.node.tracing.step_tables import StepTables

WHITE = packing.pack_weight(1.0, 1.0, 1.0)
SPACES = {
    "1x1x1": even_space((1, 1, 1)),
    "3x2x1": even_space((3, 2, 1), UNEVEN_STEP),
    "uneven 4x4x4": uneven_space((2.0**-23,) * 3),
    "flat 2x2x2": even_space((2, 2, 2), (0.9 / HALF, 2.1e-3 / HALF, 0.5 / HALF)),
}


def born(frame: Frame, space: Space, index: Index, room: int = 10_000) -> tuple[list[bytes], Pixels, np.ndarray]:
    """(packets in the order in which a node spawns them, its pixel store, its counts)."""
    cell = make_cell(space, index)
    pixels = make_pixels(frame, space, cell)
    cursor, counts, found = new_cursor(len(pixels.first) > 0), np.zeros(COUNTS, np.int64), []
    tables = StepTables(cell, space, frame, empty_surfaces(), pixels, make_outputs(1, DEPTH), counts)
    buffer = np.zeros((room + 3) * packets.SIZE, np.uint8)
    while cursor[DONE] == 0:
        made = spawn_primaries(tables, cursor, buffer, 2, room)
        assert made <= room
        assert made == room or cursor[DONE] == 1
        data = buffer.tobytes()
        assert not any(data[: 2 * packets.SIZE]), "written before its room"
        assert not any(data[-packets.SIZE :]), "written behind its room"
        found += [data[(2 + k) * packets.SIZE : (3 + k) * packets.SIZE] for k in range(made)]
    return found, pixels, counts


def check_births(frame: Frame, space: Space) -> int:
    """Every sample that enters is born at its home, and nowhere else; returns how many are."""
    samples = all_samples(frame, space)
    times_born = np.zeros(len(samples.enters), int)
    for index in indices(space):
        found, pixels, counts = born(frame, space, index)
        numbers = np.array([int.from_bytes(data[1:5], "little") for data in found], int)
        np.add.at(times_born, numbers, 1)
        assert (samples.homes[numbers] == index).all()
        assert counts[BORN + packets.PRIMARY] == len(found) == pixels.samples.sum()
        check_slots(frame, samples, index, pixels)
    np.testing.assert_array_equal(times_born, samples.enters)
    return int(samples.enters.sum())


def check_slots(frame: Frame, samples: Samples, index: Index, pixels: Pixels) -> None:
    """The store has a place for each of its samples, and counts them there."""
    own = np.flatnonzero(samples.enters & (samples.homes == index).all(1)) // frame.samples
    for pixel, many in zip(*np.unique(own, return_counts=True), strict=True):
        place = slot(pixels, int(pixel) % frame.width, int(pixel) // frame.width)
        assert place >= 0, f"home {index} has no place for pixel {pixel}"
        assert pixels.samples[place] == many


@pytest.mark.parametrize("split", SPACES)
@pytest.mark.parametrize(("size", "samples"), [((23, 17), 1), ((13, 11), 4)])
def test_each_sample_is_born_once_from_bad_places(split, size, samples):
    entering = {}
    for name, camera in bad_places(SPACES[split], size).items():
        entering[name] = check_births(make_frame(camera, size, samples=samples), SPACES[split])
    assert sum(many > 0 for many in entering.values()) > 25
    assert entering["behind"] == entering["parallel, away"] == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 19), (19, 1), (2, 2), (1, 2)])
def test_pictures_of_one_row_or_column(size):
    space = SPACES["uneven 4x4x4"]
    for camera in bad_places(space, size).values():
        check_births(make_frame(camera, size, samples=3), space)


@pytest.mark.parametrize("split", SPACES)
def test_each_sample_is_born_once_from_anywhere(split):
    rng = np.random.default_rng(17)
    for camera in random_cameras(rng, SPACES[split], (16, 12), 60):
        check_births(make_frame(camera, (16, 12), samples=2), SPACES[split])


def test_large_pictures_from_very_near():
    """Pixels far outside the picture, and many of them to one lattice step, must not bend outlines."""
    size, space = (700, 2), SPACES["3x2x1"]
    half = HALF * np.array(space.step)
    for off in (1e-8, 1e-7, 1e-6, 1e-5, 1e-4):
        for tilt in (0.0, 1e-7, 1e-4, 0.1):
            camera = perspective([0.1, half[1] + off, 0.05], [1.0, -tilt, 0.3], 1.0, size, up=(0, 0.2, 1))
            check_births(make_frame(camera, size), space)


# --- what is born -----------------------------------------------------------------------------------------


def test_the_packets_of_primary_rays():
    size, space = (9, 7), SPACES["3x2x1"]
    frame = make_frame(bad_places(space, size)["in front"], size, samples=2)
    samples = all_samples(frame, space)
    half = HALF * np.array(space.step)
    for index in indices(space):
        for data in born(frame, space, index)[0]:
            packet = decoding.decode(data)
            assert (packet.kind, packet.depth, packet.values) == (packets.PRIMARY, 1, (1.0, 1.0, 1.0))
            assert packets.read_u32(rows(data), 20) | data[24] << 32 == WHITE
            np.testing.assert_allclose(packet.direction, samples.directions[packet.number], atol=4.25 * 2.0**-24)
            # its home's point lies on the box, its origin there or a little further on, both on the ray from the eye
            entered, start = (
                np.array([coordinate(k, step) for k, step in zip(point, space.step, strict=True)])
                for point in (samples.points[packet.number], packet.origin)
            )
            assert (np.abs(np.abs(entered) - half) <= 1.01 * np.array(space.step)).any()
            eye, d = frame.camera[0], samples.directions[packet.number]
            for at in (entered, start):
                assert np.linalg.norm(np.cross(at - eye, d)) <= np.linalg.norm(space.step)
            assert -max(space.step) <= (start - entered) @ d <= (TRIES + 1) * LONGEST_STEP / SLOW


@pytest.mark.parametrize("name", ["inside", "inside, on a plane between cells", "on a face, looking in"])
def test_rays_of_an_eye_inside_have_the_cell_of_the_rounded_eye_as_home(name):
    size, space = (5, 4), SPACES["uneven 4x4x4"]
    frame = make_frame(bad_places(space, size)[name], size)
    samples = all_samples(frame, space)
    assert samples.enters.all()
    assert len(np.unique(samples.points, axis=0)) == 1
    at = (samples.points[0] - HALF) * np.array(space.step)
    np.testing.assert_allclose(at, frame.camera[0], rtol=0, atol=max(space.step))


@pytest.mark.parametrize("samples", [2, 5, 16])
def test_samples_lie_in_their_pixels_and_apart(samples):
    size = (6, 5)
    camera = perspective([0, 0, 2.0], [0, 0, -1], 20, size, up=(0, 1, 0))
    places = np.linalg.solve(
        camera[3:6].T, all_samples(make_frame(camera, size, samples=samples), SPACES["1x1x1"]).directions.T
    )
    ij = (places[1:] / places[0]).T.reshape(-1, samples, 2)
    pixels = np.array([(n % 6, n // 6) for n in range(30)])[:, None]
    assert (np.abs(ij - pixels) <= 0.5 + 1e-9).all()
    for points in ij - pixels:  # the plastic sequence keeps them apart, in every pixel in its own way
        gaps = np.linalg.norm(points[:, None] - points + 9 * np.eye(samples)[:, :, None], axis=2)
        assert gaps.min() > 0.15 / np.sqrt(samples)
    assert len(np.unique(np.round((ij - pixels)[:, 0], 6), axis=0)) == 30


def test_one_sample_lies_in_the_middle_of_its_pixel():
    size = (6, 5)
    camera = perspective([0, 0, 2.0], [0, 0, -1], 20, size, up=(0, 1, 0))
    directions = all_samples(make_frame(camera, size), SPACES["1x1x1"]).directions
    places = np.linalg.solve(camera[3:6].T, directions.T)
    np.testing.assert_allclose((places[1:] / places[0]).T, [(n % 6, n // 6) for n in range(30)], atol=1e-9)


# --- in which order ---------------------------------------------------------------------------------------


def fineness(n: int, frame: Frame) -> tuple[int, int, int, int]:
    """Key of the order of primaries: sample number, level, row, column."""
    pixel, number = divmod(n, frame.samples)
    j, i = divmod(pixel, frame.width)
    stride = next(s for s in (8, 4, 2, 1) if i % s == 0 and j % s == 0)
    return number, -stride, j, i


@pytest.mark.parametrize("room", [1, 2, 7, 64, 10_000])
@pytest.mark.parametrize("name", ["in front", "inside", "parallel, askew"])
def test_coarse_to_fine_whatever_the_room(name, room):
    """However primaries are cut into calls, the order is the same, and every sample comes once."""
    size, space = (21, 19), SPACES["3x2x1"]
    frame = make_frame(bad_places(space, size)[name], size, samples=2)
    for index in indices(space):
        found, _, _ = born(frame, space, index, room)
        numbers = [int.from_bytes(data[1:5], "little") for data in found]
        assert numbers == sorted(numbers, key=lambda n: fineness(n, frame))
        assert len(set(numbers)) == len(numbers)


def test_a_home_without_pixels_bears_nothing():
    size, space = (8, 8), SPACES["3x2x1"]
    frame = make_frame(bad_places(space, size)["behind"], size)
    for index in indices(space):
        found, pixels, _ = born(frame, space, index)
        assert found == []
        assert new_cursor(False)[DONE] == 1
        assert slot(pixels, 0, 0) in (-1, 0)
