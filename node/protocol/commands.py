"""The orders of a wave that carry facts: the space and the frame. Written by the driver, checked by every node.

An order is a map; `do` names it (see `node.runtime.processor`). Tables travel as the bytes of little-endian float64.
"""

from __future__ import annotations

from typing import Any, TypeGuard

import numpy as np

from raygrid.node.errors import ProtocolError, SceneError
from raygrid.node.geometry.lattice import Space, make_space
from raygrid.node.protocol.frame_tables import LIGHT_COLUMNS, MATERIAL_COLUMNS, RULE_COLUMNS, Frame
from raygrid.node.protocol.packets import MAX_DEPTH, MAX_LIGHTS, MAX_SAMPLES

MAX_SIDE = 65536  # pixels


def space_order(space: Space) -> dict[str, Any]:
    """The order that tells nodes the world box and the planes between cells."""
    planes = [space.planes[axis, : space.shape[axis] + 1].tolist() for axis in range(3)]
    return {"do": "space", "step": list(space.step), "planes": planes}


def read_space(order: dict[str, Any], shape: tuple[int, int, int]) -> Space:
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
        "do": "frame",
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
    } | rules


def read_frame(order: dict[str, Any]) -> Frame:
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
    background, min_weight, discs = order.get("background"), order.get("min_weight"), order.get("discs")
    if (
        not _numbers(background, 3)
        or not _numbers([min_weight], 1)
        or not isinstance(discs, bool)
        or min_weight is None
    ):
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
        float(min_weight),
        discs,
    )


def _numbers(value: Any, count: int) -> TypeGuard[list[float]]:
    return (
        isinstance(value, list)
        and len(value) == count
        and all(isinstance(x, int | float) and not isinstance(x, bool) and np.isfinite(x) for x in value)
    )


def _whole(order: dict[str, Any], name: str, least: int, most: int) -> int:
    value = order.get(name)
    if type(value) is not int or not least <= value <= most:
        raise ProtocolError(f"a frame came with {name} {value!r}, wanted {least} to {most}")
    return value


def _table(order: dict[str, Any], name: str, columns: int, exactly: int | None = None) -> np.ndarray:
    data = order.get(name)
    if not isinstance(data, bytes) or len(data) == 0 or len(data) % (8 * columns):
        raise ProtocolError(f"a frame came with a table of {name} that is not rows of {columns} numbers")
    table = np.frombuffer(data, "<f8").reshape(-1, columns).astype(np.float64)
    if (exactly is not None and len(table) != exactly) or not np.isfinite(table).all():
        raise ProtocolError(f"a frame came with {len(table)} rows of {name} or numbers that are not finite")
    return table
