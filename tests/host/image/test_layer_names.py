"""Names of layers, and of the files that they go to."""

from __future__ import annotations

import pytest

from raygrid.host.image.frames import FrameNames
from raygrid.host.image.layer_names import LAYERS, checked_layers, layer_files, layer_path
from raygrid.node.errors import OutputError, SceneError


def test_layers_come_once_and_in_one_order():
    assert checked_layers(["surface", "depth", "surface"]) == ("depth", "surface")
    assert checked_layers("normal") == ("normal",)
    assert checked_layers(reversed(LAYERS)) == LAYERS
    assert checked_layers([]) == ()


@pytest.mark.parametrize("name", ["", "Depth", "depth ", "id", 7])
def test_what_is_no_layer_is_refused(name):
    with pytest.raises(SceneError, match=rf"^a layer came as {name!r}, wanted some of: depth normal surface material$"):
        checked_layers(["depth", name])


@pytest.mark.parametrize(
    ("output", "layer", "path"),
    [
        ("a.png", "depth", "a.depth.png"),
        ("out.d/a.JPG", "surface", "out.d/a.surface.JPG"),
        ("a.npy", "normal", "a.normal.npy"),
        ("a.pfm", "normal", "a.normal.pfm"),
        ("a.pfm", "surface", "a.surface.npy"),
        ("a.hdr", "depth", "a.depth.npy"),
        ("a.exr", "depth", None),
        ("f_%04d.tif", "material", "f_%04d.material.tif"),
    ],
)
def test_the_file_of_a_layer(output, layer, path):
    assert layer_path(output, layer) == path


def test_each_file_is_written_once():
    files = layer_files(["a.hdr", "a.npy", "a.exr", "b.png"], ("depth", "surface"))
    assert [tuple(file) for file in files] == [
        ("a.depth.npy", "depth"),
        ("a.surface.npy", "surface"),
        ("b.depth.png", "depth"),
        ("b.surface.png", "surface"),
    ]


def test_frames_have_layers_of_their_own_number():
    names = FrameNames.checked(["f_%02d.png", "all.gif"], "%d.json", (3, 4), True, ("depth",))
    assert [file.path for file in names.layers_of(4)] == ["f_04.depth.png"]
    assert list(names.every([3, 4])) == [
        *("all.gif", "f_03.png", "f_03.depth.png", "3.json"),
        *("f_04.png", "f_04.depth.png", "4.json"),
    ]
    assert FrameNames.checked(["f_%02d.png"], None, (3, 4), True).layers_of(4) == []


@pytest.mark.parametrize(
    ("outputs", "shot", "words"),
    [
        (["a.png", "-"], False, r"-: layers came with a picture on standard output, wanted the name of a file"),
        (
            ["a.gif", "b.mp4"],
            True,
            r"a\.gif: a file that plays has no layers, wanted numbered pictures such as f_%04d\.exr, too",
        ),
    ],
)
def test_outputs_without_a_place_for_layers_are_refused(outputs, shot, words):
    frames = (1, 2) if shot else None
    FrameNames.checked(outputs, None, frames, shot)
    with pytest.raises(OutputError, match=f"^{words}$"):
        FrameNames.checked(outputs, None, frames, shot, ("depth",))
