"""Rays from the eye that are worked out eight at once are those that are worked out one by one, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.packing import octahedral, pack_weight, put_ray
from reference.rays import entry, eye_ray, image_point, primary_origin, towards_start

from raygrid.emulator.processes.warm import tiny_frame as one_frame
from raygrid.node.geometry.grid_walk import NO_PORT
from raygrid.node.geometry.lattice import LATTICE, make_cell, make_space
from raygrid.node.protocol.packets import PRIMARY, SIZE
from raygrid.node.tracing.primary_rays import (
    EIGHT,
    PRIMARY_ROOM,
    entered_at,
    is_at_home,
    make_primary_batch,
    note_primary,
    note_return,
    noted_return,
    pixel_of,
    put_primary,
    work_out_primaries,
    work_out_returns,
)

STEPS = (2.0**-24, 1.5 * 2.0**-25, 2.0**-26)
SPACE = make_space(STEPS, [[0, LATTICE // 3, LATTICE], [0, 777, 5_000_000, LATTICE], [0, LATTICE]])
CELLS = [make_cell(SPACE, (x, y, 0)) for x in range(2) for y in range(3)]
WIDTH, HEIGHT = 37, 23

numbers = st.one_of(st.sampled_from([0.0, 0.25, -0.5, 1.0]), st.floats(-2.0, 2.0))
vectors = st.tuples(numbers, numbers, numbers)


@st.composite
def frames(draw):
    """A camera anywhere, inside the world box too, perspective or parallel, and 1 or 3 samples a pixel."""
    eye, along = draw(vectors), draw(vectors.filter(lambda v: max(map(abs, v)) > 0.1))
    parallel = draw(st.booleans())
    sides = [tuple(0.01 * x for x in draw(vectors)) for _ in range(2)]
    zero = (0.0, 0.0, 0.0)
    rows = [eye, *(sides if parallel else (zero, zero)), along, *((zero, zero) if parallel else sides)]
    return one_frame()._replace(
        camera=np.array(rows), width=WIDTH, height=HEIGHT, samples=draw(st.sampled_from([1, 3])), n_lights=0
    )


samples = st.lists(st.integers(0, WIDTH * HEIGHT - 1), min_size=1, max_size=20)


def _ray(frame, sample):
    """(enters, lattice point of entry, origin, direction), one by one."""
    origin, direction = eye_ray(frame.camera, *image_point(sample, frame.width, frame.samples))
    enters, point, near = entry(SPACE.step, origin, direction)
    return enters, point, primary_origin(SPACE.step, origin, direction, near) if enters else None, direction


@given(frames(), samples, st.sampled_from(CELLS))
@settings(deadline=None)
def test_primaries(frame, numbers, cell):
    """Those at home in this cell, and no others; their packets."""
    seen = make_primary_batch()
    for sample in numbers:
        note_primary(seen, *image_point(sample, frame.width, frame.samples), sample, 0)
    work_out_primaries(cell, SPACE, frame, seen)
    for k, sample in enumerate(numbers):
        enters, point, start, direction = _ray(frame, sample)
        assert is_at_home(seen, k) == (enters and towards_start(cell, point) == NO_PORT)
        if enters:
            row, expected = np.zeros(SIZE, np.uint8), np.zeros(SIZE, np.uint8)
            put_primary(seen, k, row, 0)
            put_ray(expected, 0, PRIMARY, 1, sample, start, octahedral(*direction), pack_weight(1.0, 1.0, 1.0))
            assert row.tobytes() == expected.tobytes()


@given(frames(), samples, st.tuples(*3 * [st.floats(0.0, width=32)]), st.integers(1, 31))
@settings(deadline=None)
def test_returns(frame, numbers, intensity, depth):
    """Where their samples' rays enter, and what was noted."""
    seen = make_primary_batch()
    for sample in numbers:
        note_return(seen, frame, sample, depth, tuple(map(np.float32, intensity)))
    work_out_returns(SPACE, frame, seen)
    for k, sample in enumerate(numbers):
        enters, point, _, _ = _ray(frame, sample)
        if enters:
            assert entered_at(seen, k) == point
        assert noted_return(seen, k) == (sample, depth, intensity)


def test_a_full_lot_says_so():
    """Where there is room for no more, and only there."""
    seen, frame = make_primary_batch(), one_frame()
    assert [note_return(seen, frame, 0, 1, (np.float32(1.0),) * 3) for _ in range(PRIMARY_ROOM)] == [False] * (
        PRIMARY_ROOM - 1
    ) + [True]
    assert PRIMARY_ROOM % EIGHT == 0


@given(
    st.integers(1, 1 << 16),
    st.sampled_from([1, 2, 3, 7, 1000]),
    st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=20),
)
@settings(deadline=None)
def test_points_of_returns_in_large_pictures(width, number, samples):
    """Every quotient is right up to the largest sample number."""
    frame = one_frame()._replace(width=width, height=1 << 16, samples=number)
    seen = make_primary_batch()
    for sample in samples:
        note_return(seen, frame, sample, 1, (np.float32(1.0),) * 3)
    work_out_returns(SPACE, frame, seen)
    for k, sample in enumerate(samples):
        pixel = sample // number
        assert pixel_of(seen, k) == (pixel % width, pixel // width)
        enters, point, _, _ = _ray(frame, sample)
        assert not enters or entered_at(seen, k) == point


@pytest.mark.parametrize("many", [1, EIGHT, PRIMARY_ROOM - 1, PRIMARY_ROOM])
def test_any_number_of_samples(many):
    """What is left in other columns does not matter."""
    camera = np.array([(0.0, 0.0, -1.0), *2 * [(0.0, 0.0, 0.0)], (-0.2, -0.2, 1.0), (0.01, 0.0, 0.0), (0.0, 0.01, 0.0)])
    frame = one_frame()._replace(camera=camera, width=WIDTH, height=HEIGHT, samples=1)
    seen = make_primary_batch()
    for sample in range(many):
        note_return(seen, frame, sample, 1, (np.float32(1.0),) * 3)
    work_out_returns(SPACE, frame, seen)
    assert [entered_at(seen, k) for k in range(many)] == [_ray(frame, k)[1] for k in range(many)]
