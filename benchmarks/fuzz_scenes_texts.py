"""Texts of scenes for `fuzz_scenes.py`: every number that may be exchanged stands in angle brackets."""

from __future__ import annotations

import base64
import json
import random
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

_EXTREMES = """
0 -0.0 5e-324 -5e-324 1e-310 1e-300 1e-200 1e-160 1e-45 1e-38 1e-30 -1e-30 1e-16 1e-8 0.9999999999999999
1.0000000000000002 89.99999999999999 179.99999999999997 180 360 1e5 1e8 16777217 2147483648 4294967296
9223372036854775808 1e15 1e16 1e18 1e22 1e29 1e30 -1e30 1.1e30 1e31 1e38 1e39 1e150 1e160 1e300 1.7976931348623157e308
-1e308 nan inf -inf -1 -1e-300 -1e16
"""
EXTREMES = _EXTREMES.split()
NUMBER = re.compile(r"<([^<>]*)>")

NFF = """b <0.1> <0.2> <0.3>
v
from <2.2> <-5> <2>
at <0> <0> <0>
up <0> <0> <1>
angle <40>
hither <1>
resolution <32> <32>
l <3> <-4> <5> <1> <0.9> <0.8>
l <-3> <-4> <6>
f <0.9> <0.7> <0.5> <0.6> <0.3> <20> <0> <0>
p 4
<-3> <-3> <-1>
<3> <-3> <-1>
<3> <3> <-1>
<-3> <3> <-1>
f <0.2> <0.5> <0.9> <0.3> <0.4> <8> <0.5> <1.5>
s <0> <0> <0.2> <0.9>
s <1.6> <0.3> <0> <-0.6>
c <-1.5> <0> <-1> <0.4> <-1.5> <0.2> <1> <0.4>
c <1> <1.5> <-1> <0.5> <1> <1.5> <0.8> <0.1>
p 3
<-2> <2> <-1>
<0> <2> <-1>
<-1> <2> <1>
pp 3
<0> <-2> <-1> <0> <-1> <0.1>
<1.5> <-2> <-1> <0.2> <-1> <0>
<0.7> <-1.8> <0.3> <0> <-1> <0.3>
p 5
<-2> <-2> <-0.9>
<-1> <-2> <-0.9>
<-1.4> <-1.6> <-0.9>
<-1> <-1> <-0.9>
<-2> <-1> <-0.9>
"""

TOML = """background = [<0.1>, <0.2>, <0.3>]
highlights = true
[image]
width = <20>
height = <15>
samples = <1>
depth = <4>
min_weight = <0.001>
[camera]
from = [<2.2>, <1.5>, <5.0>]
at = [<0.0>, <0.1>, <0.0>]
up = [<0.0>, <1.0>, <0.0>]
fov = <40.0>
[materials.glass]
colour = [<0.9>, <0.9>, <1.0>]
diffuse = <0.1>
highlight = [<0.3>, <0.3>, <0.3>]
shine = <50.0>
specular = <0.2>
transmission = [<0.7>, <0.7>, <0.8>]
ior = <1.5>
[materials.matte]
colour = [<0.8>, <0.6>, <0.4>]
[[lights]]
kind = "point"
position = [<3.0>, <4.0>, <3.0>]
intensity = <9.0>
colour = [<1.0>, <0.9>, <0.8>]
falloff = true
[[lights]]
kind = "spot"
position = [<-3.0>, <4.0>, <1.0>]
at = [<0.0>, <0.0>, <0.0>]
intensity = <0.6>
outer_degrees = <30.0>
inner_degrees = <20.0>
[[lights]]
kind = "directional"
towards = [<0.3>, <1.0>, <0.4>]
intensity = <0.5>
disc_degrees = <4.0>
disc_colour = [<1.0>, <1.0>, <0.5>]
[[surfaces]]
kind = "box"
material = "glass"
low = [<-0.8>, <-0.9>, <-0.8>]
high = [<0.7>, <0.8>, <0.6>]
[[surfaces]]
kind = "sphere"
material = "glass"
centre = [<1.6>, <0.1>, <-0.4>]
radius = <0.6>
[[surfaces]]
kind = "cylinder"
material = "matte"
base = [<-1.6>, <-1.0>, <0.0>]
top = [<-1.5>, <1.0>, <0.1>]
radius = <0.3>
[[surfaces]]
kind = "cone"
material = "glass"
base = [<0.0>, <-1.0>, <1.6>]
base_radius = <0.5>
apex = [<0.1>, <0.6>, <1.6>]
apex_radius = <0.1>
[[surfaces]]
kind = "triangle"
points = [[<-2.0>, <-1.0>, <-2.0>], [<0.0>, <-1.0>, <-2.0>], [<-1.0>, <1.5>, <-2.0>]]
normals = [[<0.0>, <0.1>, <1.0>], [<0.1>, <0.0>, <1.0>], [<0.0>, <0.0>, <1.0>]]
[[surfaces]]
kind = "polygon"
material = "matte"
points = [[<-3.0>, <-1.0>, <-3.0>], [<-3.0>, <-1.0>, <3.0>], [<3.0>, <-1.0>, <3.0>], [<3.0>, <-1.0>, <-3.0>]]
"""

