"""Defines the bytes of packets, reads and checks them; `packing` beside it writes those of rays, `decoding` tells what they say.

Every packet is exactly 25 bytes, little-endian.

======  ==========================  ==========================  =======================  ====================
offset  PRIMARY REFLECTED REFRACTED  SHADOW                      RETURN                   PIXEL
======  ==========================  ==========================  =======================  ====================
0       kind (low 3 bits), depth (high 5 bits: 1..31 for rays, shadows, returns; 0 for pixels)
1-4     sample u32                  sample u32                  sample u32               pixel u32
5-13    origin 3 x u24              origin 3 x u24              intensity 3 x f32 ...    sum 3 x u48 ...
14-19   direction 2 x u24           light u16, weight 3 x 24 b  ... (5-16), home 3 x u16 ... (5-22)
20-24   weight 40 bits              ... (14-15, 16-24)          (17-22), zero (23-24)    samples u16 (23-24)
======  ==========================  ==========================  =======================  ====================

sample     pixel number times samples per pixel plus sample number; pixel number is row * width + column
origin     lattice coordinates (`node.geometry.lattice`), one per axis
direction  octahedral (Meyer et al. 2010): two numbers 0 .. 2^24 - 2, 2^23 - 1 stands for 0, so that rays
           parallel to an axis are exact; 2^24 - 1 is refused; off by less than 4.25 * 2^-24 radians
weight     of a ray: three 11-bit mantissas (red lowest) under one 7-bit exponent E: m * 2^(E - 63 - 11),
           each off by less than 1/2047 of the largest, if that lies in 2^-64 .. 2^64
           of a shadow: three floats of 8 exponent and 16 mantissa bits (a binary32 without sign and low 7 bits),
           each off by less than 1/130000 of itself, if it lies in 2^-126 .. 2^128
intensity  binary32, finite and not negative
home       cell of the sample's home, so that no node on the way has to work it out again
sum        of fixed-point intensities (`node.tracing.framebuffer`); a pixel may come in several packets

Rays, shadow rays and their rounding to the wire are packed by `node.protocol.packing`.
Byte positions (`at`) are offsets into flat uint8 arrays.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raygrid.node.jit.decorators import kernel, lean, part
from raygrid.node.jit.intrinsics import copy_bytes, load_8, load_16, load_32, load_64, put_words
from raygrid.node.protocol.packing import HALF_DIRECTION, LARGEST_BINARY32, WEIGHT_BIAS

SIZE = 25

PRIMARY, REFLECTED, REFRACTED, SHADOW, RETURN, PIXEL = 1, 2, 3, 4, 5, 6
KINDS = 7  # tables indexed by kind have this length; 0 is not a kind


class PacketKind(IntEnum):
    """The low three bits of byte 0."""

    PRIMARY = PRIMARY
    REFLECTED = REFLECTED
    REFRACTED = REFRACTED
    SHADOW = SHADOW
    RETURN = RETURN
    PIXEL = PIXEL


MAX_DEPTH = 31
MAX_LIGHTS = 1 << 16
MAX_SAMPLES = 1 << 32
MAX_PIXEL_SUM = (1 << 48) - 1
MAX_PIXEL_SAMPLES = (1 << 16) - 1
# 2^(E - 63 - 11) for every stored exponent E
WEIGHT_UNIT = np.ldexp(1.0, np.arange(128) - WEIGHT_BIAS - 11)

U8 = NDArray[np.uint8]


class PacketLimits(NamedTuple):
    """Limits of what a packet of a frame may name; `check` refuses the rest."""

    samples: int  # sample numbers are below this
    pixels: int
    lights: int
    depth: int
    shape: tuple[int, int, int]  # of the array


# --- little-endian integers ---------------------------------------------------------------------------


@part
def read_u16(buffer, at):
    """The two bytes at `at`, as int64."""
    return load_16(buffer, at)


@part
def read_u24(buffer, at):
    """The three bytes at `at`, as int64."""
    return load_16(buffer, at) | (load_8(buffer, at + 2) << 16)


@part
def read_u32(buffer, at):
    """The four bytes at `at`, as int64."""
    return load_32(buffer, at)


@part
def read_u48(buffer, at):
    """The six bytes at `at`, as int64."""
    return load_32(buffer, at) | (load_16(buffer, at + 4) << 32)


@part
def read_u64(buffer, at):
    """The eight bytes at `at`, as int64."""
    return load_64(buffer, at)


@part
def read_origin(buffer, at):
    """The three lattice coordinates of the ray or shadow ray whose packet begins at `at`."""
    low = read_u64(buffer, at + 5)
    return low & 0xFFFFFF, (low >> 24) & 0xFFFFFF, ((low >> 48) & 0xFFFF) | (load_8(buffer, at + 13) << 16)


@part
def read_kind(buffer, at):
    """The kind of the packet that begins at `at`."""
    return load_8(buffer, at) & 7


@part
def read_depth(buffer, at):
    """The depth of the packet that begins at `at`."""
    return load_8(buffer, at) >> 3


@part
def read_weight(buffer, at):
    """Three float64 weights of the ray whose packet begins at `at`."""
    return unpack_weight(read_u64(buffer, at + 17) >> 24)


@part
def write(buffer, at, value, size):
    """Put a whole number into `size` bytes, the least first."""
    for k in range(size):
        buffer[at + k] = np.uint8((value >> (8 * k)) & 0xFF)


# --- weights, out of bytes ------------------------------------------------------------------------------


@part
def unpack_weight(bits):
    """Three float64 weights out of 40 bits."""
    unit = WEIGHT_UNIT[(bits >> 33) & 127]
    return (bits & 2047) * unit, ((bits >> 11) & 2047) * unit, ((bits >> 22) & 2047) * unit


@part
def unpack_shadow_weight(bits):
    """The float64 that 24 bits stand for."""
    return np.float64(np.uint32(bits << 7).view(np.float32))


# --- whole packets ------------------------------------------------------------------------------------


@part
def put_return(buffer, at, depth, sample, intensity, home):
    """Write a return packet. `intensity`: three binary32, `home`: cell of the sample's home."""
    red, green, blue = _finite_bits(intensity[0]), _finite_bits(intensity[1]), _finite_bits(intensity[2])
    put_words(
        buffer,
        at,
        RETURN | (depth << 3) | (sample << 8) | ((red & 0xFFFFFF) << 40),
        (red >> 24) | (green << 8) | ((blue & 0xFFFFFF) << 40),
        (blue >> 24) | (home[0] << 8) | (home[1] << 24) | (home[2] << 40),
    )
    buffer[at + 24] = np.uint8(0)


