"""The bytes of packets: exact, both ways, and nothing but packets and packet errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.packets import pixel_bytes, ray_bytes, return_bytes, rewritten, rows, shadow_bytes

from raygrid.node.errors import PacketError
from raygrid.node.geometry.lattice import LATTICE
from raygrid.node.protocol import packets, packing
from raygrid.node.protocol.packets import FAULTS, SIZE, Packet, PacketKind, PacketLimits

H = packing.HALF_DIRECTION
LAST = LATTICE - 1
EVERYTHING = PacketLimits(packets.MAX_SAMPLES, packets.MAX_SAMPLES, packets.MAX_LIGHTS, 31, (65536, 65536, 65536))
SMALL = PacketLimits(samples=400, pixels=100, lights=2, depth=5, shape=(4, 3, 2))

ONES = 1024 | 1024 << 11 | 1024 << 22 | 64 << 33  # three weights of 1
LARGEST = 2047 * 2.0**53
LARGEST_SHADOW = 2.0**127 * (2.0 - 2.0**-16)
LARGEST_SENT = float(np.float32(2.0**127 * (2.0 - 2.0**-23)))

# (bytes written, exact bytes by hand from the table in node/protocol/packets.py, what they decode to)
GOLDEN = {
    "primary, all least": (
        ray_bytes(packets.PRIMARY, 1, 0, (0, 0, 0), (H, H), ONES),
        "09 00000000 000000 000000 000000 ffff7f ffff7f 0004200081",
        Packet(PacketKind.PRIMARY, 1, 0, (0, 0, 0), (0.0, 0.0, 1.0), values=(1.0, 1.0, 1.0)),
    ),
    "reflected, all greatest": (
        ray_bytes(packets.REFLECTED, 31, 2**32 - 1, (LAST, LAST, LAST), (2 * H, 2 * H), 2**40 - 1),
        "fa ffffffff ffffff ffffff ffffff feffff feffff ffffffffff",
        Packet(PacketKind.REFLECTED, 31, 2**32 - 1, (LAST,) * 3, (0.0, 0.0, -1.0), values=(LARGEST, LARGEST, LARGEST)),
    ),
    "refracted, every byte its own": (
        ray_bytes(packets.REFRACTED, 2, 0x04030201, (0x070605, 0x0A0908, 0x0D0C0B), (0, H), 1 | 2 << 11 | 4 << 22),
        "13 01020304 050607 08090a 0b0c0d 000000 ffff7f 0110000100",
        Packet(
            PacketKind.REFRACTED,
            2,
            0x04030201,
            (0x070605, 0x0A0908, 0x0D0C0B),
            (-1.0, 0.0, 0.0),
            values=(2.0**-74, 2.0**-73, 2.0**-72),
        ),
    ),
    "shadow, all least": (
        shadow_bytes(1, 0, (0, 0, 0), 0, (0.0, 2.0**-142, 1.0)),
        "0c 00000000 000000 000000 000000 0000 000000 010000 00007f",
        Packet(PacketKind.SHADOW, 1, 0, (0, 0, 0), light=0, values=(0.0, 2.0**-142, 1.0)),
    ),
    "shadow, all greatest": (
        shadow_bytes(31, 2**32 - 1, (LAST, LAST, LAST), 65535, (LARGEST_SHADOW, 1.5, 0.75)),
        "fc ffffffff ffffff ffffff ffffff ffff fffffe 00807f 00807e",
        Packet(PacketKind.SHADOW, 31, 2**32 - 1, (LAST,) * 3, light=65535, values=(LARGEST_SHADOW, 1.5, 0.75)),
    ),
    "return, all least": (
        return_bytes(1, 0, (0.0, 2.0**-149, 1.0), (0, 0, 0)),
        "0d 00000000 00000000 01000000 0000803f 0000 0000 0000 0000",
        Packet(PacketKind.RETURN, 1, 0, values=(0.0, 2.0**-149, 1.0), home=(0, 0, 0)),
    ),
    "return, all greatest": (
        return_bytes(31, 2**32 - 1, (LARGEST_SENT, 0.5, 0.25), (65535, 258, 772)),
        "fd ffffffff ffff7f7f 0000003f 0000803e ffff 0201 0403 0000",
        Packet(PacketKind.RETURN, 31, 2**32 - 1, values=(LARGEST_SENT, 0.5, 0.25), home=(65535, 258, 772)),
    ),
    "pixel, all least": (
        pixel_bytes(0, (0, 0, 0), 0),
        "06 00000000 000000000000 000000000000 000000000000 0000",
        Packet(PacketKind.PIXEL, 0, 0, values=(0, 0, 0), samples=0),
    ),
    "pixel, all greatest": (
        pixel_bytes(2**32 - 1, (2**48 - 1, 0x060504030201, 1), 65535),
        "06 ffffffff ffffffffffff 010203040506 010000000000 ffff",
        Packet(PacketKind.PIXEL, 0, 2**32 - 1, values=(2**48 - 1, 0x060504030201, 1), samples=65535),
    ),
}


@pytest.mark.parametrize("case", GOLDEN)
def test_golden_bytes(case):
    written, exact, packet = GOLDEN[case]
    data = bytes.fromhex(exact)
    assert len(data) == SIZE
    assert written.hex() == data.hex()
    packets.check(data, EVERYTHING)
    assert packets.decode(data) == packet
    assert rewritten(data) == data


def test_golden_table_has_every_kind():
    assert {packet.kind for _, _, packet in GOLDEN.values()} == set(PacketKind)


# --- refused ----------------------------------------------------------------------------------------------

RAY = ray_bytes(packets.PRIMARY, 5, 399, (1, 2, 3), (2 * H, 0), ONES)
SHADOW = shadow_bytes(1, 0, (1, 2, 3), 1, (1.0, 2.0, 3.0))
RETURN = return_bytes(1, 0, (1.0, 2.0, 3.0), (3, 2, 1))
PIXEL = pixel_bytes(99, (1, 2, 3), 4)


def altered(data: bytes, at: int, other: str) -> bytes:
    """The packet with some bytes replaced."""
    new = bytes.fromhex(other)
    return data[:at] + new + data[at + len(new) :]


REFUSED = [
    (1, altered(RAY, 0, "28")),
    (1, altered(RAY, 0, "2f")),
    (2, altered(RAY, 0, "01")),
    (2, altered(RAY, 0, "31")),
    (2, altered(SHADOW, 0, "34")),
    (2, altered(RETURN, 0, "05")),
    (2, altered(PIXEL, 0, "0e")),
    (3, altered(RAY, 1, "90010000")),
    (3, altered(SHADOW, 1, "ffffffff")),
    (3, altered(RETURN, 1, "90010000")),
    (3, altered(PIXEL, 1, "64000000")),
    (4, altered(RAY, 14, "ffffff")),
    (4, altered(RAY, 17, "ffffff")),
    (5, altered(SHADOW, 14, "0200")),
    (6, altered(SHADOW, 16, "0000ff")),
    (6, altered(SHADOW, 19, "ffffff")),
    (6, altered(SHADOW, 22, "0000ff")),
    (7, altered(RETURN, 5, "0000807f")),
    (7, altered(RETURN, 9, "00000080")),
    (7, altered(RETURN, 13, "0100c07f")),
    (8, altered(RETURN, 17, "0400")),
    (8, altered(RETURN, 19, "0300")),
    (8, altered(RETURN, 21, "0200")),
    (9, altered(RETURN, 23, "0100")),
    (9, altered(RETURN, 24, "80")),
]


@pytest.mark.parametrize("data", [RAY, SHADOW, RETURN, PIXEL], ids=["ray", "shadow", "return", "pixel"])
def test_packet_at_the_limits_of_its_frame_is_accepted(data):
    packets.check(data, SMALL)


@pytest.mark.parametrize(("code", "data"), REFUSED)
def test_each_fault_is_found_and_named(code, data):
    assert packets.fault(rows(data), 0, SMALL) == code
    with pytest.raises(PacketError, match=f"^packet {data.hex()}: {FAULTS[code]}$"):
        packets.check(data, SMALL)


def test_every_fault_has_a_case():
    assert {code for code, _ in REFUSED} == set(FAULTS)


@pytest.mark.parametrize("length", [0, 1, 24, 26, 50])
def test_another_length_is_refused(length):
    with pytest.raises(PacketError, match=f"a packet came with {length} bytes, wanted 25"):
        packets.check(b"\x09" * length, SMALL)
    with pytest.raises(PacketError, match=f"^{length} bytes .*are no packet$"):
        packets.decode(b"\x09" * length)


def test_decode_refuses_what_is_no_kind():
    for first in (0x08, 0x0F):
        with pytest.raises(PacketError, match="are no packet"):
            packets.decode(bytes([first]) + RAY[1:])


def test_first_fault_of_many():
    good = RAY + SHADOW + RETURN + PIXEL
    assert packets.first_fault(rows(b"head" + good), 4, 4, SMALL) == (-1, 0)
    bad = altered(SHADOW, 16, "0000ff")
    assert packets.first_fault(rows(b"head" + RAY + PIXEL + bad + REFUSED[0][1]), 4, 4, SMALL) == (2, 6)
    assert packets.first_fault(rows(bad), 0, 0, SMALL) == (-1, 0)


@steady(2000)
@given(st.binary(min_size=SIZE, max_size=SIZE), st.sampled_from([SMALL, EVERYTHING]), st.integers(0, 255))
def test_25_random_bytes_are_a_packet_or_a_packet_error(data, limits, first):
    """Nothing else: what passes `check` can be decoded, described and written again; the rest raises PacketError."""
    data = bytes([first]) + data[1:]  # the rest of the bytes shrinks towards 0, and so towards packets
    try:
        packets.check(data, limits)
    except PacketError:
        return
    packet = packets.decode(data)
    assert len(packets.describe(data).splitlines()) == 1
    assert all(math.isfinite(value) and value >= 0 for value in packet.values)
    assert packet.direction is None or abs(math.hypot(*packet.direction) - 1.0) < 1e-15
    assert rewritten(data) == data


@steady(200)
@given(st.binary(max_size=60))
def test_any_other_length_is_refused(data):
    if len(data) != SIZE:
        with pytest.raises(PacketError):
            packets.check(data, EVERYTHING)


# --- rounding ---------------------------------------------------------------------------------------------

weights = st.floats(2.0**-64, 2.0**64 * (1 - 2.0**-53), allow_subnormal=False)
fractions = st.floats(0.0, 1.0)


@steady(1000)
@given(weights, fractions, fractions, st.permutations([0, 1, 2]))
def test_ray_weights_are_off_by_less_than_a_2047th_of_the_largest(largest, one, other, order):
    exact = [(largest, largest * one, largest * other)[k] for k in order]
    rounded = packets.unpack_weight(packing.pack_weight(*exact))
    assert all(abs(a - b) * 2047 < largest for a, b in zip(exact, rounded, strict=True))
    assert packets.unpack_weight(packing.pack_weight(*rounded)) == rounded


def test_ray_weights_at_the_ends_of_their_range():
    assert packets.unpack_weight(packing.pack_weight(0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert packets.unpack_weight(packing.pack_weight(2.0**-75, 0.0, 0.0)) == (2.0**-74, 0.0, 0.0)
    assert packets.unpack_weight(packing.pack_weight(2.0**-75.01, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    for value in (2.0**64, 1e300, math.inf):
        assert packets.unpack_weight(packing.pack_weight(value, 0.0, 2.0**63)) == (LARGEST, 0.0, 2.0**63)
    # mantissa 2047.5 rounds up into the next exponent
    assert packets.unpack_weight(packing.pack_weight(2047.5, 0.0, 1.0)) == (2048.0, 0.0, 2.0)


@steady(1000)
@given(st.floats(2.0**-126, 2.0**128 * (1 - 2.0**-24)))
def test_shadow_weights_are_off_by_less_than_a_130000th(value):
    rounded = float(packets.unpack_shadow_weight(packing.pack_shadow_weight(value)))
    assert abs(rounded - value) * 130000 < value
    assert packets.unpack_shadow_weight(packing.pack_shadow_weight(rounded)) == rounded


def test_shadow_weights_at_the_ends_of_their_range():
    def sent(value):
        return float(packets.unpack_shadow_weight(packing.pack_shadow_weight(value)))

    assert sent(0.0) == sent(-1.0) == sent(math.nan) == sent(2.0**-150) == 0.0
    assert sent(2.0**-143 * 1.001) == 2.0**-142
    assert sent(1e39) == sent(math.inf) == LARGEST_SHADOW
    assert sent(1.0) == 1.0


def test_an_infinite_intensity_is_sent_as_the_largest():
    data = return_bytes(1, 0, (math.inf, 1.0, LARGEST_SENT), (0, 0, 0))
    packets.check(data, SMALL)
    assert packets.decode(data).values == (LARGEST_SENT, 1.0, LARGEST_SENT)


component = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-9, -1e-9, 0.5]), st.floats(-1.0, 1.0))


@steady(2000)
@given(st.tuples(component, component, component))
def test_directions_are_off_by_less_than_their_bound(vector):
    length = math.hypot(*vector)
    if length < 1e-100:
        return
    exact = np.array(vector) / length
    codes = packing.octahedral(*vector)
    assert all(0 <= code <= 2 * H for code in codes)
    rounded = np.array(packing.unit_vector(*codes))
    chord = float(np.linalg.norm(rounded - exact))
    assert 2.0 * math.asin(chord / 2.0) < 4.25 * 2.0**-24
    assert abs(float(np.linalg.norm(rounded)) - 1.0) < 1e-15
    np.testing.assert_array_equal(rounded[:2][exact[:2] == 0.0], 0.0)  # z is exactly 0 only along x and y


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rays_parallel_to_an_axis_are_exact(axis, sign):
    vector = np.zeros(3)
    vector[axis] = sign * 0.37
    np.testing.assert_array_equal(packing.unit_vector(*packing.octahedral(*vector)), np.sign(vector))


@steady(1000)
@given(st.integers(0, 2 * H), st.integers(0, 2 * H))
def test_a_direction_that_is_sent_again_stays_the_same(a, b):
    """Codes on the rim of the octahedron's square have a twin; the vector is the same."""
    vector = packing.unit_vector(a, b)
    again = packing.unit_vector(*packing.octahedral(*vector))
    np.testing.assert_allclose(again, vector, rtol=0, atol=1e-15)


# --- printed ----------------------------------------------------------------------------------------------

PRINTED = {
    "primary, all least": "primary sample 0, depth 1, from 0 0 0, towards 0.0000 0.0000 1.0000, values 1 1 1",
    "reflected, all greatest": "reflected sample 4294967295, depth 31, from 16777215 16777215 16777215, "
    "towards 0.0000 0.0000 -1.0000, values 1.84377e+19 1.84377e+19 1.84377e+19",
    "refracted, every byte its own": "refracted sample 67305985, depth 2, from 460293 657672 855051, "
    "towards -1.0000 0.0000 0.0000, values 5.29396e-23 1.05879e-22 2.11758e-22",
    "shadow, all greatest": "shadow sample 4294967295, depth 31, from 16777215 16777215 16777215, light 65535, "
    "values 3.4028e+38 1.5 0.75",
    "return, all greatest": "return sample 4294967295, depth 31, home 65535,258,772, values 3.40282e+38 0.5 0.25",
    "pixel, all greatest": "pixel 4294967295, sum 281474976710655 6618611909121 1, samples 65535",
}


@pytest.mark.parametrize("case", PRINTED)
def test_describe(case):
    assert packets.describe(bytes.fromhex(GOLDEN[case][1])) == PRINTED[case]
