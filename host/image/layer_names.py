"""Names the layers of a picture, and the files that they go to. Light to import."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from raygrid.host.files.input_guard import STANDARD
from raygrid.host.image.outputs import FORMATS, suffix_of
from raygrid.host.text.clean_text import shown
from raygrid.host.text.misuse import OutputMisuse, SceneMisuse

LAYERS = ("depth", "normal", "surface", "material")
NUMBERS = ("surface", "material")  # layers of whole numbers
HOLDS_LAYERS = ".exr"  # of a picture whose file holds its layers, too


class LayerFile(NamedTuple):
    """The name of a file, and the layer that goes to it."""

    path: str
    layer: str


def checked_layers(names: Iterable[str]) -> tuple[str, ...]:
    """Return each layer that is named once, in the order of LAYERS. Raises SceneMisuse for a name that is none."""
    named = [names] if isinstance(names, str) else list(names)
    for name in named:
        if name not in LAYERS:
            raise SceneMisuse(f"a layer came as {shown(name)}, wanted some of: {' '.join(LAYERS)}")
    return tuple(layer for layer in LAYERS if layer in named)


def layer_path(output: str, layer: str) -> str | None:
    """Return the name of a layer's file beside an output, or None: the output holds its layers itself.

    Beside a picture to look at, layers are pictures of its format; beside numbers they are numbers.
    """
    suffix = suffix_of(output)
    if suffix == HOLDS_LAYERS:
        return None
    stem, own = os.path.splitext(output)
    stays = suffix in FORMATS or suffix == ".npy" or (suffix == ".pfm" and layer not in NUMBERS)
    return f"{stem}.{layer}{own if stays else '.npy'}"


def layer_files(outputs: Sequence[str], layers: Sequence[str]) -> list[LayerFile]:
    """List the files of layers beside these outputs, each once."""
    found: dict[str, LayerFile] = {}
    for output in outputs:
        for layer in layers:
            path = layer_path(output, layer)
            if path is not None:
                found.setdefault(path, LayerFile(path, layer))
    return list(found.values())


def check_outputs_of_layers(single: Sequence[str], played: Sequence[str], layers: Sequence[str]) -> None:
    """Raise OutputMisuse if layers were asked for, and no output has a place for them.

    single  names of pictures; played: of files that hold all frames, which have no layers
    """
    if not layers:
        return
    if STANDARD in single:
        raise OutputMisuse("-: layers came with a picture on standard output, wanted the name of a file")
    if not single:
        raise OutputMisuse(
            f"{played[0]}: a file that plays has no layers, wanted numbered pictures such as f_%04d.exr, too"
        )
