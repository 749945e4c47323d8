"""The orders of space and frame: they come out as they went in; all else is refused with a ProtocolError."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.messages import message, values
from support.space import spaces, uneven_space

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.lattice import LATTICE
from raygrid.node.geometry.surfaces import MAX_MATERIALS
from raygrid.node.protocol.codec import pack_map, read_map
from raygrid.node.protocol.commands import (
    TraceCommand,
    frame_order,
    read_frame,
    read_hold,
    read_space,
    read_trace,
    space_order,
)
from raygrid.node.protocol.frame_tables import LAYER_NONE, LAYER_SURFACE, LIGHT_COLUMNS, MATERIAL_COLUMNS, Frame
from raygrid.node.protocol.messages import MAX_MESSAGE, MessageKind, pack_order, read_order
from raygrid.node.protocol.packets import MAX_LIGHTS

SPACE = space_order(uneven_space())


def small_frame(**changes: Any) -> Frame:
    """A frame of 8 by 6 pixels with one material and two lights."""
    camera = np.array([[0.0, 0, 2], [0, 0, 0], [0, 0, 0], [-0.2, 0.2, -1], [0.05, 0, 0], [0, -0.05, 0]])
    made = Frame(
        camera,
        np.full((1, MATERIAL_COLUMNS), 0.5),
        np.zeros((2, LIGHT_COLUMNS)),
        2,
        (0.1, 0.2, 0.3),
        8,
        6,
        4,
        5,
        0.01,
        False,
    )
    return made._replace(**changes)


FRAME = frame_order(small_frame())


def sent(order: dict[str, Any]) -> dict[str, Any]:
    """An order as the other side reads it."""
    return read_order(message(MessageKind.DOWN, pack_order(order)))


def same_frame(one: Frame, other: Frame) -> bool:
    """Whether all fields hold the same bits."""
    return all(np.array_equal(a, b) and type(a) is type(b) for a, b in zip(one, other, strict=True))


@given(spaces())
def test_a_space_comes_out_as_it_went_in(space):
    read = read_space(sent(space_order(space)), space.shape)
    assert (read.step, read.shape) == (space.step, space.shape)
    assert np.array_equal(read.planes, space.planes)
    assert read.planes.dtype == space.planes.dtype


@given(st.integers(1, 60), st.integers(1, 40), st.integers(1, 9), st.integers(1, 31), st.booleans())
def test_a_frame_comes_out_as_it_went_in(width, height, samples, depth, discs):
    frame = small_frame(width=width, height=height, samples=samples, depth=depth, discs=discs)
    assert same_frame(read_frame(sent(frame_order(frame))), frame)


def test_the_largest_frame_fits_in_a_message():
    materials = np.ones((MAX_MATERIALS, MATERIAL_COLUMNS))
    lights = np.ones((MAX_LIGHTS, LIGHT_COLUMNS))
    frame = small_frame(materials=materials, lights=lights, n_lights=MAX_LIGHTS)
    raw = pack_order(frame_order(frame))
    assert len(raw) < MAX_MESSAGE // 2 + 2**20
    assert same_frame(read_frame(sent(frame_order(frame))), frame)


NOT_NUMBERS: list[object] = [None, "x", b"x", [], {}, True, [1.0, 2.0], [1.0, 2.0, "x"]]
NOT_NUMBERS += [[1.0, 2.0, float("nan")], [True, 1.0, 1.0]]
WRONG_STEPS = [0.0, -1e-8, 1.0, 2**64 - 1]


@pytest.mark.parametrize("step", [*NOT_NUMBERS, *([1e-8, step, 1e-8] for step in WRONG_STEPS)])
def test_a_wrong_step_is_refused(step):
    with pytest.raises(ProtocolError, match="a space came with step"):
        read_space(SPACE | {"step": step}, (4, 4, 4))


@pytest.mark.parametrize(
    "line",
    [
        None,
        7,
        [],
        [0, LATTICE],
        [0, 1000, 2000, 3000, LATTICE + 1],
        [1, 1000, 2000, 3000, LATTICE],
        [0, 1000, 1000, 3000, LATTICE],
        [0, 1000, 1063, 3000, LATTICE],
        [0, 3000, 2000, 1000, LATTICE],
        [0, 1000.0, 2000, 3000, LATTICE],
        [0, True, 2000, 3000, LATTICE],
        [0, 2**63, 2**64 - 1, 3000, LATTICE],
        [0, 2**64 - 1, 2000, 3000, LATTICE],
        [0, -1, 2000, 3000, LATTICE],
        [0, -(2**63), 2**63 - 1, 3000, LATTICE],
    ],
)
@pytest.mark.parametrize("axis", range(3))
def test_wrong_planes_are_refused(line, axis):
    planes = [list(line) for line in SPACE["planes"]]
    planes[axis] = line
    with pytest.raises(ProtocolError, match=r"axis \w|planes"):
        read_space(SPACE | {"planes": planes}, (4, 4, 4))


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *[
            (name, value)
            for name in ("width", "height", "depth", "samples")
            for value in (0, -1, 2**40, 1.0, True, None)
        ],
        ("depth", 32),
        ("width", 65537),
        ("samples", 2**32),
        ("n_lights", 3),
        ("n_lights", -1),
        *[("background", value) for value in NOT_NUMBERS],
        ("min_weight", float("inf")),
        ("min_weight", None),
        ("discs", 1),
        ("discs", None),
        *[
            (table, value)
            for table in ("camera", "materials", "lights")
            for value in (None, "x", 7, b"", b"x", bytes(8), np.full(126, np.nan).tobytes())
        ],
        ("camera", bytes(8 * 15)),
        ("camera", bytes(8 * 21)),
        ("lights", bytes(8 * LIGHT_COLUMNS)),  # fewer than n_lights
    ],
)
def test_a_wrong_frame_is_refused(name, wrong):
    with pytest.raises(ProtocolError, match="a frame came with"):
        read_frame(FRAME | {name: wrong})


def test_more_samples_than_can_be_numbered_are_refused():
    with pytest.raises(ProtocolError, match="65536 x 65536 x 2 samples"):
        read_frame(FRAME | {"width": 65536, "height": 65536, "samples": 2})


@steady(500)
@given(st.dictionaries(st.sampled_from(sorted(SPACE)), values, min_size=1), st.booleans())
def test_any_other_space_is_read_or_refused(changes, cut):
    order = {} if cut else dict(SPACE)
    try:
        space = read_space(sent(order | changes), (4, 4, 4))
    except ProtocolError:
        return
    assert space.shape == (4, 4, 4)


@steady(500)
@given(st.lists(st.one_of(st.integers(-(2**63), 2**64 - 1), st.sampled_from([0, 64, LATTICE])), min_size=5, max_size=5))
def test_any_other_planes_are_read_or_refused(line):
    planes = [line, *SPACE["planes"][1:]]
    try:
        space = read_space(sent(SPACE | {"planes": planes}), (4, 4, 4))
    except ProtocolError:
        return
    assert space.planes[0].tolist() == line
    assert line == sorted(line)


@steady(500)
@given(st.dictionaries(st.sampled_from(sorted(FRAME)), values, min_size=1))
def test_any_other_frame_is_read_or_refused(changes):
    try:
        frame = read_frame(sent(FRAME | changes))
    except ProtocolError:
        return
    assert len(frame.camera) == 6
    assert frame.n_lights <= len(frame.lights)


def test_a_command_to_trace_is_read_as_it_was_written():
    command = TraceCommand(2**32 - 1, hold=0.25, batch_threshold=300, back_off=0.016, flush=4096)
    assert read_trace(read_map(pack_map(command.as_map()), "a command")) == command
    assert read_trace({"do": "trace", "quota": 5}) == TraceCommand(5)


@pytest.mark.parametrize(
    ("hold", "seconds"), [(0.5, 0.5), (60.0, 60.0), (60.5, 0.0), (-1.0, 0.0), (1, 0.0), ("x", 0.0)]
)
def test_a_hold_that_is_none_is_no_hold(hold, seconds):
    assert read_hold({"hold": hold}) == seconds


def test_a_layer_is_one_of_those_there_are_and_has_one_sample_a_pixel():
    layer = frame_order(small_frame(samples=1, layer=LAYER_SURFACE))
    assert read_frame(sent(layer)).layer == LAYER_SURFACE
    assert read_frame(sent(FRAME)).layer == LAYER_NONE
    for wrong in (-1, LAYER_SURFACE + 1, 1.0, True, None):
        with pytest.raises(ProtocolError, match=f"^a frame came with layer {wrong!r}, wanted 0 to 3$"):
            read_frame(sent({**layer, "layer": wrong}))
    with pytest.raises(ProtocolError, match=r"^a layer came with 4 samples a pixel, wanted 1$"):
        read_frame(sent({**layer, "samples": 4}))
