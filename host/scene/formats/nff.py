"""Reads NFF, the Neutral File Format of the Standard Procedural Databases: the whole of it.

=========================================  ==================================================================
v from at up angle hither resolution       the camera, once; its six parts in any order; hither is not used
b r g b                                    background, at most once; black if absent
l x y z [r g b]                            point light, 1 / sqrt(number of lights) bright, without falloff
f r g b Kd Ks Shine T ior                  the material of what follows; white matte before the first
s x y z r                                  SPHERE; negative radius: only the inside shows
c x y z r x y z r                          CYLINDER if the radii are equal, else CONE, the wider end first
p n, n points                              TRIANGLE, or POLYGON, which may be concave
pp n, n points with normals                SMOOTH; with more than three vertices, cut into triangles
=========================================  ==================================================================

A polygon that is not planar is cut into triangles along its own vertices, with a remark. What has no area is dropped
with a remark; a sphere or cone without size is an error, since no program writes one on purpose.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import IORS, LEAST_IOR, MOST_IOR, SceneBuilder, colour, material, plural
from raygrid.host.scene.cameras import Camera, nff_camera
from raygrid.host.scene.file_access import read_bytes
from raygrid.host.scene.finish import UNLIT
from raygrid.host.scene.formats.nff_words import GRAMMAR, NAMES, Words
from raygrid.host.scene.lights import Table, light_table, point_light
from raygrid.host.scene.polygons import Ints
from raygrid.host.scene.scene import Scene
from raygrid.host.text.standard_streams import shown_name
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64, Kind
from raygrid.node.protocol import MATERIAL_RECORD

Mask = NDArray[np.bool_]

VIEW = ("from", "at", "up", "angle", "hither", "resolution")
SURFACES = ("s", "c", "p", "pp")
MAX_SIDE = 65_535  # pixels; a larger picture is a misread file
MAX_VALUE = 1e30  # see builder.MAX_COORDINATE


def load_nff(path: Path) -> Scene:
    """Read a file. Raises SceneError with file, line, what came and what was wanted."""
    return parse_nff(path, read_bytes(path))


def parse_nff(path: Path, text: bytes) -> Scene:
    """The scene that a text describes; `path` is for messages and the scene's name. Raises SceneError as load_nff."""
    words = Words(path, text)
    _check(words)
    builder = SceneBuilder(str(path))
    _add_surfaces(words, builder)
    camera, size = _view(words)
    background = words.columns(words.of("b"), 3)
    lights = _lights(words, builder)
    surfaces, materials, remarks = builder.finish()
    return Scene(
        name=shown_name(path.name),
        surfaces=surfaces,
        materials=materials,
        lights=lights,
        camera=camera,
        background=colour(background[0]) if len(background) else (0.0, 0.0, 0.0),
        size=size,
        remarks=remarks,
        up=colour(words.columns(words.of("up"), 3)[0]),
    )


def _check(words: Words) -> None:
    """Raise the error of the first entity in the file that has one."""
    complaints: list[tuple[int, str]] = []

    def refuse(entities: Ints, bad: Mask, message: str) -> None:
        if bad.any():
            k = int(entities[np.argmax(bad)])
            complaints.append((k, f"{message}, came: {_came(words, k)}"))

    if np.abs(words.numbers).max() > MAX_VALUE:
        k = int(np.argmax(np.abs(words.numbers) > MAX_VALUE))
        raise words.error_at(k, f"came {words.numbers[k]:g}, wanted at most 1e30")
    wanted = _wanted_counts(words)
    short = words.counts != wanted
    if short.any():
        k = int(np.argmax(short))
        complaints.append((k, _count_message(words, k, int(wanted[k]))))
    whole = ~short
    for keyword, check in _VALUES.items():
        entities = words.of(keyword)
        entities = entities[whole[entities]]
        for bad, message in check(words, entities):
            refuse(entities, bad, message)
    for entity, message in _misplaced(words):
        complaints.append((entity, message))
    if complaints:
        raise words.error(*min(complaints))
    if not len(words.of("v")):
        raise SceneError(f"{words.path}: the file has no viewpoint, wanted one (v from at up angle hither resolution)")
    if not np.isin(words.codes, [NAMES.index(name) for name in SURFACES]).any():
        raise SceneError(f"{words.path}: the file has no surfaces, wanted at least one of s c p pp")


