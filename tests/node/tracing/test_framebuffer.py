"""The pixel store: places for pixels, sums in fixed point, and sending them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cameras import bad_places
from support.cases import steady
from support.frames import make_frame
from support.space import UNEVEN_STEP, even_space, indices

from raygrid.node.geometry.lattice import make_cell
from raygrid.node.protocol import decoding, packets
from raygrid.node.protocol.counters import BORN, COUNTS
from raygrid.node.protocol.packets import MAX_PIXEL_SAMPLES, MAX_PIXEL_SUM, SIZE
from raygrid.node.tracing.framebuffer import MAX_INTENSITY, UNIT, Pixels, fixed_point, make_pixels, send_pixels, slot

WIDTH = 40


def store(spans: list[tuple[int, int]], first_row: int = 3) -> Pixels:
    """A store with these (first column, width) spans, one a row."""
    first, widths = (np.array(column, np.int64) for column in zip(*spans, strict=True))
    offsets = np.concatenate(([0], np.cumsum(widths))).astype(np.int64)
    total = int(offsets[-1])
    return Pixels(first_row, first, offsets, np.zeros((total, 3), np.int64), np.zeros(total, np.int64))


SPANS = [(4, 3), (0, 0), (38, 2), (0, 40), (7, 1), (9, 0)]


def test_slot_is_the_place_of_a_pixel_and_of_no_other():
    pixels = store(SPANS)
    expected = {}
    for row, (first, width) in enumerate(SPANS):
        for column in range(first, first + width):
            expected[column, 3 + row] = len(expected)
    for i in range(-2, WIDTH + 2):
        for j in range(12):
            assert slot(pixels, i, j) == expected.get((i, j), -1)


def test_slot_of_an_empty_store():
    empty = Pixels(0, np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros((0, 3), np.int64), np.zeros(0, np.int64))
    assert slot(empty, 0, 0) == -1


def test_fixed_point_rounds_to_nearest_and_has_a_top():
    assert fixed_point(np.float32(0.0)) == 0
    assert fixed_point(np.float32(1.0)) == 2**24
    assert fixed_point(np.float32(2.0**-25)) == 1
    assert fixed_point(np.float32(2.0**-25.01)) == 0
    assert fixed_point(np.float32(1.5 * 2.0**-24)) == 2
    assert fixed_point(np.float32(MAX_INTENSITY)) == fixed_point(np.float32(1e30)) == fixed_point(np.float32(np.inf))
    assert fixed_point(np.float32(MAX_INTENSITY)) * 2**22 < 2**63, "the stated number of packets cannot overflow a sum"


@steady(200)
@given(st.floats(0.0, MAX_INTENSITY, width=32))
def test_fixed_point_is_off_by_at_most_half_a_unit(value):
    assert abs(float(fixed_point(np.float32(value))) - value * UNIT) <= 0.5


# --- the spans of a home ----------------------------------------------------------------------------------


def test_stores_are_little_larger_than_the_picture():
    """Law 7: a home has room for its own part. The rims of the outlines are shared by neighbours."""
    size = (300, 200)
    for shape in ((1, 1, 1), (2, 2, 2), (4, 4, 4)):
        space = even_space(shape, UNEVEN_STEP)
        for name in ("in front", "far away", "askew and near", "parallel, straight", "parallel, askew"):
            frame = make_frame(bad_places(space, size)[name], size)
            places = sum(len(make_pixels(frame, space, make_cell(space, index)).samples) for index in indices(space))
            assert places < 1.3 * size[0] * size[1], f"{name} {shape}"


def test_homes_that_no_ray_enters_hold_nothing():
    size, space = (30, 20), even_space((3, 3, 3), UNEVEN_STEP)
    cameras = bad_places(space, size)
    inside = {"in front": (1, 1, 1), "behind": (0, 0, 2), "parallel, straight": (1, 1, 1), "inside": (0, 0, 0)}
    for name, index in inside.items():
        pixels = make_pixels(make_frame(cameras[name], size), space, make_cell(space, index))
        assert len(pixels.samples) == 0, name


def test_the_cell_of_an_eye_inside_holds_the_whole_picture():
    size, space = (30, 20), even_space((3, 3, 3), UNEVEN_STEP)
    pixels = make_pixels(make_frame(bad_places(space, size)["inside"], size), space, make_cell(space, (1, 1, 1)))
    assert len(pixels.samples) == 600


def test_a_store_takes_the_memory_of_one_before_if_it_fits():
    """It is empty whatever the one before still held."""
    size, space = (30, 20), even_space((2, 1, 1), UNEVEN_STEP)
    frame, cell = make_frame(bad_places(space, size)["in front"], size), make_cell(space, (0, 0, 0))
    new = make_pixels(frame, space, cell)
    before = make_pixels(frame, space, cell)
    before.sums[:], before.samples[:] = 7, 5
    again = make_pixels(frame, space, cell, before)
    assert again.sums is before.sums
    assert again.samples is before.samples
    for one, other in zip(again, new, strict=True):
        np.testing.assert_array_equal(one, other)
    other_size = make_pixels(make_frame(bad_places(space, (31, 20))["in front"], (31, 20)), space, cell, before)
    assert other_size.sums is not before.sums
    assert not other_size.sums.any()


# --- sending ----------------------------------------------------------------------------------------------


def sent(pixels: Pixels, rooms: list[int]) -> tuple[list[bytes], int]:
    """(the packets that come out of a store, how many were counted), with these rooms in turn, again and again."""
    cursor, counts, found, turn = np.int64(0), np.zeros(COUNTS, np.int64), [], 0
    while cursor >= 0:
        room = rooms[turn % len(rooms)]
        buffer = np.zeros((room + 2) * SIZE, np.uint8)
        made, cursor = send_pixels(pixels, WIDTH, cursor, buffer, SIZE, room, counts)
        assert made <= room
        assert cursor < 0 or made == room
        data = buffer.tobytes()
        assert data[:SIZE] == data[-SIZE:] == bytes(SIZE), "written beside its room"
        found += [data[(1 + k) * SIZE : (2 + k) * SIZE] for k in range(made)]
        turn += 1
    return found, int(counts[BORN + packets.PIXEL])


def gathered(found: list[bytes]) -> dict[int, list[int]]:
    """What the host adds up: red, green, blue and samples of each pixel."""
    picture: dict[int, list[int]] = {}
    for data in found:
        packet = decoding.decode(data)
        assert packet.kind == packets.PIXEL
        total = picture.setdefault(packet.number, [0, 0, 0, 0])
        for k, value in enumerate((*packet.values, packet.samples)):
            total[k] += value
    return picture


big = st.one_of(
    st.integers(0, 3),
    st.sampled_from([MAX_PIXEL_SUM - 1, MAX_PIXEL_SUM, MAX_PIXEL_SUM + 1, 3 * MAX_PIXEL_SUM + 2, 2**61]),
)
many = st.one_of(st.integers(0, 2), st.sampled_from([MAX_PIXEL_SAMPLES, MAX_PIXEL_SAMPLES + 1, 200_000]))


@steady(80)
@given(st.data(), st.lists(st.integers(1, 5), min_size=1, max_size=3))
def test_what_is_sent_is_what_was_held(data, rooms):
    """Whatever the room, all of a store is sent, in several packets where one cannot hold a pixel."""
    pixels = store(SPANS)
    expected = {}
    for number in data.draw(st.lists(st.integers(0, len(pixels.samples) - 1), max_size=12, unique=True)):
        sums = data.draw(st.tuples(big.filter(lambda value: value <= 100 * MAX_PIXEL_SUM), big, big))
        sums = tuple(min(value, 5 * MAX_PIXEL_SUM) for value in sums)
        pixels.sums[number], pixels.samples[number] = sums, data.draw(many)
        row = int(np.searchsorted(pixels.offsets, number, "right")) - 1
        column = int(pixels.first[row] + number - pixels.offsets[row])
        total = [*sums, int(pixels.samples[number])]
        if any(total):
            expected[(3 + row) * WIDTH + column] = total
    packets_needed = sum(
        max(math.ceil(max(t[:3]) / MAX_PIXEL_SUM), math.ceil(t[3] / MAX_PIXEL_SAMPLES)) for t in expected.values()
    )
    found, counted = sent(pixels, rooms)
    assert gathered(found) == expected
    assert len(found) == counted == packets_needed
    assert not pixels.sums.any()
    assert not pixels.samples.any()


def test_sending_again_sends_nothing():
    pixels = store(SPANS)
    pixels.samples[:] = 1
    found, _ = sent(pixels, [7])
    assert len(found) == len(pixels.samples)
    assert sent(pixels, [7]) == ([], 0)


def test_a_row_that_begins_where_a_call_ended():
    """The cursor stands at a row's end, at an empty row, and at the store's end."""
    for room in range(1, 50):
        pixels = store(SPANS)
        pixels.sums[:, 1] = np.arange(1, len(pixels.samples) + 1)
        found, _ = sent(pixels, [room])
        assert [decoding.decode(data).values[1] for data in found] == list(range(1, len(pixels.samples) + 1))


def test_an_empty_store_sends_nothing():
    empty = Pixels(0, np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros((0, 3), np.int64), np.zeros(0, np.int64))
    assert sent(empty, [3]) == ([], 0)


@pytest.mark.parametrize("value", [2.0**-24, 1.0, 3.75, 65535.5])
def test_a_pixel_comes_to_the_host_as_its_intensity(value):
    pixels = store([(5, 1)])
    for _ in range(1000):
        pixels.sums[0] += fixed_point(np.float32(value))
    pixels.samples[0] = 1000
    found, _ = sent(pixels, [1])
    (total,) = gathered(found).values()
    assert total[0] / UNIT / total[3] == value
