"""Packets of a message are checked and sorted in runs as they would be one by one."""

from hypothesis import given, settings
from hypothesis import strategies as st
from support.packets import pixel_bytes, ray_bytes, return_bytes, rows, shadow_bytes

from raygrid.node.protocol import packets
from raygrid.node.protocol.messages import HEAD
from raygrid.node.protocol.packets import SIZE, PacketLimits
from raygrid.node.tracing.work_queues import CLASSES, IN_TRANSIT, MOST, RAYS, SHADOWS, WorkQueues

LIMITS = PacketLimits(samples=400, pixels=100, lights=2, depth=5, shape=(4, 3, 2))
PORT = 3
EACH = [
    ray_bytes(packets.PRIMARY, 1, 7, (1, 2, 3), (4, 5), 6),
    ray_bytes(packets.REFLECTED, 5, 399, (1, 2, 3), (2 * packets.HALF_DIRECTION, 0), 6),
    ray_bytes(packets.REFRACTED, 2, 1, (9, 8, 7), (0, 1), 2),
    shadow_bytes(1, 2, (1, 2, 3), 1, (1.0, 2.0, 3.0)),
    return_bytes(5, 3, (1.0, 0.0, 3.0), (3, 2, 1)),
    pixel_bytes(99, (1, 2, 3), 4),
]


@st.composite
def messages(draw):
    """Runs of packets of a kind; a few bytes of a few of them are other ones."""
    runs = draw(st.lists(st.tuples(st.sampled_from(EACH), st.integers(1, 70)), max_size=6))
    data = bytearray(b"".join(packet * many for packet, many in runs))
    changed = draw(st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), max_size=3))
    for at, value in changed if data else []:
        data[at % len(data)] = value
    return bytes(data)


def _one_by_one(data, stacks):
    """(number, fault) of the first bad packet, or (-1, 0); those before it are put on the stacks."""
    for k in range(len(data) // SIZE):
        packet = data[k * SIZE : (k + 1) * SIZE]
        bad = packets.fault(rows(packet), 0, LIMITS)
        if bad:
            return k, bad
        kind = packet[0] & 7
        which = SHADOWS if kind == packets.SHADOW else (IN_TRANSIT if kind > packets.SHADOW else RAYS)
        stacks[which] += packet
    return -1, 0


@given(messages(), messages())
@settings(deadline=None)
def test_messages_are_sorted(first, second):
    work_queues, stacks = WorkQueues(), [b""] * CLASSES
    work_queues.set_limits(LIMITS)
    most = 0
    for data in (first, second):
        found = work_queues.sort_in(bytes(HEAD) + data, len(data) // SIZE, PORT)
        assert found == _one_by_one(data, stacks)
        if found == (-1, 0):
            most = max(most, sum(map(len, stacks)) // SIZE)
        for kind in range(CLASSES):
            assert work_queues.packets(kind).tobytes() == stacks[kind]
            assert (work_queues.stacks[CLASSES + kind][: len(stacks[kind]) // SIZE] == PORT).all()
    assert work_queues.count[MOST] == most


@given(st.sampled_from(EACH), st.lists(st.tuples(st.integers(0, SIZE - 1), st.integers(0, 255)), max_size=3))
@settings(deadline=None, max_examples=500)
def test_what_is_sound_has_no_fault(packet, changed):
    """And what has a fault is not sound, by the check of any kind."""
    data = bytearray(packet)
    for at, value in changed:
        data[at] = value
    buffer = rows(bytes(data))
    bad, kind = packets._named_fault(buffer, 0, LIMITS), data[0] & 7
    assert packets.fault(buffer, 0, LIMITS) == bad
    assert packets.is_sound_shadow(buffer, 0, LIMITS) == (bad == 0 and kind == packets.SHADOW)
    assert packets.is_sound_ray(buffer, 0, LIMITS) == (bad == 0 and kind <= packets.REFRACTED)
    assert packets.is_sound_return(buffer, 0, LIMITS) == (bad == 0 and kind == packets.RETURN)