def _wanted_counts(words: Words) -> Ints:
    """How many numbers each entity ought to have. What a polygon says of itself is believed only if it can be true."""
    table = np.array([-1 if count is None else count for _, count in GRAMMAR.values()], np.int64)
    wanted = table[words.codes]
    lights = words.of("l")
    wanted[lights] = np.where(words.counts[lights] > 3, 6, 3)
    for keyword, width in (("p", 3), ("pp", 6)):
        entities = words.of(keyword)
        first = np.minimum(words.begins[entities], len(words.numbers) - 1)
        said = np.where(words.counts[entities] > 0, words.numbers[first], 3.0)
        honest = (said >= 3.0) & (said == np.floor(said)) & (said < 2**31)
        # A dishonest count is _polygon_values' to report; here it asks for just what came.
        wanted[entities] = np.where(honest, 1 + width * np.where(honest, said, 3.0), words.counts[entities])
    return wanted


def _count_message(words: Words, k: int, wanted: int) -> str:
    name, count = GRAMMAR[NAMES[words.codes[k]]][0], int(words.counts[k])
    if count < wanted and k == len(words.codes) - 1:
        return f"the file ends inside the {name} that begins here, after {plural(count, 'number')} of {wanted}"
    either = "3 or 6" if name == "light" else str(wanted)
    return f"the {name} has {plural(count, 'number')}, wanted {either}"


def _came(words: Words, k: int) -> str:
    """The numbers of an entity as they are in the file, cut short after the eighth."""
    numbers = words.numbers[words.begins[k] : words.begins[k] + words.counts[k]]
    return " ".join(f"{number:g}" for number in numbers[:8]) + (" ..." if len(numbers) > 8 else "")


def _sphere_values(words: Words, entities: Ints) -> list[tuple[Mask, str]]:
    radius = words.columns(entities, 1, 3)[:, 0]
    return [(radius == 0.0, "a sphere's radius must not be 0")]


def _cone_values(words: Words, entities: Ints) -> list[tuple[Mask, str]]:
    data = words.columns(entities, 8)
    radii = data[:, (3, 7)]
    return [
        ((data[:, 0:3] == data[:, 4:7]).all(1), "a cone's base and apex must be two points"),
        ((radii == 0.0).all(1), "a cone's radii must not both be 0"),
        ((radii.min(1) < 0.0) & (radii.max(1) > 0.0), "a cone's radii must have one sign"),
    ]


def _polygon_values(words: Words, entities: Ints) -> list[tuple[Mask, str]]:
    said = words.columns(entities, 1)[:, 0]
    return [
        (said != np.floor(said), "a polygon's number of vertices must be whole"),
        (said >= 2**31, "a polygon's number of vertices must be below 2^31"),
        (said < 3.0, "a polygon must have at least 3 vertices"),
    ]


def _fill_values(words: Words, entities: Ints) -> list[tuple[Mask, str]]:
    data = words.columns(entities, 8)
    return [
        (
            np.asarray(data[:, :7].min(axis=1, initial=0.0) < 0.0),
            "a fill's colours, weights and shine must not be below 0",
        ),
        (
            (data[:, 6] > 0.0) & ((data[:, 7] < LEAST_IOR) | (data[:, 7] > MOST_IOR)),
            f"a transparent fill's index of refraction must be {IORS}",
        ),
    ]


def _colour_values(words: Words, entities: Ints) -> list[tuple[Mask, str]]:
    below = words.columns(entities, 3).min(axis=1, initial=0.0) < 0.0
    return [(np.asarray(below), "the background's colour must not be below 0")]


def _light_values(words: Words, entities: Ints) -> list[tuple[Mask, str]]:
    coloured = words.counts[entities] == 6
    bad = np.zeros(len(entities), np.bool_)
    bad[coloured] = (words.columns(entities[coloured], 3, 3) < 0.0).any(1)
    return [(bad, "a light's colour must not be below 0")]


def _size_values(words: Words, entities: Ints) -> list[tuple[Mask, str]]:
    size = words.columns(entities, 2)
    bad = np.asarray(((size < 1.0) | (size > MAX_SIDE) | (size != np.floor(size))).any(1))
    return [(bad, f"the resolution must be two whole numbers from 1 to {MAX_SIDE}")]


_VALUES = {
    "s": _sphere_values,
    "c": _cone_values,
    "p": _polygon_values,
    "pp": _polygon_values,
    "f": _fill_values,
    "b": _colour_values,
    "l": _light_values,
    "resolution": _size_values,
}


