"""Maps the materials of glTF files from physically based shading to Whitted's.

With base colour C, metal m, roughness r, transmission t (each 0 to 1) and ior n:

    specular      C m (1 - r)                     a polished metal is a mirror, tinted by its colour
    diffuse       C m r + C (1 - m) (1 - t)       a rough one has no mirror image: what it reflects is spread out
    transmission  C (1 - m) t, refracted by n
    highlight     F (s + 2) / 2, at most 1, with exponent s = (2 / r^4 - 2) / 4 and F the reflectance seen head on;
                  none if s < 1

At roughness 0, as in files that mean mirrors and glass, that is the plain mapping: metal gives specular = C and no
diffuse, glass transmission, all else diffuse = C. The 4 % that plastics reflect is left to the highlight.

Textures of the base colour are baked into triangles (`textures`). Those of metal and roughness count with their mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from raygrid.host.scene.builder import IORS, LEAST_IOR, MOST_IOR, Table, material
from raygrid.host.scene.formats.gltf_document import Document, JsonObject
from raygrid.host.scene.formats.mtl import GREY
from raygrid.host.scene.textures import Bytes, Texture, Wrap, read_picture
from raygrid.node.geometry import F64

MAX_SHINE = 1000.0  # a sharper highlight would be smaller than a pixel
WEBP = "EXT_texture_webp"  # a texture whose picture is WebP, with or without another that is not
TINTED = ("diffuse", "specular", "transmission")  # all that base colour multiplies


@dataclass(frozen=True)
class GltfMaterial:
    """One material: a row, MATERIAL (1,), the texture that tints it, which texture coordinates that takes, and its name."""

    row: Table
    texture: Texture | None = None
    coordinates: str = "TEXCOORD_0"
    name: str = ""


@dataclass(frozen=True)
class GltfNumbers:
    """What a material says in numbers, wherever they stand.

    base          linear colour and coverage, (4,)
    metal, rough  factors of the means of `mixed`, the texture of both, if there is one
    blends        whether coverage counts
    passing, ior  transmission, and the index of refraction
    """

    base: F64
    metal: float
    rough: float
    mixed: Texture | None = None
    blends: bool = False
    passing: float = 0.0
    ior: float = 1.5

    def row(self, name: str, glows: bool, remarks: list[str], extra: JsonObject) -> Table:
        """The row of the module's table, with remarks on what is left out; `extra` as `shading` has it."""
        metal, rough, passing, ior = self.metal, self.rough, self.passing, self.ior
        if self.mixed is not None:
            mean = self.mixed.texels.reshape(-1, 3).mean(axis=0) / 255.0
            rough, metal = rough * float(mean[1]), metal * float(mean[2])
            remarks.append(f"{name}: one metal and one roughness used, the mean of their texture")
        if glows:
            remarks.append(f"{name}: its own light left out")
        if self.blends and self.base[3] < 1.0 and passing == 0.0:
            passing, ior = 1.0 - float(self.base[3]), 1.0  # mere coverage does not bend light
        return shading(self.base[:3], metal, rough, passing, ior, extra)


PLAIN = GltfMaterial(GREY)  # the format's own default, a rough white metal, is meant by no file that leaves it out


class Materials:
    """The materials of a document, made when asked for."""

    def __init__(self, document: Document, remarks: list[str]) -> None:
        self._document = document
        self._remarks = remarks
        self._made: dict[object, GltfMaterial] = {}
        self._pictures: dict[object, Bytes] = {}

    def get(self, number: object) -> GltfMaterial:
        """The material of that number; None: matte grey."""
        if number is None:
            return PLAIN
        row = self._document.item("materials", number)
        if number not in self._made:
            self._made[number] = self._make(row, f"material {row.get('name', number)}")
        return self._made[number]

    def _make(self, row: JsonObject, name: str) -> GltfMaterial:
        pbr, extensions = row.get("pbrMetallicRoughness", {}), row.get("extensions", {})
        base = np.array(pbr.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0)), np.float64)
        metal, rough = float(pbr.get("metallicFactor", 1.0)), float(pbr.get("roughnessFactor", 1.0))
        mixed = self._texture(pbr["metallicRoughnessTexture"])[0] if "metallicRoughnessTexture" in pbr else None
        passing = float(extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0.0))
        ior = float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5))
        if passing > 0.0 and ior > 0.0 and not LEAST_IOR <= ior <= MOST_IOR:
            raise self._document.error(f"{name} has the index of refraction {ior:g}, wanted {IORS}")
        numbers = GltfNumbers(base, metal, rough, mixed, row.get("alphaMode") == "BLEND", passing, ior)
        glows = any(row.get("emissiveFactor", ())) or "KHR_materials_unlit" in extensions
        shaded = numbers.row(name, glows, self._remarks, extensions.get("KHR_materials_specular", {}))
        called = str(row.get("name", ""))
        if "baseColorTexture" not in pbr:
            return GltfMaterial(shaded, name=called)
        texture, coordinates = self._texture(pbr["baseColorTexture"])
        return GltfMaterial(shaded, texture, coordinates, called)

    def _texture(self, info: JsonObject) -> tuple[Texture, str]:
        if "KHR_texture_transform" in info.get("extensions", {}):
            self._remarks.append("the transform of a texture left out")
        row = self._document.item("textures", info["index"])
        sampler = self._document.item("samplers", row["sampler"]) if "sampler" in row else {}
        wraps = (Wrap(sampler.get(key, Wrap.REPEAT.value)) for key in ("wrapS", "wrapT"))
        source = row.get("source", row.get("extensions", {}).get(WEBP, {}).get("source"))
        return Texture(self._texels(source), *wraps), f"TEXCOORD_{info.get('texCoord', 0)}"

    def _texels(self, number: object) -> Bytes:
        """The texels of an image, which several textures may share."""
        if not isinstance(number, int) or number not in self._pictures:
            data, where = self._document.picture(number)
            self._pictures[number] = read_picture(data, where)
        return self._pictures[number]


def shading(base: F64, metal: float, rough: float, passing: float, ior: float, extra: JsonObject) -> Table:
    """The row for a base colour (3,), linear, and the numbers named in the module's table.

    extra: KHR_materials_specular, which scales the highlight of what is no metal.
    """
    metal, rough, passing = (min(max(value, 0.0), 1.0) for value in (metal, rough, passing))
    tint = float(extra.get("specularFactor", 1.0)) * np.array(extra.get("specularColorFactor", (1.0, 1.0, 1.0)))
    straight, wide = (ior - 1.0) / (ior + 1.0), max(rough, 0.05) * max(rough, 0.05)
    facing = straight * straight * tint * (1.0 - metal) + base * metal
    shine = min((2.0 / (wide * wide) - 2.0) / 4.0, MAX_SHINE)
    if shine < 1.0:
        facing = np.zeros(3)  # a highlight that wide is no highlight, but a wash over all that is lit
    return material(
        diffuse=base * (metal * rough + (1.0 - metal) * (1.0 - passing)),
        highlight=np.minimum(facing * (shine + 2.0) / 2.0, 1.0),
        shine=shine,
        specular=base * metal * (1.0 - rough),
        transmission=base * (1.0 - metal) * passing,
        ior=ior if ior > 0.0 else 1.0,
    )
