"""What the host makes of pixel packets: against a slow definition, all or nothing, and memory touched before."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.packets import pixel_bytes, ray_bytes, return_bytes, shadow_bytes

from raygrid.emulator.driver import collector
from raygrid.emulator.driver.collector import Collected
from raygrid.node.errors import PacketError
from raygrid.node.protocol.decoding import decode
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import MAX_PIXEL_SAMPLES, MAX_PIXEL_SUM, PRIMARY

PIXELS = 7
sums = st.one_of(st.integers(0, 3), st.sampled_from([2**32 - 1, 2**32, MAX_PIXEL_SUM - 1, MAX_PIXEL_SUM]))
samples = st.one_of(st.integers(0, 3), st.sampled_from([255, 256, 40_000, MAX_PIXEL_SAMPLES]))
pixel_packets = st.builds(pixel_bytes, st.integers(0, PIXELS - 1), st.tuples(sums, sums, sums), samples)
BAD = {
    "another kind": ray_bytes(PRIMARY, 1, 0, (0, 0, 0), (5, 5), 0),
    "a shadow": shadow_bytes(1, 0, (0, 0, 0), 0, (0.0, 0.0, 0.0)),
    "a return": return_bytes(1, 0, (0.0, 0.0, 0.0), (0, 0, 0)),
    "no kind": bytes(25),
    "a pixel with a depth": bytes([6 | 1 << 3]) + bytes(24),
    "the first pixel beyond": pixel_bytes(PIXELS, (1, 1, 1), 1),
    "the last pixel of all": pixel_bytes(2**32 - 1, (1, 1, 1), 1),
}


def taken(into: Collected, messages: list[list[bytes]]) -> Collected:
    """After taking in these packets of messages."""
    for message in messages:
        into.take(bytes(HEAD) + b"".join(message), len(message))
    return into


def slowly(messages: list[list[bytes]], top: int) -> tuple[list[list[int]], list[int]]:
    """Sums and samples by the packets' definition."""
    found, many = [[0, 0, 0] for _ in range(PIXELS)], [0] * PIXELS
    for data in (data for message in messages for data in message):
        packet = decode(data)
        assert packet.samples is not None
        for k in range(3):
            found[packet.number][k] += int(packet.values[k])
        many[packet.number] = min(many[packet.number] + packet.samples, top)
    return found, many


@steady(150)
@given(st.lists(st.lists(pixel_packets, min_size=1, max_size=12), max_size=4), st.sampled_from([1, 65_534, 65_535]))
def test_what_is_taken_in_is_what_the_packets_say(messages, most):
    """Pixels in any order, many times in one message and in many."""
    into = taken(Collected(PIXELS, most), messages)
    top = 65_535 if most < 65_535 else 2**63 - 1
    assert (into.sums.tolist(), into.samples.tolist()) == slowly(messages, top)
    assert into.received == sum(map(len, messages))


@pytest.mark.parametrize("most", [1, 65_535])
@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
@pytest.mark.parametrize("place", [0, 2, 4])
def test_of_a_message_with_a_bad_packet_nothing_is_taken_in(bad, place, most):
    good = [pixel_bytes(k, (k, 2 * k, 3 * k), 1) for k in range(4)]
    into = taken(Collected(PIXELS, most), [good])
    before = into.sums.tolist(), into.samples.tolist(), into.received
    with pytest.raises(PacketError, match=r"^5 pixel packets came with another kind, or a pixel beyond 7$"):
        taken(into, [[*good[:place], bad, *good[place:]]])
    assert (into.sums.tolist(), into.samples.tolist(), into.received) == before


def test_more_samples_than_a_pixel_has_are_seen_however_many_come():
    """Counts of two bytes do not begin at 0 again."""
    most = 65_534
    into = taken(Collected(1, most), [[pixel_bytes(0, (0, 0, 0), 40_000)] * 2])
    assert int(into.samples[0]) > most
    into = taken(Collected(1, 65_535), [[pixel_bytes(0, (0, 0, 0), 40_000)] * 2])
    assert int(into.samples[0]) == 80_000


def test_memory_is_small_and_touching_it_changes_nothing():
    into = Collected(PIXELS)
    assert into.sums.nbytes + into.samples.nbytes == 26 * PIXELS
    into.touch()
    into.touch()
    taken(into, [[pixel_bytes(3, (1, 2, 3), 1)]])
    into = taken(Collected(PIXELS), [[pixel_bytes(3, (1, 2, 3), 1)]])
    into.touch()
    assert into.sums[3].tolist() == [1, 2, 3]
    assert into.samples.sum() == 1


def test_all_of_the_memory_is_touched_in_the_end(monkeypatch):
    monkeypatch.setattr(collector, "PIECE", 3)
    into = Collected(PIXELS)
    into.sums[:] = 9  # what no one does, but it shows
    for left in (4, 1, 0, 0):
        into.touch()
        assert np.count_nonzero(into.sums[:, 0]) == left
