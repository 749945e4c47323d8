"""Pixels as pictures, with texts beside those of a PNG."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from raygrid.host.image.pixel_writer import pixel_writer
from raygrid.node.errors import OutputError

PIXELS = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
TEXTS = {"raygrid": "a b", "Title": "café"}


def written(path, pixels, texts=None):
    file = io.BytesIO()
    pixel_writer(path, pixels, texts)(file)
    return Image.open(file)


def test_a_png_has_the_pixels_and_the_texts():
    with written("a.png", PIXELS, TEXTS) as image:
        np.testing.assert_array_equal(np.asarray(image), PIXELS)
        assert {name: image.info[name] for name in TEXTS} == TEXTS


def test_the_name_chooses_the_format_and_only_a_png_has_texts():
    with written("a.bmp", PIXELS, TEXTS) as image:
        assert image.format == "BMP"
        np.testing.assert_array_equal(np.asarray(image), PIXELS)
        assert not set(image.info) & set(TEXTS)


def test_a_side_that_the_format_cannot_hold_is_refused():
    with pytest.raises(OutputError, match="70000"):
        pixel_writer("a.jpg", np.zeros((1, 70000, 3), np.uint8))