def _misplaced(words: Words) -> list[tuple[int, str]]:
    """Complaints about the viewpoint's parts, and about what came twice."""
    complaints = [
        (int(entities[1]), f"came a second {GRAMMAR[keyword][0]}, wanted one")
        for keyword in ("v", "b")
        if len(entities := words.of(keyword)) > 1
    ]
    views = words.of("v")
    inside = range(views[0] + 1, views[0] + 1 + len(VIEW)) if len(views) else range(0)
    for keyword in VIEW:
        complaints += [
            (int(k), f"came '{keyword}' outside a viewpoint, wanted it among the six parts after v")
            for k in words.of(keyword)[: 1 if not len(views) else None]
            if k not in inside
        ][:1]
    if len(views):
        missing = [keyword for keyword in VIEW if not np.isin(words.of(keyword), inside).any()]
        if missing:
            complaints.append((int(views[0]), f"the viewpoint has no '{missing[0]}', wanted all of {' '.join(VIEW)}"))
    return complaints


def _view(words: Words) -> tuple[Camera, tuple[int, int]]:
    part = {keyword: words.columns(words.of(keyword), GRAMMAR[keyword][1] or 0)[0] for keyword in VIEW}
    try:
        camera = nff_camera(part["from"], part["at"], part["up"], float(part["angle"][0]))
    except SceneError as error:
        raise words.error(int(words.of("v")[0]), str(error)) from None
    return camera, (int(part["resolution"][0]), int(part["resolution"][1]))


def _lights(words: Words, builder: SceneBuilder) -> Table:
    lights = words.of("l")
    if not len(lights):
        builder.remarks.append(UNLIT)
    strength = 1.0 / np.sqrt(max(len(lights), 1))
    return light_table(
        [
            point_light(row[:3], strength * (row[3:] if len(row) == 6 else np.ones(3)))
            for row in (
                words.numbers[b : b + n] for b, n in zip(words.begins[lights], words.counts[lights], strict=True)
            )
        ]
    )


def _add_surfaces(words: Words, builder: SceneBuilder) -> None:
    fills = words.of("f")
    builder.add_materials(material(diffuse=1.0))
    builder.add_materials(_fills(words.columns(fills, 8)))
    # The number of fills before an entity is the number of its material, the white one being number 0.
    materials = np.cumsum(words.codes == NAMES.index("f"))
    surfaces = np.concatenate([words.of(keyword) for keyword in SURFACES])
    if (materials[surfaces] == 0).any():
        builder.remarks.append("no fill before the first surface: white matte used")
    spheres, cones = words.of("s"), words.of("c")
    builder.add(Kind.SPHERE, words.columns(spheres, 4), materials[spheres], spheres)
    data = words.columns(cones, 8)
    wide_last = np.abs(data[:, 7]) > np.abs(data[:, 3])
    data[wide_last] = data[wide_last][:, (4, 5, 6, 7, 0, 1, 2, 3)]
    equal = data[:, 3] == data[:, 7]
    builder.add(Kind.CYLINDER, data[equal], materials[cones[equal]], cones[equal])
    builder.add(Kind.CONE, data[~equal], materials[cones[~equal]], cones[~equal])
    _add_polygons(words, builder, materials)
    _add_smooth_polygons(words, builder, materials)


def _fills(data: F64) -> Table:
    rows = np.zeros(len(data), MATERIAL_RECORD)
    rows["diffuse"] = data[:, 0:3] * data[:, 3:4]
    rows["specular"] = rows["highlight"] = data[:, 4:5]
    rows["shine"], rows["transmission"] = data[:, 5], data[:, 6:7]
    # An index that is never used (it is 0 in many files) would only keep equal materials apart.
    rows["ior"] = np.where(data[:, 6] > 0.0, data[:, 7], 1.0)
    return rows


def _add_polygons(words: Words, builder: SceneBuilder, materials: Ints) -> None:
    entities = words.of("p")
    points, starts = words.rows(entities, words.columns(entities, 1)[:, 0].astype(np.int64), 3)
    builder.add_polygons(points, starts, materials[entities], entities)


def _add_smooth_polygons(words: Words, builder: SceneBuilder, materials: Ints) -> None:
    entities = words.of("pp")
    if not len(entities):
        return
    rows, starts = words.rows(entities, words.columns(entities, 1)[:, 0].astype(np.int64), 6)
    corners, owner = builder.triangulate(rows[:, :3], starts)
    owner = entities[owner]
    data = np.concatenate((rows[corners, :3].reshape(-1, 9), rows[corners, 3:].reshape(-1, 9)), axis=1)
    builder.add(Kind.SMOOTH, data, materials[owner], owner)
