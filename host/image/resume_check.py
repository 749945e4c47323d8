"""Checks that the files of a frame are there, whole, and of just that frame, which `--resume` then skips."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from raygrid.host.image.outputs import SUMS, check_picture_path, suffix_of, write_whole
from raygrid.host.image.pixel_writer import pixel_writer
from raygrid.node.errors import RaygridError

if TYPE_CHECKING:
    from raygrid.host.image.layer_names import LayerFile
    from raygrid.host.image.picture import Picture

KEYWORD = "raygrid"  # of the text in a .png: the digest of what it is a picture of, and that of its pixels
PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
Recorded = Callable[[str, str], bool]


def save_marked(picture: Picture, path: str, transfer: str, digest: str) -> None:
    """Write a picture or a .npy; a .png says itself what it is. Raises OutputError."""
    if suffix_of(path) == ".png":
        _write_marked(path, digest, picture.bytes(transfer))
    else:
        picture.save(path, transfer)


def save_marked_layer(picture: Picture, file: LayerFile, digest: str) -> None:
    """Write a layer of a picture; a .png says itself what it is. Raises OutputError."""
    from raygrid.host.image.layer_pictures import layer_picture, save_layer

    path, layer = file
    values = picture.layers[layer]
    if suffix_of(path) == ".png":
        _write_marked(path, digest_of_layers(digest, layer), layer_picture(layer, values))
    else:
        save_layer(path, layer, values)


def _write_marked(path: str, digest: str, pixels: NDArray[np.uint8]) -> None:
    check_picture_path(path)
    write_whole(path, pixel_writer(path, pixels, mark(digest, pixels)))


def digest_of_layers(digest: str, *layers: str) -> str:
    """A digest of all that a file with these layers depends on, of that of its picture."""
    return hashlib.sha256(" ".join((digest, *layers)).encode()).hexdigest()


def mark(digest: str, pixels: NDArray[np.uint8]) -> dict[str, str]:
    """The text by which a .png says of what it is a picture, and that its pixels are those."""
    return {KEYWORD: f"{digest} {_digest_of_pixels('RGB', pixels.shape[1::-1], pixels)}"}


def nobody(_path: str, _digest: str) -> bool:
    """Stand in for a journal where there is none: nothing is recorded."""
    return False


def frame_is_there(
    files: Iterable[tuple[str, str]], stats: str | None, size: tuple[int, int], recorded: Recorded = nobody
) -> bool:
    """Test that all files of a frame are there, whole, and of just that frame; statistics need only be there.

    files  (path, digest of all that it depends on)
    """
    if stats is not None and not os.path.isfile(stats):
        return False
    with contextlib.suppress(RaygridError):  # a journal that cannot be read vouches for nothing
        return all(is_whole(file, digest, *size, recorded) for file, digest in files)
    return False


def film_is_there(path: str, digest: str, recorded: Recorded) -> bool:
    """Test that a file that plays is there as it was written, with that digest."""
    with contextlib.suppress(RaygridError):
        return os.path.isfile(path) and recorded(path, digest)
    return False


def is_whole(path: str, digest: str, width: int, height: int, recorded: Recorded) -> bool:
    """Test that the file at `path` is the picture of that digest and size, and can be read to its end.

    recorded  whether the journal says that this file was written with that digest and has not been changed since;
              for a .png the digest inside it is enough
    """
    if not os.path.isfile(path):
        return False
    if os.path.splitext(path)[1].lower() == SUMS:
        return recorded(path, digest) and _sums_are_whole(path, width, height)
    found = _text_of_picture(path, width, height)
    return found is not None and (found == digest or recorded(path, digest))


def _sums_are_whole(path: str, width: int, height: int) -> bool:
    try:
        sums = np.load(path, mmap_mode="r", allow_pickle=False)  # fails if the file is too short
    except (OSError, ValueError, EOFError):
        return False
    return bool(sums.shape == (height, width, 3) and sums.dtype == np.int64)


def _text_of_picture(path: str, width: int, height: int) -> str | None:
    """The digest inside a picture, "" if there is none, or one of other pixels; None if the picture cannot be read, or
    has another size."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            picture.verify()  # of a .png every chunk, which the decoder does not need
            png = picture.format == "PNG"
        with Image.open(path) as picture:
            size = picture.size
            picture.load()  # all of it
            digest, _, pixels = str(picture.info.get(KEYWORD, "")).partition(" ")
            own = bool(pixels) and pixels == _digest_of_pixels(picture.mode, size, np.asarray(picture))
    except Exception:  # Pillow's decoders raise nearly anything on damaged data
        return None
    if size != (width, height) or (png and not _has_png_end(path)):
        return None
    return digest if own else ""


def _digest_of_pixels(mode: str, size: tuple[int, ...], pixels: NDArray[np.generic]) -> str:
    """A digest of what is seen: a picture that was edited has another, whatever its text says."""
    about = f"{mode} {size[0]}x{size[1]} ".encode()
    return hashlib.sha256(about + np.ascontiguousarray(pixels).tobytes()).hexdigest()


def _has_png_end(path: str) -> bool:
    with open(path, "rb") as file:
        file.seek(-len(PNG_END), os.SEEK_END)
        return file.read() == PNG_END
