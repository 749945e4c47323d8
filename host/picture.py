"""The picture: exact sums of the pixel store, and what is written of them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import OutputError
from raygrid.node.pixels import UNIT

TRANSFERS = ("srgb", "linear")


@dataclass(frozen=True)
class Picture:
    """A rendered frame.

    sums     int64 (height, width, 3): sum over a pixel's samples of round(linear radiance * 2^24), row 0 on top
    samples  samples a pixel
    stats    what the machine did (docs/stats.md), or an empty map
    """

    sums: NDArray[np.int64]
    samples: int
    stats: dict[str, Any]

    def linear(self) -> NDArray[np.float64]:
        """Linear radiance, float64 (height, width, 3): sums / (2^24 samples)."""
        return self.sums / (UNIT * self.samples)

    def bytes(self, transfer: str = "srgb") -> NDArray[np.uint8]:
        """The picture as uint8 (height, width, 3), values above 1 cut off. transfer: "srgb" (IEC 61966-2-1) or "linear"."""
        if transfer not in TRANSFERS:
            raise OutputError(f"a transfer came as {transfer!r}, wanted one of {', '.join(TRANSFERS)}")
        values = np.minimum(self.linear(), 1.0)
        if transfer == "srgb":
            values = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
        return np.floor(values * 255.0 + 0.5).astype(np.uint8)

    def save(self, path: str | Path, transfer: str = "srgb") -> None:
        """Write a .npy of the sums, or a picture of any kind that Pillow knows. The file appears whole or not at all.

        Raises OutputError.
        """
        path = Path(path)
        check_output(path)
        part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
        try:
            if path.suffix == ".npy":
                np.save(part, self.sums, allow_pickle=False)
            else:
                from PIL import Image

                Image.fromarray(self.bytes(transfer)).save(part)
            part.replace(path)
        except (OSError, ValueError) as error:
            part.unlink(missing_ok=True)
            raise OutputError(f"{path}: the picture cannot be written: {error}") from None
        except BaseException:
            part.unlink(missing_ok=True)
            raise


def check_output(path: str | Path) -> None:
    """Raise OutputError if a file of this name can surely not be written: asked before the work, not after."""
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: the output is a directory, wanted a file")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no directory {path.parent}")
    if not os.access(path.parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise OutputError(f"{path}: the output may not be written")
    if path.suffix == ".npy":
        return
    from PIL import Image

    known = Image.registered_extensions()
    if known.get(path.suffix.lower()) not in Image.SAVE:
        raise OutputError(f"{path}: the output has the suffix {path.suffix!r}, wanted .png, .npy or another picture's")
