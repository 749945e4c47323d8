"""Arrays as .npy files."""

from __future__ import annotations

import io

import numpy as np
import pytest

from raygrid.host.image.npy import write_npy


@pytest.mark.parametrize("dtype", [np.int64, np.int32, np.float32])
def test_the_bytes_are_those_of_numpy(dtype):
    values = np.arange(24).reshape(2, 3, 4).astype(dtype)
    for each in (values, values[:, ::2], values[..., 0].T):
        ours, theirs = io.BytesIO(), io.BytesIO()
        write_npy(each, ours)
        np.save(theirs, np.ascontiguousarray(each))
        assert ours.getvalue() == theirs.getvalue()
