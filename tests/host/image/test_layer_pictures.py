"""Layers as numbers, as channels of an EXR, and as pictures to look at."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from raygrid.host.image.layer_pictures import channels_of, layer_picture, save_layer
from raygrid.host.image.picture import Picture
from raygrid.node.errors import OutputError

RNG = np.random.default_rng(6)
SIZE = (5, 7)


def layers():
    """Of a picture whose first row meets nothing."""
    normals = RNG.normal(size=(*SIZE, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    found = {
        "depth": RNG.uniform(2.0, 9.0, SIZE).astype(np.float32),
        "normal": normals.astype(np.float32),
        "surface": RNG.integers(0, 1 << 28, SIZE).astype(np.int32),
        "material": RNG.integers(0, 1 << 16, SIZE).astype(np.int32),
    }
    found["depth"][0], found["normal"][0], found["surface"][0], found["material"][0] = np.inf, 0.0, -1, -1
    return found


def picture():
    return Picture(RNG.integers(0, 1 << 25, (*SIZE, 3)), 1, {}, layers())


def test_an_exr_has_the_layers_as_channels(tmp_path):
    openexr = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    made = picture()
    made.save(tmp_path / "a.exr")
    with openexr.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        found = {name: channel.pixels for name, channel in file.channels().items()}
    assert set(found) == {"R", "G", "B", "Z", "N.X", "N.Y", "N.Z", "id", "material"}
    np.testing.assert_array_equal(found["Z"], made.layers["depth"])
    for k, axis in enumerate("XYZ"):
        np.testing.assert_array_equal(found[f"N.{axis}"], made.layers["normal"][..., k])
    for channel, layer in (("id", "surface"), ("material", "material")):
        assert found[channel].dtype == np.uint32
        np.testing.assert_array_equal(found[channel].astype(np.int32), made.layers[layer])
        assert (found[channel][0] == 2**32 - 1).all()
    for k, name in enumerate("RGB"):
        np.testing.assert_array_equal(found[name], made.linear()[..., k].astype(np.float32))


def test_only_layers_that_are_there_are_channels():
    assert list(channels_of({"normal": layers()["normal"]})) == ["N.X", "N.Y", "N.Z"]
    assert channels_of({}) == {}


def test_numbers_are_kept_as_they_are(tmp_path):
    for layer, values in layers().items():
        save_layer(str(tmp_path / "a.npy"), layer, values)
        read = np.load(tmp_path / "a.npy")
        assert read.dtype == values.dtype
        np.testing.assert_array_equal(read, values)


@pytest.mark.parametrize(("layer", "kind", "width"), [("depth", b"Pf", 1), ("normal", b"PF", 3)])
def test_a_pfm_has_the_layer_upside_down(layer, kind, width, tmp_path):
    values = layers()[layer]
    save_layer(str(tmp_path / "a.pfm"), layer, values)
    head, size, scale, data = (tmp_path / "a.pfm").read_bytes().split(b"\n", 3)
    assert (head, size, scale) == (kind, b"7 5", b"-1.0")
    read = np.frombuffer(data, "<f4").reshape(5, 7, width)[::-1]
    np.testing.assert_array_equal(read, values.reshape(5, 7, width))


def test_depths_are_grey_from_the_nearest_to_the_farthest():
    depth = np.array([[2.0, 3.0, 4.0, np.inf]], np.float32)
    assert layer_picture("depth", depth)[0].tolist() == [[255] * 3, [147] * 3, [38] * 3, [0] * 3]
    assert layer_picture("depth", np.full((1, 2), np.inf, np.float32)).tolist() == [[[0] * 3] * 2]
    assert layer_picture("depth", np.full((1, 2), 5.0, np.float32)).tolist() == [[[255] * 3] * 2]


def test_normals_are_colours():
    normal = np.array([[[1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, 0]]], np.float32)
    assert layer_picture("normal", normal)[0].tolist() == [[255, 128, 128], [128, 0, 128], [128, 128, 255], [0, 0, 0]]


@pytest.mark.parametrize("layer", ["surface", "material"])
def test_a_number_has_its_own_colour_everywhere(layer):
    numbers = np.arange(-1, 299, dtype=np.int32).reshape(10, 30)
    colours = layer_picture(layer, numbers).reshape(-1, 3)
    assert colours[0].tolist() == [0, 0, 0]
    assert len(np.unique(colours, axis=0)) == 300
    assert colours[1:].max(axis=1).min() > 100
    np.testing.assert_array_equal(layer_picture(layer, numbers[3:4, 5:6])[0, 0], colours[3 * 30 + 5])
    steps = np.abs(np.diff(colours[1:41].astype(int), axis=0)).sum(axis=1)
    assert steps.min() > 100, "neighbours differ much"


def test_a_png_is_what_is_looked_at(tmp_path):
    values = layers()["normal"]
    save_layer(str(tmp_path / "a.png"), "normal", values)
    with Image.open(tmp_path / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(image), layer_picture("normal", values))


def test_layers_are_written_beside_a_picture(tmp_path):
    made = picture()
    names = made.save_layers(tmp_path / "a.png")
    assert [name.rsplit("/", 1)[1] for name in names] == [f"a.{layer}.png" for layer in made.layers]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(name.rsplit("/", 1)[1] for name in names)
    assert made.save_layers(tmp_path / "a.exr") == []
    assert Picture(made.sums, 1, {}).save_layers(tmp_path / "b.png") == []
    (tmp_path / "c.normal.png").mkdir()
    with pytest.raises(OutputError, match=r"c\.normal\.png: the output is a directory, wanted a file$"):
        made.save_layers(tmp_path / "c.png")
    assert not (tmp_path / "c.depth.png").exists(), "what can be seen beforehand is told before anything is written"


def test_a_picture_tells_of_its_layers():
    assert repr(picture()).endswith("1 sample a pixel, layers depth normal surface material>")
    assert "layers" not in repr(Picture(np.zeros((2, 2, 3), np.int64), 1, {}))


def test_an_exr_in_memory_has_them_too(tmp_path):
    openexr = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    path = tmp_path / "a.exr"
    path.write_bytes(picture().encoded("a.exr"))
    with openexr.File(str(path), separate_channels=True) as file:
        assert {"N.X", "Z", "id"} <= set(file.channels())
