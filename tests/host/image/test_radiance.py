"""Linear radiance in files, as other programs read it."""

import io
import re
import tempfile

import numpy as np
import pytest
from PIL import Image

from raygrid.host.image import outputs
from raygrid.host.image.outputs import FORMATS, RADIANCE, check_picture_path
from raygrid.host.image.picture import Picture
from raygrid.host.image.radiance import WRITERS, packed, rgbe, write_hdr, write_pfm
from raygrid.node.errors import OutputError

RNG = np.random.default_rng(4)


def picture(width=40, height=9):
    """Values from 0 to 8, with runs."""
    sums = RNG.integers(0, 1 << 27, (height, width, 3))
    sums[2:4, 5:30], sums[0, 0] = sums[2, 5], 0
    return Picture(sums, 1, {})


def test_a_pfm_has_the_radiance_upside_down(tmp_path):
    made = picture()
    made.save(tmp_path / "a.pfm")
    head, size, scale, data = (tmp_path / "a.pfm").read_bytes().split(b"\n", 3)
    assert (head, size, scale) == (b"PF", b"40 9", b"-1.0")
    read = np.frombuffer(data, "<f4").reshape(9, 40, 3)[::-1]
    np.testing.assert_array_equal(read, made.linear().astype(np.float32))


def unpacked(data, width):
    """A row of an HDR file, (width, 4), and what follows it."""
    assert data[:4] == bytes((2, 2, width >> 8, width & 255))
    at, channels = 4, []
    for _ in range(4):
        row = b""
        while len(row) < width:
            count = data[at]
            if count > 128:
                row, at = row + data[at + 1 : at + 2] * (count - 128), at + 2
            else:
                assert count > 0
                row, at = row + data[at + 1 : at + 1 + count], at + 1 + count
        channels.append(np.frombuffer(row, np.uint8))
    return np.stack(channels, axis=1), data[at:]


@pytest.mark.parametrize("width", [8, 40, 300])
def test_an_hdr_has_the_radiance_to_a_256th(width):
    made, file = picture(max(width, 40)).linear()[:, :width], io.BytesIO()
    write_hdr(made, file)
    head, data = file.getvalue().split(b"\n\n", 1)
    assert head == b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe"
    size, data = data.split(b"\n", 1)
    assert size == f"-Y 9 +X {width}".encode()
    for row in made:
        pixels, data = unpacked(data, width)
        read = np.where(pixels[:, 3:] > 0, (pixels[:, :3] + 0.5) * 2.0 ** (pixels[:, 3:].astype(float) - 136), 0.0)
        assert (np.abs(read - row) <= row.max(axis=1, keepdims=True) / 255).all()
    assert data == b""


def test_rows_that_are_too_short_to_be_packed_are_plain():
    file = io.BytesIO()
    write_hdr(picture().linear()[:, :3], file)
    assert len(file.getvalue().split(b"+X 3\n", 1)[1]) == 9 * 3 * 4


def test_the_faintest_and_the_brightest_have_an_exponent():
    values = np.array([[[0, 0, 0], [1e-38, 0, 0], [1, 0.5, 0.25], [255.999, 0, 0], [1e30, 1e30, 1e30]]])
    table = rgbe(values)[0]
    assert table[:3].tolist() == [[0, 0, 0, 0], [0, 0, 0, 0], [128, 64, 32, 129]]
    assert table[3].tolist() == [255, 0, 0, 136]
    assert table[4, 0] >= 128


@pytest.mark.parametrize("values", [[5] * 300, list(range(200)), [1, 1, 1, 2, 2, 2, 2, 3], [7]])
def test_runs_and_all_else_come_back(values):
    data, read, at = packed(np.array(values, np.uint8)), [], 0
    while at < len(data):
        count = data[at]
        read += [data[at + 1]] * (count - 128) if count > 128 else data[at + 1 : at + 1 + count]
        at += 2 if count > 128 else 1 + count
    assert read == values


def test_an_exr_has_the_radiance_and_needs_no_temporary_directory(tmp_path, monkeypatch):
    """It needed one, and left it there if it was killed."""
    openexr = pytest.importorskip("OpenEXR")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    made = picture()
    made.save(tmp_path / "a.exr")
    with openexr.File(str(tmp_path / "a.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, made.linear().astype(np.float32))
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def test_without_the_library_an_exr_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(outputs.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        OutputError, match=re.escape("OpenEXR is not installed, wanted the extra: pip install 'raygrid[exr]'")
    ):
        check_picture_path(tmp_path / "a.exr")


@pytest.mark.parametrize("suffix", FORMATS)
def test_all_kinds_of_pictures_can_be_opened(tmp_path, suffix):
    made = picture()
    made.save(tmp_path / f"a{suffix}")
    with Image.open(tmp_path / f"a{suffix}") as image:
        read = np.asarray(image.convert("RGB"))
    if "jp" in suffix and suffix != ".jp2":
        assert read.shape == (9, 40, 3)
    else:
        np.testing.assert_array_equal(read, made.bytes())


def test_every_kind_of_radiance_has_a_writer():
    assert set(WRITERS) == set(RADIANCE)
    assert WRITERS[".pfm"] is write_pfm
