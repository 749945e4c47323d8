"""A picture that is encoded ahead is the file that it would be otherwise, and errors are those of saving; notebooks show it."""

import numpy as np
import pytest
from PIL import Image

from raygrid.host.image import picture as module
from raygrid.host.image.outputs import FORMATS, RADIANCE, SUMS
from raygrid.host.image.picture import Encoder, Picture
from raygrid.node.errors import OutputError
from raygrid.node.tracing.framebuffer import UNIT


def some_picture(width=20, height=10):
    random = np.random.default_rng(1)
    return Picture(random.integers(0, int(UNIT * 2), (height, width, 3)), 1, {})


@pytest.mark.parametrize("transfer", ["srgb", "linear"])
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.ppm", "a.npy"])
@pytest.mark.parametrize("most", [0, 1 << 22], ids=["too large", "ahead"])
def test_the_files_are_the_same(tmp_path, monkeypatch, name, transfer, most):
    monkeypatch.setattr(module, "MOST_AHEAD", most)
    picture = some_picture()
    ahead, plain = str(tmp_path / name), str(tmp_path / f"plain_{name}")
    Encoder(picture, [ahead], transfer).save(ahead)
    picture.save(plain, transfer)
    with open(ahead, "rb") as one, open(plain, "rb") as other:
        assert one.read() == other.read()


def test_several_files(tmp_path):
    paths = [str(tmp_path / name) for name in ("a.png", "b.npy", "c.png")]
    encoding = Encoder(some_picture(), paths, "srgb")
    for path in paths:
        encoding.save(path)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "c.png").read_bytes()
    np.testing.assert_array_equal(np.load(tmp_path / "b.npy"), some_picture().sums)


@pytest.mark.parametrize("suffix", [*FORMATS, *RADIANCE, SUMS])
def test_what_is_encoded_is_what_is_saved(tmp_path, suffix):
    """A KeyError came for radiance and sums."""
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    some_picture().save(tmp_path / f"a{suffix}")
    assert bytes(some_picture().encoded(f"a{suffix}")) == (tmp_path / f"a{suffix}").read_bytes()


def test_what_is_no_format_is_not_encoded():
    with pytest.raises(OutputError, match=r"a.xyz: the output has the suffix '.xyz', wanted one of: .png"):
        some_picture().encoded("a.xyz")


def test_errors_come_from_saving(tmp_path):
    wide = str(tmp_path / "wide.webp")
    encoding = Encoder(some_picture(16_384, 1), [wide], "srgb")
    with pytest.raises(OutputError, match="16384"):
        encoding.save(wide)
    gone = str(tmp_path / "gone" / "a.png")
    encoding = Encoder(some_picture(), [gone], "srgb")
    with pytest.raises(OutputError, match="gone"):
        encoding.save(gone)
    assert not list(tmp_path.iterdir())


def test_a_notebook_shows_the_png_that_is_saved(tmp_path):
    some_picture().save(tmp_path / "a.png")
    shown = some_picture()._repr_png_()
    assert type(shown) is bytes
    assert shown == (tmp_path / "a.png").read_bytes()


def test_as_an_array_it_is_the_values_of_a_display():
    picture = some_picture()
    values = np.asarray(picture)
    assert (values.dtype, values.shape) == (np.uint8, (10, 20, 3))
    np.testing.assert_array_equal(values, picture.bytes())
    np.testing.assert_array_equal(np.asarray(Image.fromarray(values)), picture.bytes())
    assert np.asarray(picture, np.float32).dtype == np.float32
    np.testing.assert_array_equal(np.array(picture, np.float32), picture.bytes())
    np.array(picture)[:] = 0
    np.testing.assert_array_equal(np.asarray(picture), values)
    with pytest.raises(ValueError, match="wanted a copy"):
        np.array(picture, copy=False)