@part
def _finite_bits(intensity):
    """The bits of a binary32; a product of bright things may be infinite."""
    return np.int64(np.float32(min(np.float64(intensity), LARGEST_BINARY32)).view(np.uint32))


@part
def put_pixel(buffer, at, pixel, sums, samples):
    """Write a pixel packet. `sums`: three integers below 2^48, `samples` below 2^16."""
    number, count = np.int64(pixel), np.int64(samples)
    r, g, b = np.int64(sums[0]), np.int64(sums[1]), np.int64(sums[2])
    first = PIXEL | (number << 8) | (r << 40)
    put_words(buffer, at, first, (r >> 24) | (g << 24), (g >> 40) | (b << 8) | (count << 56))
    buffer[at + 24] = np.uint8(count >> 8)


@part
def get_pixel(buffer, at):
    """(pixel, red, green, blue, samples) of a pixel packet."""
    first, second, third = load_64(buffer, at), load_64(buffer, at + 8), load_64(buffer, at + 16)
    r = ((first >> 40) & 0xFFFFFF) | ((second & 0xFFFFFF) << 24)
    g = ((second >> 24) & 0xFFFFFFFFFF) | ((third & 0xFF) << 40)
    samples = ((third >> 56) & 0xFF) | (np.int64(buffer[at + 24]) << 8)
    return (first >> 8) & 0xFFFFFFFF, r, g, (third >> 8) & 0xFFFFFFFFFFFF, samples


@part
def get_intensity(buffer, at):
    """The three binary32 of a return packet."""
    return (
        np.uint32(read_u32(buffer, at + 5)).view(np.float32),
        np.uint32(read_u32(buffer, at + 9)).view(np.float32),
        np.uint32(read_u32(buffer, at + 13)).view(np.float32),
    )


@part
def copy_packet(source, at, target, to):
    """Move 25 bytes."""
    copy_bytes(source, at, target, to, SIZE)


# --- checking -----------------------------------------------------------------------------------------

FAULTS = {
    1: "unknown kind",
    2: "depth out of range",
    3: "sample or pixel number out of range",
    4: "direction code out of range",
    5: "light number out of range",
    6: "weight not finite",
    7: "intensity negative or not finite",
    8: "home outside the array",
    9: "reserved bytes not zero",
}


@part
def _fault_of_return(buffer, at, limits):
    for k in range(3):
        # sign bit clear and below the bits of infinity: finite and not negative in one comparison
        if read_u32(buffer, at + 5 + 4 * k) >= 0x7F800000:
            return 7
    if (
        read_u16(buffer, at + 17) >= limits.shape[0]
        or read_u16(buffer, at + 19) >= limits.shape[1]
        or read_u16(buffer, at + 21) >= limits.shape[2]
    ):
        return 8
    return 9 if read_u16(buffer, at + 23) != 0 else 0


