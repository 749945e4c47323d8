"""Texts beside the pixels of a PNG."""

from __future__ import annotations

import io

from PIL import Image

from raygrid.host.image.png_texts import png_texts


def test_texts_are_read_again():
    file = io.BytesIO()
    Image.new("RGB", (2, 2)).save(file, "PNG", pnginfo=png_texts({"raygrid": "a b", "Title": "café"}))
    with Image.open(file) as image:
        assert (image.info["raygrid"], image.info["Title"]) == ("a b", "café")
