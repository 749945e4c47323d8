"""Exports a scene as a file for POV-Ray 3.7 that renders the same picture by the same rules: `raygrid export`.

What is the same: camera and pixel middles, lights, shadows of everything (transparent surfaces too), Whitted's shading
without ambient light, the greatest depth of the ray tree, linear light. What POV-Ray cannot do, or does in another
way, is said in the comment at the head of the file. Surfaces and materials are written by `povray_surfaces`.

POV-Ray keeps secondary rays off their surfaces by fixed lengths of about 1/1000, so the numbers are multiplied by a
power of ten that makes scenes of any size large against that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from raygrid.host.export.povray_surfaces import MaterialWriter, surface_lines, vector
from raygrid.host.image.outputs import write_whole
from raygrid.host.render.machine_job import DEFAULT_DEPTH, DEFAULT_SIZE
from raygrid.host.scene.animation.scene_frames import still
from raygrid.host.scene.cameras import Camera, Span
from raygrid.host.scene.scene import Scene
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64
from raygrid.node.protocol import DIRECTIONAL

REACH = 1e3  # the scene's box and the eye measure this to ten times this in POV-Ray's units
NEAR = 1e-5  # an inverse square is POV-Ray's 2 / (1 + (r / d)^2) with d this part of REACH
FAR = 1e3  # a directional light stands this many times the scene's measure away
SHADE = 0.002  # radius of the shade of a spot light in POV-Ray's units, of which it overlooks 0.001


def export_pov(scene: Scene, path: str | Path, depth: int | None = None, frame: int | None = None) -> None:
    """Write a scene as a POV-Ray 3.7 file; it appears whole or not at all.

    depth  greatest depth of the ray tree; None: what the scene's file asks for, else 5
    frame  of an animation, None for its first
    Raises SceneError for a scene without surfaces, OutputError if the file cannot be written.
    """
    if len(scene.surfaces) == 0:
        raise SceneError(f"{scene.name}: the scene has no surfaces")
    lines = pov_lines(scene, depth, frame)
    write_whole(path, lambda file: file.writelines(line.encode() + b"\n" for line in lines))


def pov_lines(scene: Scene, depth: int | None = None, frame: int | None = None) -> Iterator[str]:
    """The lines of the file, as `export_pov` writes them."""
    taken = "" if scene.shot is None else f", frame {frame or 1} of {scene.shot.frames}"
    scene = still(scene, frame or 1)
    scale = _scale(scene)
    materials = MaterialWriter(scene.materials, scene.highlights)
    width, height = scene.size or DEFAULT_SIZE
    yield f"// {Path(scene.name).name}{taken}, exported by raygrid for POV-Ray 3.7. To get raygrid's linear picture:"
    yield f"//   povray +I<this file> +W{width} +H{height} -A +FN16 File_Gamma=1.0"
    yield f"// One unit of the scene is {scale:g} units here. The camera is right for any +W and +H."
    for difference in _differences(scene, materials):
        yield f"// Differs: {difference}"
    yield "#version 3.7;"
    yield (
        "global_settings { assumed_gamma 1.0"
        f" max_trace_level {depth or scene.depth or DEFAULT_DEPTH} adc_bailout {scene.min_weight or 0.0:g} }}"
    )
    yield "#default { finish { ambient 0 diffuse 1 } }"
    yield from _background(scene)
    yield from _camera(scene.camera, scale)
    yield from _lights(scene, scale)
    yield from materials.lines(scene.surfaces)
    yield from surface_lines(scene.surfaces, materials, scale)


def _measure(scene: Scene) -> float:
    """The diagonal of the box of all surfaces and the eye."""
    points = np.vstack((scene.surfaces.bounds(), np.array(scene.camera.eye)))
    return float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0


def _scale(scene: Scene) -> float:
    """The power of ten that brings the scene's measure to between REACH and ten times that."""
    return float(10.0 ** math.ceil(math.log10(REACH / _measure(scene))))


def _differences(scene: Scene, materials: MaterialWriter) -> Iterator[str]:
    """One line each on what POV-Ray does in another way for this scene."""
    if (scene.samples or 1) > 1:
        yield f"raygrid takes {scene.samples} samples a pixel, POV-Ray one unless told otherwise (+A)."
    if scene.min_weight:
        yield "POV-Ray weighs faint rays in its own way before it drops them (adc_bailout)."
    if scene.rules is not None:
        yield "rules of a program are left out: materials are as they are without one."
    yield from materials.differences(scene.surfaces)


