"""Defines the commands of waves: what the driver tells all nodes to do. Written by the driver, checked by every node.

A command travels as a map, of which `do` is its name. Tables travel as the bytes of little-endian float64.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NamedTuple, TypeGuard

import numpy as np

from raygrid.node.errors import ProtocolError, SceneError
from raygrid.node.geometry.lattice import Space, make_space
from raygrid.node.geometry.surfaces import F64
from raygrid.node.protocol.frame_tables import (
    LAYER_NONE,
    LAYER_SURFACE,
    LIGHT_COLUMNS,
    MATERIAL_COLUMNS,
    RULE_COLUMNS,
    Frame,
)
from raygrid.node.protocol.packets import MAX_DEPTH, MAX_LIGHTS, MAX_SAMPLES

MAX_SIDE = 65536  # pixels
MOST_HOLD = 60.0  # seconds
USUAL_FLUSH = 256  # packets for which an output is sent although there is work, unless the driver says otherwise

CommandMap = Mapping[str, object]  # a command as it came: nothing in it is trusted


class CommandName(StrEnum):
    """What a node does, and when it replies."""

    READY = "ready"  # nothing; when its links are up
    PROGRAM = "program"  # compile and try a program; when it is done
    USE = "use"  # let it take the place of the one before; at once
    SPACE = "space"  # new world box and planes, forget all surfaces; at once
    GROUPS = "groups"  # which surfaces move, and where they are; at once
    LOADED = "loaded"  # nothing; at once, and the sums tell whether descriptions are under way
    MOVE = "move"  # move what it holds, drop what has left; at once
    HAND = "hand"  # hand on what has reached other cells; at once, and what it will hand on is counted
    BUILD = "build"  # make the tables from what it retains; when it is done
    FRAME = "frame"  # begin a frame; at once
    TRACE = "trace"  # spawn so many more primaries; when it is idle, or after `hold` seconds
    COLLECT = "collect"  # send its pixels to the nearest corner; when it is idle, or after `hold` seconds
    REPORT = "report"  # nothing; at once, with a record of itself
    # drop all packets and surfaces, those too that still come, until the next space or frame; at once, and the sums
    # tell whether messages are under way
    HALT = "halt"
    END = "end"  # say BYE on every link; at once


class TraceCommand(NamedTuple):
    """Spawn primaries, and how eagerly to trace and send meanwhile.

    quota            primaries that a node may spawn before it hears from the driver again
    hold             seconds for which a busy node may hold its reply
    batch_threshold  packets that are worth a batch
    back_off         seconds for which a node waits for them
    flush            packets for which an output is sent
    """

    quota: int
    hold: float = 0.0
    batch_threshold: int = 0
    back_off: float = 0.0
    flush: int = USUAL_FLUSH

    def as_map(self) -> dict[str, Any]:
        """Give the map that travels where it cannot be a reduction (`node.runtime.reduction`)."""
        return {"do": str(CommandName.TRACE)} | self._asdict()


def read_trace(order: CommandMap) -> TraceCommand:
    """The command to trace of a map. Raises ProtocolError."""
    quota, threshold, back_off = order.get("quota"), order.get("batch_threshold", 0), order.get("back_off", 0.0)
    flush = order.get("flush", USUAL_FLUSH)
    if type(quota) is not int or not 0 <= quota < 2**32:
        raise ProtocolError(f"a quota came as {quota!r}, wanted a whole number")
    if (
        type(threshold) is not int
        or type(flush) is not int
        or not isinstance(back_off, float)
        or not 0.0 <= back_off <= 1.0
    ):
        raise ProtocolError(
            f"batch_threshold, back_off and flush came as {threshold!r}, {back_off!r}, {flush!r}, "
            "wanted packets, seconds, packets"
        )
    return TraceCommand(quota, read_hold(order), threshold, back_off, flush)


def read_hold(order: CommandMap) -> float:
    """Seconds for which a busy node may hold its reply to a command; 0: it replies at once."""
    hold = order.get("hold", 0.0)
    return hold if isinstance(hold, float) and 0.0 < hold <= MOST_HOLD else 0.0


def space_order(space: Space) -> dict[str, Any]:
    """The order that tells nodes the world box and the planes between cells."""
    planes = [space.planes[axis, : space.shape[axis] + 1].tolist() for axis in range(3)]
    return {"do": str(CommandName.SPACE), "step": list(space.step), "planes": planes}


def read_space(order: CommandMap, shape: tuple[int, int, int]) -> Space:
    """The space of an order, for an array of this shape. Raises ProtocolError."""
    step, planes = order.get("step"), order.get("planes")
    if not _numbers(step, 3) or not isinstance(planes, list) or len(planes) != 3:
        raise ProtocolError(f"a space came with step {step!r}, wanted three numbers and three lists of planes")
    for axis in range(3):
        line = planes[axis]
        if not isinstance(line, list) or len(line) != shape[axis] + 1 or not all(type(k) is int for k in line):
            raise ProtocolError(f"a space came with {line!r} for axis {axis}, wanted {shape[axis] + 1} planes")
    if not all(0.0 < s <= 2.0**-22 for s in step):
        raise ProtocolError(f"a space came with step {step!r}, wanted steps above 0")
    try:
        return make_space((float(step[0]), float(step[1]), float(step[2])), planes)
    except SceneError as error:
        raise ProtocolError(str(error)) from None


def frame_order(frame: Frame) -> dict[str, Any]:
    """The order that tells nodes the facts of a frame; its materials' rules of a program, if they have any."""
    wide = frame.materials.shape[1] > MATERIAL_COLUMNS
    rules = {"rules": frame.materials[:, MATERIAL_COLUMNS:].astype("<f8").tobytes()} if wide else {}
    return {
        "do": str(CommandName.FRAME),
        "camera": frame.camera.astype("<f8").tobytes(),
        "materials": frame.materials[:, :MATERIAL_COLUMNS].astype("<f8").tobytes(),
        "lights": frame.lights.astype("<f8").tobytes(),
        "n_lights": frame.n_lights,
        "background": list(frame.background),
        "width": frame.width,
        "height": frame.height,
        "samples": frame.samples,
        "depth": frame.depth,
        "min_weight": frame.min_weight,
        "discs": frame.discs,
        "layer": frame.layer,
    } | rules