SHOT = """[shot]
frames = <3>
fps = <24.0>
[camera]
from = [<2.0>, <1.5>, <5.0>]
at = [<0.0>, <0.0>, <0.0>]
orthographic = <4.0>
[[camera.keys]]
frame = <1>
from = [<2.1>, <1.4>, <5.0>]
up = [<0.0>, <1.0>, <0.1>]
orthographic = <4.2>
[groups.arm]
pivot = [<0.1>, <0.2>, <0.0>]
[[groups.arm.keys]]
frame = <1>
translate = [<0.2>, <0.1>, <0.0>]
rotate = [<10.0>, <20.0>, <30.0>]
scale = <1.2>
[groups.hand]
parent = "arm"
[[groups.hand.keys]]
frame = <1>
rotate = [<0.0>, <90.0>, <0.0>]
scale = <0.8>
[materials.glass]
transmission = <0.6>
specular = <0.2>
ior = <1.4>
[[materials.glass.keys]]
frame = <1>
diffuse = <0.2>
ior = <1.3>
shine = <10.0>
[[lights]]
kind = "directional"
towards = [<1.0>, <2.0>, <3.0>]
[[lights.keys]]
frame = <1>
towards = [<1.0>, <2.0>, <2.5>]
intensity = <0.7>
[[lights]]
kind = "spot"
position = [<0.0>, <4.0>, <2.0>]
at = [<0.0>, <0.0>, <0.0>]
[[lights.keys]]
frame = <1>
position = [<0.1>, <4.0>, <2.0>]
at = [<0.0>, <0.1>, <0.0>]
[[surfaces]]
kind = "polygon"
group = "arm"
points = [[<-2.0>, <-1.0>, <-2.0>], [<-2.0>, <-1.0>, <2.0>], [<2.0>, <-1.0>, <2.0>], [<2.0>, <-1.0>, <-2.0>]]
[[surfaces]]
kind = "sphere"
material = "glass"
group = "hand"
centre = [<0.3>, <0.1>, <0.2>]
radius = <0.7>
[[surfaces]]
kind = "cone"
group = "hand"
material = "glass"
base = [<-1.0>, <-0.8>, <0.0>]
base_radius = <0.4>
apex = [<-1.0>, <0.8>, <0.0>]
[[meshes]]
file = "mesh.obj"
material = "glass"
group = "arm"
scale = [<0.5>, <0.6>, <0.7>]
rotate = [<10.0>, <0.0>, <5.0>]
translate = [<1.0>, <0.3>, <0.2>]
"""

MESH = """mtllib mesh.mtl
v <-1> <-1> <0>
v <1> <-1> <0>
v <1> <1> <0.2>
v <-1> <1> <0>
v <0> <0> <1.3>
vt <0> <0>
vt <1> <0.5>
vt <0.3> <1>
vn <0> <0> <1>
vn <0.2> <0.1> <1>
vn <-0.2> <0> <1>
usemtl glass
f 1/1/1 2/2/2 3/3/3
f 1/1/1 3/3/3 4/2/2
usemtl plain
f 1 2 5
f 2 3 5
f 3 4 5
"""