def _background(scene: Scene) -> Iterator[str]:
    """The background, and the discs of lights that rays see in it."""
    yield f"background {{ rgb {vector(scene.background)} }}"
    discs = [light for light in scene.lights if light["kind"] == DIRECTIONAL and light["cos_disc"] <= 1.0]
    if not discs:
        return
    yield f"sky_sphere {{ pigment {{ rgb {vector(scene.background)} }}"
    for light in discs:
        x, y, z = (f"({value:.12g})" for value in light["place"])
        yield f"  pigment {{ function {{ select(x*{x} + y*{y} + z*{z} - ({light['cos_disc']:.12g}), 0, 0.5, 0.5) }}"
        yield f"    color_map {{ [0.25 rgbt <0,0,0,1>] [0.25 rgb {vector(light['disc'])}] }} }}"
    yield "}"


def _camera(camera: Camera, scale: float) -> Iterator[str]:
    """Pixel (i, j) looks along forward + pitch (i - (w - 1) / 2) right + pitch ((h - 1) / 2 - j) up, as in raygrid."""
    spans = {
        # One row has no first and last: the span is then measured along the row.
        Span.MIDDLES: "max((image_height > 1 ? image_height : image_width) - 1, 1)",
        Span.EDGES: "image_height",
        Span.NARROW: "min(image_width, image_height)",
    }
    size = scale if camera.orthographic else 1.0
    # All digits, or POV-Ray finds that they are not perpendicular.
    forward, right, up = (vector(axis, digits=17) for axis in (camera.forward, camera.right, camera.up))
    yield f"#declare Pitch = {2.0 * camera.half * size:.12g} / {spans[camera.span]};"
    yield f"camera {{ {'orthographic' if camera.orthographic else 'perspective'}"
    yield f"  location {vector(camera.eye, scale)} direction {forward}"
    yield f"  right Pitch * image_width * {right} up Pitch * image_height * {up}"
    yield "}"


def _lights(scene: Scene, scale: float) -> Iterator[str]:
    middle: F64 = scene.surfaces.bounds().mean(axis=0)
    reach = _measure(scene)
    near = NEAR * reach
    for number, light in enumerate(scene.lights):
        intensity, words = light["intensity"], ""
        place: F64 = light["place"] * scale
        if light["kind"] == DIRECTIONAL:
            place = (middle + FAR * reach * light["place"]) * scale
            words = f" parallel point_at {vector(middle, scale)}"
        if light["falloff"]:
            intensity = intensity / (2.0 * near * near)
            words += f" fade_distance {near * scale:.12g} fade_power 2"
        if light["spot"]:
            # Lights at one place must not stand in each other's shades.
            earlier = np.count_nonzero(np.all(scene.lights["place"][:number] == light["place"], axis=1))
            place = place + np.array((4.0 * SHADE * earlier, 0.0, 0.0))
            yield from _shade(light, place)
        yield f"light_source {{ {vector(place)}, rgb {vector(intensity)}{words} }}"


def _shade(light: np.void, place: F64) -> Iterator[str]:
    """A tiny ball round a spot light that lets through s^2, s rising from 0 to 1 between the cosines of its cones.

    POV-Ray's own spot lights fade by s^2 (3 - 2 s).
    """
    along = " + ".join(f"{axis}*({value:.12g})" for axis, value in zip("xyz", light["axis"], strict=True))
    inner, outer = float(light["cos_inner"]), float(light["cos_outer"])
    fade = f"(({along}) / sqrt(x*x + y*y + z*z) - ({outer:.12g})) / {max(inner - outer, 1e-9):.12g}"
    # Half of it: POV-Ray takes a pattern's value 1 for 0.
    yield f"sphere {{ 0, {SHADE} no_image no_reflection finish {{ diffuse 0 }}"
    yield f"  pigment {{ function {{ 0.5 * pow(min(max({fade}, 0), 1), 2) }}"
    yield f"    color_map {{ [0 rgb 0] [0.5 rgb 0 transmit 1] }} }} translate {vector(place)} }}"
