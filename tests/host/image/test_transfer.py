"""Bytes of a picture: the table against the formula, at every sum where the byte changes and anywhere else."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pytest

from raygrid.host.image.picture import Picture
from raygrid.host.image.transfer import NEVER, TRANSFERS, byte_of, make_table, to_bytes
from raygrid.node.tracing import UNIT

SAMPLES = [1, 2, 3, 4, 7, 16, 100, 65_535]


@pytest.mark.parametrize("transfer", TRANSFERS)
@pytest.mark.parametrize("samples", SAMPLES)
def test_the_table_has_the_bytes_of_the_formula(samples, transfer):
    table = make_table(samples, transfer)
    changes = table.more[table.more != NEVER]
    ranges = np.arange(len(table.first)) << table.shift
    random = np.random.default_rng(samples).integers(0, table.top + table.top // 8, 200_000)
    near = [changes - 2, changes - 1, changes, changes + 1, ranges, ranges + (1 << table.shift) - 1, ranges // 256]
    sums = np.concatenate([*near, random, [0, 1, table.top - 1, table.top, table.top + 1, 2**62]])
    np.testing.assert_array_equal(to_bytes(sums, samples, transfer), byte_of(sums, samples, transfer))


@pytest.mark.parametrize("transfer", TRANSFERS)
def test_every_byte_has_its_sums(transfer):
    whole = to_bytes(np.arange(1 << 24), 1, transfer)
    assert len(np.unique(whole)) == 256
    assert (np.diff(whole.astype(np.int64)) >= 0).all()


def test_a_picture_has_the_shape_of_its_sums():
    sums = np.random.default_rng(1).integers(0, 1 << 24, (70, 333, 3))
    picture = Picture(sums, 1, {})
    assert picture.bytes().shape == sums.shape
    np.testing.assert_array_equal(picture.bytes("linear"), byte_of(sums, 1, "linear"))
    np.testing.assert_array_equal(Picture(sums[::2, ::-1], 1, {}).bytes(), picture.bytes()[::2, ::-1])


@pytest.mark.parametrize("samples", [*range(1, 65), 100, 128, 256])
def test_no_byte_depends_on_the_last_bits_of_a_power(samples):
    """Bytes change at whole sums. Where exactly the formula reaches each byte is never so near to a whole sum that what is
    off in a power of 8 last bits, on whatever computer, could change the sum."""
    shades = (np.arange(1, 256) - 0.5) / 255.0
    exact = [(Decimal(shade) + Decimal("0.055")) / Decimal("1.055") for shade in shades.tolist()]
    least = [each ** Decimal("2.4") if each > Decimal("0.09") else None for each in exact]
    for shade, value in zip(shades.tolist(), least, strict=True):
        reached = (Decimal(shade) / Decimal("12.92") if value is None else value) * int(UNIT) * samples
        off = reached * Decimal(8 * 2.4 * 2.0**-52)
        assert abs(reached - reached.to_integral_value()) > off