def read_frame(order: CommandMap) -> Frame:
    """The frame of an order. Raises ProtocolError for anything that a kernel must not see."""
    camera = _table(order, "camera", 3, exactly=6)
    materials = _table(order, "materials", MATERIAL_COLUMNS)
    if "rules" in order:
        rules = _table(order, "rules", RULE_COLUMNS, exactly=len(materials))
        materials = np.ascontiguousarray(np.concatenate((materials, rules), axis=1))
    lights = _table(order, "lights", LIGHT_COLUMNS)
    n_lights = _whole(order, "n_lights", 0, min(len(lights), MAX_LIGHTS))
    width, height = _whole(order, "width", 1, MAX_SIDE), _whole(order, "height", 1, MAX_SIDE)
    samples = _whole(order, "samples", 1, MAX_SAMPLES - 1)
    if width * height * samples > MAX_SAMPLES:
        raise ProtocolError(f"a frame came with {width} x {height} x {samples} samples, wanted {MAX_SAMPLES} or fewer")
    layer = _whole(order, "layer", LAYER_NONE, LAYER_SURFACE)
    if layer != LAYER_NONE and samples != 1:
        raise ProtocolError(f"a layer came with {samples} samples a pixel, wanted 1")
    background, min_weight, discs = order.get("background"), order.get("min_weight"), order.get("discs")
    least = [min_weight]
    if not _numbers(background, 3) or not _numbers(least, 1) or not isinstance(discs, bool):
        raise ProtocolError(f"a frame came with background {background!r}, min_weight {min_weight!r}, discs {discs!r}")
    return Frame(
        camera,
        materials,
        lights,
        n_lights,
        (float(background[0]), float(background[1]), float(background[2])),
        width,
        height,
        samples,
        _whole(order, "depth", 1, MAX_DEPTH),
        float(least[0]),
        discs,
        layer,
    )


def _numbers(value: object, count: int) -> TypeGuard[list[float]]:
    return (
        isinstance(value, list)
        and len(value) == count
        and all(isinstance(x, int | float) and not isinstance(x, bool) and np.isfinite(x) for x in value)
    )


def _whole(order: CommandMap, name: str, least: int, most: int) -> int:
    value = order.get(name)
    if type(value) is not int or not least <= value <= most:
        raise ProtocolError(f"a frame came with {name} {value!r}, wanted {least} to {most}")
    return value


def _table(order: CommandMap, name: str, columns: int, exactly: int | None = None) -> F64:
    data = order.get(name)
    if not isinstance(data, bytes) or len(data) == 0 or len(data) % (8 * columns):
        raise ProtocolError(f"a frame came with a table of {name} that is not rows of {columns} numbers")
    table = np.frombuffer(data, "<f8").reshape(-1, columns).astype(np.float64)
    if (exactly is not None and len(table) != exactly) or not np.isfinite(table).all():
        raise ProtocolError(f"a frame came with {len(table)} rows of {name} or numbers that are not finite")
    return table