MTL = """newmtl glass
Kd <0.3> <0.4> <0.5>
Ks <0.3> <0.3> <0.3>
Ns <30>
Ni <1.5>
d <0.5>
Tf <0.8> <0.8> <0.8>
illum <7>
newmtl plain
Kd <0.7> <0.6> <0.5>
Ks <0.1>
Ns <8>
Tr <0>
"""

GLTF = """{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1, 2, 3]}],
"extensionsUsed": ["KHR_lights_punctual"],
"extensions": {"KHR_lights_punctual": {"lights": [
 {"type": "point", "intensity": <100>, "color": [<1>, <0.9>, <0.8>], "range": <50>},
 {"type": "spot", "intensity": <60>, "spot": {"innerConeAngle": <0.2>, "outerConeAngle": <0.6>}},
 {"type": "directional", "intensity": <2>}]}},
"nodes": [
 {"mesh": 0, "translation": [<0.1>, <0>, <0>], "rotation": [<0>, <0.1>, <0>, <0.99>], "scale": [<1>, <1.1>, <1>]},
 {"camera": 0, "translation": [<0.2>, <0.3>, <4>], "rotation": [<0>, <0>, <0>, <1>],
  "children": [4]},
 {"matrix": [<1>, <0>, <0>, <0>, <0>, <1>, <0>, <0>, <0>, <0>, <1>, <0>, <1>, <2>, <3>, <1>],
  "extensions": {"KHR_lights_punctual": {"light": 0}}},
 {"mesh": 1, "rotation": [<0.3>, <0>, <0>, <0.9>], "extensions": {"KHR_lights_punctual": {"light": 2}}},
 {"translation": [<0>, <1>, <0>], "extensions": {"KHR_lights_punctual": {"light": 1}}}],
"cameras": [{"type": "perspective", "perspective": {"yfov": <0.7>, "znear": <0.1>, "aspectRatio": <1.3>}}],
"materials": [
 {"pbrMetallicRoughness": {"baseColorFactor": [<0.9>, <0.8>, <0.7>, <1>], "metallicFactor": <0.2>,
   "roughnessFactor": <0.3>},
  "extensions": {"KHR_materials_transmission": {"transmissionFactor": <0.6>}, "KHR_materials_ior": {"ior": <1.4>},
   "KHR_materials_specular": {"specularFactor": <0.5>, "specularColorFactor": [<1>, <1>, <1>]}}},
 {"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [<0.2>, <0.5>, <0.7>, <0.4>],
   "metallicFactor": <0>, "roughnessFactor": <0.9>}, "emissiveFactor": [<0>, <0>, <0>]}],
"meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "material": 0}]},
 {"primitives": [{"attributes": {"POSITION": 0}, "material": 1, "mode": 5}]}],
"accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3},
 {"bufferView": 1, "componentType": 5126, "type": "VEC3", "count": 3},
 {"bufferView": 2, "componentType": 5126, "type": "VEC3", "count": 3}],
"bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 36},
 {"buffer": 0, "byteOffset": 72, "byteLength": 36}],
"buffers": [{"byteLength": 108, "floats": [
 <-1>, <-1>, <0>, <1>, <-1>, <0.2>, <0>, <1>, <0>, <0>, <0>, <1>, <0.2>, <0>, <1>, <0>, <0.1>, <1>,
 <1>, <0.5>, <0.5>, <0.2>, <1>, <0.5>, <0.3>, <0.3>, <1>]}]}
"""