@part
def _is_sound_start(head, limits):
    """Tell whether depth and sample are those of a ray or shadow ray; `head`: the first bytes of its packet."""
    depth, number = (head >> 3) & 31, (head >> 8) & 0xFFFFFFFF
    return (depth >= 1) & (depth <= limits.depth) & (number < limits.samples)


@part
def is_sound_shadow(buffer, at, limits):
    """Tell whether the packet at `at` is one of a shadow ray without a fault. Without a branch, as the next two."""
    head, tail = read_u64(buffer, at), read_u64(buffer, at + 14)
    weights = max((tail >> 16) & 0xFFFFFF, max((tail >> 40) & 0xFFFFFF, read_u64(buffer, at + 17) >> 40 & 0xFFFFFF))
    sound = _is_sound_start(head, limits) & ((head & 7) == SHADOW)
    return sound & ((tail & 0xFFFF) < limits.lights) & (weights < 0xFF0000)


@part
def is_sound_ray(buffer, at, limits):
    """Tell whether the packet at `at` is one of a primary, reflected or refracted ray without a fault."""
    head, tail = read_u64(buffer, at), read_u64(buffer, at + 14)
    sound = _is_sound_start(head, limits) & ((head & 7) >= PRIMARY) & ((head & 7) <= REFRACTED)
    return sound & (max(tail & 0xFFFFFF, (tail >> 24) & 0xFFFFFF) <= 2 * HALF_DIRECTION)


@part
def is_sound_return(buffer, at, limits):
    """Tell whether the packet at `at` is a return without a fault."""
    head, middle, tail = read_u64(buffer, at), read_u64(buffer, at + 5), read_u64(buffer, at + 17)
    largest = max(middle & 0xFFFFFFFF, max((middle >> 32) & 0xFFFFFFFF, read_u32(buffer, at + 13)))
    x, y, z = tail & 0xFFFF, (tail >> 16) & 0xFFFF, (tail >> 32) & 0xFFFF
    inside = (x < limits.shape[0]) & (y < limits.shape[1]) & (z < limits.shape[2]) & ((tail >> 48) & 0xFFFF == 0)
    return _is_sound_start(head, limits) & ((head & 7) == RETURN) & (largest < 0x7F800000) & inside


@part
def fault(buffer, at, limits):
    """0 if the 25 bytes at `at` are a packet of this frame, else a key of FAULTS."""
    # rays and shadow rays, nearly all that comes, by one branch
    kind = read_kind(buffer, at)
    if kind == SHADOW:
        if is_sound_shadow(buffer, at, limits):
            return 0
    elif is_sound_ray(buffer, at, limits):
        return 0
    return _named_fault(buffer, at, limits)


@part
def _named_fault(buffer, at, limits):
    """Find the fault that `fault` names, one thing after the other."""
    kind, depth = np.int64(buffer[at]) & 7, np.int64(buffer[at]) >> 3
    if kind < PRIMARY or kind > PIXEL:
        return 1
    if kind == PIXEL:
        if depth != 0:
            return 2
        return 3 if read_u32(buffer, at + 1) >= limits.pixels else 0
    if depth < 1 or depth > limits.depth:
        return 2
    if read_u32(buffer, at + 1) >= limits.samples:
        return 3
    if kind == RETURN:
        return _fault_of_return(buffer, at, limits)
    if kind == SHADOW:
        if read_u16(buffer, at + 14) >= limits.lights:
            return 5
        for k in range(3):
            if read_u24(buffer, at + 16 + 3 * k) >= 0xFF0000:  # exponent all ones: infinity or not a number
                return 6
        return 0
    too_far = 2 * HALF_DIRECTION
    return 4 if read_u24(buffer, at + 14) > too_far or read_u24(buffer, at + 17) > too_far else 0


@kernel
def first_fault(buffer, start, count, limits):
    """(index, fault) of the first bad one of `count` packets from byte `start`, or (-1, 0)."""
    for k in range(count):
        bad = fault(buffer, start + k * SIZE, limits)
        if bad != 0:
            return k, bad
    return -1, 0


# --- many pixel packets at once, for the host ---------------------------------------------------------


@lean
def add_pixels(buffer, start, count, sums, samples, most):
    """Add `count` packets from byte `start` to sums int64 (pixels, 3) and samples (pixels,), whole numbers up to `most`.

    False if one is no pixel packet or names a pixel that is not there, and then nothing is added. Samples beyond `most`
    count as `most`.
    """
    for k in range(count):
        head = load_64(buffer, start + k * SIZE)
        if (head & 0xFF) != PIXEL or ((head >> 8) & 0xFFFFFFFF) >= len(samples):
            return False
    for k in range(count):
        pixel, r, g, b, many = get_pixel(buffer, start + k * SIZE)
        sums[pixel, 0] += r
        sums[pixel, 1] += g
        sums[pixel, 2] += b
        samples[pixel] = min(np.int64(samples[pixel]) + many, most)
    return True
