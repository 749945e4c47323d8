"""What goes wrong in an array: hangs are named, bad input is refused and told, and the next frame is right again."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import pytest
from support.array import (
    Sums,
    haphazard,
    hurry,
    in_flight,
    launched,
    link_at,
    links_of,
    load,
    packets_alive,
    render,
    same,
    trace,
)
from support.frames import perspective
from support.links import Meddler, renumbered
from support.scenes import Scene, mixed_scene, space_of
from support.space import EVEN_STEP

from raygrid.emulator.driver import dealing
from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.node.errors import ArrayError, ProtocolError, Stuck
from raygrid.node.geometry.grid_walk import HOST
from raygrid.node.protocol.messages import HEAD, HEADER, MessageKind
from raygrid.node.protocol.packets import FAULTS, SIZE
from raygrid.node.runtime.reduction import SUMS
from raygrid.node.tracing.batch import BATCH_IDLE

SIZE_OF_PICTURE = (24, 18)
NAME = "2x2x2"


@cache
def scene() -> Scene:
    """All kinds of surfaces, materials and lights."""
    camera = perspective([0.15, 0.2, 1.25], [-0.1, -0.15, -1], 30, SIZE_OF_PICTURE)
    return mixed_scene(1, EVEN_STEP, 20, size=SIZE_OF_PICTURE, depth=4, camera=camera)


@cache
def truth() -> Sums:
    """Its picture."""
    return render(launched("1x1x1"), "1x1x1", scene())


def hasty(patience: float = 0.2, **options) -> MemoryArray:
    """An array with little patience, whose busy nodes answer waves."""
    array = launched(NAME, **options)
    hurry(array)
    array.driver.patience = patience
    return array


def pump(array: MemoryArray, rounds: int) -> None:
    """Let the nodes go on for so many rounds."""
    for _ in range(rounds):
        array._pump(0.0)


def busiest(array: MemoryArray) -> tuple[tuple[int, int, int], int]:
    """A port by which many packets go: (node, port)."""
    counts = {
        (processor.index, port): int(processor.node_state.counts[14 + port])
        for processor in array.processors
        for port in processor.links
        if port != HOST
    }
    return max(counts, key=counts.__getitem__)


def test_the_busiest_port_is_one_that_sends():
    array = launched(NAME)
    render(array, NAME, scene())
    index, port = busiest(array)
    (processor,) = [p for p in array.processors if p.index == index]
    assert processor.record()["sent"][port] > 50


@cache
def where() -> tuple[tuple[int, int, int], int]:
    """The port that these tests meddle with."""
    array = launched(NAME)
    render(array, NAME, scene())
    return busiest(array)


def still_right(array: MemoryArray) -> None:
    """The same array goes on to give the right picture, twice, with nothing of before in it."""
    for link in links_of(array):
        while isinstance(link.channel, Meddler):
            link.channel = link.channel.inner
    array.driver.patience = 20.0
    assert same(render(array, NAME, scene()), truth())
    assert in_flight(array) == 0
    assert len(packets_alive(array)) == 0
    assert same(trace(array, scene()), truth())


# --- hangs ---------------------------------------------------------------------------------------


def without_last_packet(raw: bytes) -> list[bytes]:
    """A message of packets that says, rightly, that it holds one less."""
    (*_, count, _) = HEADER.unpack_from(raw)
    return [renumbered(raw[:-SIZE], count=count - 1)] if count > 1 else [raw]


def test_a_lost_packet_is_a_hang_with_no_node_to_blame():
    array = hasty()
    load(array, NAME, scene())
    link = link_at(array, *where())
    link.channel = Meddler(link.channel, MessageKind.PACKETS, 1, without_last_packet)
    with pytest.raises(Stuck, match=r"^no counter moved for 0\.2 seconds with 1 packets in flight .*no node"):
        array.driver.trace(scene().frame)
    still_right(array)


def test_a_node_that_stops_working_is_named():
    array = hasty()
    load(array, NAME, scene())
    (lame,) = [processor for processor in array.processors if processor.index == where()[0]]
    lame.node_state.work = lambda wait: BATCH_IDLE
    index = ",".join(map(str, lame.index))
    with pytest.raises(Stuck, match=rf"no counter moved for 0\.2 seconds .*; (.*; )?{index} holds \d+"):
        array.driver.trace(scene().frame)
    del lame.node_state.work
    still_right(array)


def test_a_node_that_does_not_answer_is_a_hang():
    asleep: list[int] = []
    array = MemoryArray((2, 2, 2), order=lambda n: [node for node in range(n) if node not in asleep])
    array.driver.ready()
    load(array, NAME, scene())
    asleep.append(5)
    array.driver.patience = 0.2
    with pytest.raises(Stuck, match=r"^nothing came from the array for 0\.2 seconds .* the order 'frame'"):
        array.driver.trace(scene().frame)
    asleep.clear()
    still_right(array)


def test_who_can_say_more_of_a_silent_array_is_asked():
    array = MemoryArray((1, 1, 1), order=lambda n: [])
    array.driver.patience = 0.05
    array.driver._why_silent = lambda: "node 0,0,0 (pid 7) is stopped"
    with pytest.raises(Stuck, match=r"the order 'ready' came back; node 0,0,0 \(pid 7\) is stopped$"):
        array.driver.ready()


def test_surfaces_that_are_lost_are_a_hang():
    array = launched(NAME)
    array.driver.patience = 0.2
    link = array.driver.links[0]
    link.channel = Meddler(link.channel, MessageKind.SURFACES, 1, lambda raw: [renumbered(raw, epoch=9)])
    with pytest.raises((Stuck, ProtocolError)):
        load(array, NAME, scene())


@pytest.mark.parametrize("at", ["sorted", "sent"])
def test_a_load_is_given_up_between_messages_and_leaves_a_usable_array(at, monkeypatch):
    """Nobody waits for a corner then: the scene is small, or its messages are not even made."""
    monkeypatch.setattr(dealing, "CHUNK_BYTES", 1)  # a surface a message
    array = hasty()
    pump, links = array.driver._pump, array.driver.links.values()
    before = sum(link.data_sent for link in links)

    def given_up(seconds: float) -> None:
        sent = sum(link.data_sent for link in links) - before
        if array.driver._answered and sent == (0 if at == "sorted" else 2):
            raise KeyboardInterrupt
        pump(seconds)

    array.driver._pump = given_up
    with pytest.raises(KeyboardInterrupt):
        load(array, NAME, scene())
    assert sum(link.data_sent for link in links) - before == (0 if at == "sorted" else 2)
    array.driver._pump = pump
    still_right(array)


def test_an_exception_of_the_watcher_leaves_a_usable_array():
    array = hasty(order=haphazard(3))
    load(array, NAME, scene())

    def watch(now) -> None:
        if now.in_flight > 0:
            raise KeyboardInterrupt

    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            array.driver.trace(scene().frame, budget=60, progress=watch)
        assert in_flight(array) > 0
    assert same(trace(array, scene()), truth())
    still_right(array)


def test_an_interrupt_in_the_midst_of_a_wave_leaves_a_usable_array():
    array = hasty(batch=8)
    load(array, NAME, scene())
    turns = 0

    def order(n: int):
        nonlocal turns
        turns += 1
        if turns in (5, 11, 20):
            raise KeyboardInterrupt
        return range(n)

    array._order = order
    with pytest.raises(KeyboardInterrupt):
        trace(array, scene())
    with pytest.raises(KeyboardInterrupt):
        load(array, NAME, scene())
    with pytest.raises(KeyboardInterrupt):
        render(array, NAME, scene())
    assert same(render(array, NAME, scene()), truth())


def test_a_collection_that_was_broken_off_leaves_a_usable_array():
    array = launched(NAME, batch=1)
    load(array, NAME, scene())
    array.driver.trace(scene().frame)
    pump, left = array.driver._pump, [2]

    def broken_pump(seconds: float) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        pump(seconds)

    array.driver._pump = broken_pump
    with pytest.raises(KeyboardInterrupt):
        array.driver.collect(24 * 18)
    array.driver._pump = pump
    assert same(trace(array, scene()), truth())


# --- what is refused -----------------------------------------------------------------------------


def spoilt(at: int, value: int):
    """Change one byte of the first packet of a message."""

    def spoil(raw: bytes) -> list[bytes]:
        data = bytearray(raw)
        data[HEAD + at] = value
        return [bytes(data)]

    return spoil


@pytest.mark.parametrize(
    ("at", "value", "fault"),
    [(0, 0x0F, 1), (0, 0x08, 1), (0, 0x01, 2), (0, 0xF9, 2), (4, 0xFF, 3)],
)
@pytest.mark.parametrize("busy", [False, True])
def test_a_bad_packet_is_refused_and_reported(at, value, fault, busy):
    array = launched(NAME, batch=16)
    if busy:
        hurry(array)
    load(array, NAME, scene())
    index, port = where()
    link = link_at(array, index, port)
    link.channel = Meddler(link.channel, MessageKind.PACKETS, 2, spoilt(at, value))
    there = list(index)
    there[port >> 1] += 1 if port & 1 else -1
    name = "{},{},{} port {}{}".format(*there, "-+"[1 - (port & 1)], "xyz"[port >> 1])
    said = rf"^1 times a node refused what came: link {name}: packet 0 of a message: {FAULTS[fault]}"
    with pytest.raises(ArrayError, match=said.replace("+", r"\+")):
        trace(array, scene())
    still_right(array)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda raw: [raw[:-1]], "packets came in"),
        (lambda raw: [raw + b"\x00"], "packets came in"),
        (lambda raw: [renumbered(raw, count=0)], "^1 times a node refused what came: link .*: 0 packets came in"),
        (lambda raw: [renumbered(raw, count=2**32 - 1)], "4294967295 packets came in"),
    ],
)
def test_packets_that_are_not_as_many_as_said_are_refused(damage, said):
    array = launched(NAME, batch=16)
    load(array, NAME, scene())
    link = link_at(array, *where())
    link.channel = Meddler(link.channel, MessageKind.PACKETS, 3, damage)
    with pytest.raises(ArrayError, match=said):
        trace(array, scene())
    still_right(array)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda raw: [raw[:-1]], "wanted"),
        (lambda raw: [raw[:HEAD] + b"\x09" + raw[HEAD + 1 :]], "surfaces came with corner 9"),
        (lambda raw: [raw[:-8] + b"\xff" * 8], "numbers beyond the world box"),
    ],
)
@pytest.mark.parametrize("port", [-1, 1])
def test_bad_surfaces_are_refused_and_reported(damage, said, port):
    array = launched(NAME)
    link = array.driver.links[0] if port < 0 else link_at(array, (0, 0, 0), port)
    link.channel = Meddler(link.channel, MessageKind.SURFACES, 1, damage)
    with pytest.raises(ArrayError, match=r"^1 times a node refused what came: link [01],0,0 port .*" + said):
        load(array, NAME, scene())
    still_right(array)


def test_a_surface_of_a_material_that_there_is_not_is_refused():
    array = launched(NAME)
    load(array, NAME, scene())
    few = scene().frame._replace(materials=scene().frame.materials[:2])
    with pytest.raises(ArrayError, match=r"refused what came: node .*: a frame came with 2 materials, a surf"):
        array.driver.trace(few)
    still_right(array)


@pytest.mark.parametrize("order", [{"do": "dance"}, {"do": None}, {}, {"do": ["end"]}])
def test_an_order_that_nobody_knows_is_refused(order):
    array = launched(NAME)
    with pytest.raises(ArrayError, match=r"8 times a node refused what came: node .*: an order came as"):
        array.driver.wave({"do": None, **order})
    still_right(array)


@pytest.mark.parametrize("do", ["build", "frame", "trace", "collect"])
def test_an_order_before_its_time_is_refused(do):
    array = launched(NAME)
    with pytest.raises(ArrayError, match=f"the order '{do}' came before a"):
        array.driver.wave({"do": do, "quota": 5})
    assert not any(processor.busy for processor in array.processors)
    still_right(array)


@pytest.mark.parametrize("quota", [None, -1, 2**32, 1.5, "x", True])
def test_a_wrong_quota_is_refused(quota):
    array = launched("1x1x1")
    load(array, "1x1x1", scene())
    array.driver.trace(scene().frame)
    with pytest.raises(ArrayError, match="a quota came as"):
        array.driver.wave({"do": "trace", "quota": quota})


@pytest.mark.parametrize(
    "tuning",
    [{"batch_threshold": None}, {"batch_threshold": 1.5}, {"back_off": 2.0}, {"back_off": "x"}, {"flush": None}],
)
def test_wrong_tuning_is_refused(tuning):
    array = launched("1x1x1")
    load(array, "1x1x1", scene())
    array.driver.trace(scene().frame)
    with pytest.raises(ArrayError, match="batch_threshold, back_off and flush came as"):
        array.driver.wave({"do": "trace", "quota": 0, **tuning})


@pytest.mark.parametrize(
    ("kind", "said"),
    [(MessageKind.UP, "UP came on a port"), (MessageKind.DOWN, "DOWN came on a port")],
)
def test_a_wave_from_where_none_can_come_breaks_the_link(kind, said):
    array = launched(NAME)
    wrong = {MessageKind.UP: (0, 0, 0), MessageKind.DOWN: (1, 0, 0)}[kind]
    link_at(array, wrong, 1 if wrong == (0, 0, 0) else 0).send_order(kind, {"do": "ready"})
    with pytest.raises(ProtocolError, match=rf"link \d,0,0 port [-+]x: {said} where it cannot come from"):
        pump(array, 3)


def test_a_wave_before_the_last_was_answered_breaks_the_link():
    array = MemoryArray((2, 1, 1), order=lambda n: [0])  # the other node never answers
    for number in range(2):
        array.driver.links[0].send_order(MessageKind.DOWN, {"do": "ready", "wave": number})
    with pytest.raises(ProtocolError, match="a wave came before the last one was answered"):
        pump(array, 3)


@pytest.mark.parametrize(
    "answer",
    [
        {},
        {"sums": None, "nodes": [], "refusals": []},
        {"sums": b"12", "nodes": [], "refusals": []},
        {"sums": [1] * SUMS, "nodes": [], "refusals": []},
    ],
)
def test_an_answer_that_is_none_breaks_the_link(answer):
    array = launched("2x1x1")
    child = array.processors[1]
    child._own_reply = lambda with_record: SimpleNamespace(as_map=lambda wave: {**answer, "wave": wave})
    with pytest.raises(ProtocolError, match=r"a reply came without its|came back as another one"):
        array.driver.wave({"do": "ready"})


def test_packets_for_a_host_that_collects_nothing_are_refused():
    array = launched("1x1x1")
    array.processors[0].links[HOST].send_data(MessageKind.PACKETS, 1, bytes(SIZE))
    with pytest.raises(ProtocolError, match="1 pixel packets came, but no frame is being collected"):
        array.driver.wave({"do": "ready"})


def test_spaces_of_another_shape_are_refused():
    array = launched(NAME)
    with pytest.raises(ArrayError, match=r"8 times .* a space came with .* wanted 3 planes"):
        array.driver.load(space_of("3x3x3", EVEN_STEP), scene().surfaces)
    still_right(array)


def test_the_end_closes_every_link():
    array = launched(NAME)
    render(array, NAME, scene())
    array.driver.end()
    assert all(processor.ended for processor in array.processors)
    pump(array, 5)
    assert {link.state.value for link in links_of(array)} == {"closed"}