MOTION = {  # a turning and shifted mesh in the place of the still one
    '"scene": 0,': """"scene": 0, "animations": [{"channels": [
 {"sampler": 0, "target": {"node": 3, "path": "rotation"}}, {"sampler": 1, "target": {"node": 3, "path": "translation"}}],
 "samplers": [{"input": 3, "output": 4}, {"input": 3, "output": 5}]}],""",
    '"type": "VEC3", "count": 3}],\n"bufferViews"': """"type": "VEC3", "count": 3},
 {"bufferView": 3, "componentType": 5126, "type": "SCALAR", "count": 2},
 {"bufferView": 4, "componentType": 5126, "type": "VEC4", "count": 2},
 {"bufferView": 5, "componentType": 5126, "type": "VEC3", "count": 2}],
"bufferViews\"""",
    '"byteOffset": 72, "byteLength": 36}': """"byteOffset": 72, "byteLength": 36},
 {"buffer": 0, "byteOffset": 108, "byteLength": 8}, {"buffer": 0, "byteOffset": 116, "byteLength": 32},
 {"buffer": 0, "byteOffset": 148, "byteLength": 24}""",
    '"byteLength": 108': '"byteLength": 172',
    "<0.3>, <0.3>, <1>]}": """<0.3>, <0.3>, <1>,
 <0>, <1>, <0>, <0.2>, <0>, <0.9>, <0.3>, <0>, <0>, <0.9>, <0.1>, <0>, <0>, <0.4>, <0.2>, <0>]}""",
}
GLTF_MOTION = GLTF
for still, moving in MOTION.items():
    assert still in GLTF_MOTION, still
    GLTF_MOTION = GLTF_MOTION.replace(still, moving)

FORMATS: dict[str, dict[str, str]] = {
    "NFF": {"scene.nff": NFF},
    "TOML": {"scene.toml": TOML},
    "OBJ": {"scene.obj": MESH.replace("mesh.mtl", "scene.mtl"), "scene.mtl": MTL},
    "glTF": {"scene.gltf": GLTF},
    "glTF motion": {"scene.gltf": GLTF_MOTION},
    "TOML shot": {"scene.toml": SHOT, "mesh.obj": MESH, "mesh.mtl": MTL},
}
"""The files of each format, the scene first."""


class Case(NamedTuple):
    """A scene: the name of its format, its files' texts, and what was exchanged, for people."""

    format: str
    files: dict[str, str]
    changes: list[str]

    def write(self, folder: Path) -> Path:
        """Write the files; returns the scene's path."""
        for name, text in self.files.items():
            (folder / name).write_text(text)
        return folder / next(iter(self.files))


def make_case(seed: int, number: int) -> Case:
    """The scene of that number."""
    chance = random.Random(f"{seed} {number}")
    name = list(FORMATS)[number % len(FORMATS)]
    texts = FORMATS[name]
    slots = [(file, k) for file, text in texts.items() for k in range(len(NUMBER.findall(text)))]
    first = (number // len(FORMATS)) % len(slots)
    chosen = {slots[first], *chance.sample(slots, chance.choice((0, 0, 1, 2, 3)))}
    changes, files = [], {}
    for file, text in texts.items():
        at = {k for other, k in chosen if other == file}
        files[file] = _exchanged(file, text, at, chance, changes)
    return Case(name, {file: _finished(file, text) for file, text in files.items()}, changes)


def _exchanged(file: str, text: str, chosen: set[int], chance: random.Random, changes: list[str]) -> str:
    """The text with these of its numbers exchanged, and all brackets gone."""
    numbers = NUMBER.findall(text)
    for k in sorted(chosen):
        before = numbers[k]
        kind = chance.random()
        if kind < 0.1 and k:
            numbers[k] = numbers[k - 1]  # two numbers that are the same by chance
        elif kind < 0.17:
            numbers[k] = before[1:] if before.startswith("-") else f"-{before}"
        else:
            numbers[k] = chance.choice(EXTREMES)
        changes.append(f"{file}: number {k + 1}, {before} became {numbers[k]}")
    parts = iter(numbers)
    return NUMBER.sub(lambda _: _spelled(file, next(parts)), text)


def _spelled(file: str, number: str) -> str:
    """A number as a file of this kind has it."""
    if file.endswith(".gltf"):
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}.get(number, number)
    if file.endswith(".toml"):
        return number if number in ("nan", "inf", "-inf") or len(number) < 19 or "e" in number else f"{number}.0"
    return number


def _finished(file: str, text: str) -> str:
    """Of glTF the numbers of the buffer become bytes."""
    if not file.endswith(".gltf"):
        return text
    document = json.loads(text)
    for buffer in document["buffers"]:
        with np.errstate(all="ignore"):
            data = np.array([float(number) for number in buffer.pop("floats")]).astype("<f4").tobytes()
        buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return json.dumps(document)
