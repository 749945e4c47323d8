"""Writes arrays as .npy files."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray


def write_npy(values: NDArray[Any], file: BinaryIO) -> None:
    """Write what np.save writes; but in its own words an error of the disk would say nothing of it."""
    whole = np.ascontiguousarray(values)
    np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(whole))
    file.write(whole.data)
