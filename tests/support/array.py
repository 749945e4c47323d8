"""The array in memory under a magnifying glass: any order of turns, waves at any time, every packet found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.driver.memory_array import MemoryArray
from raygrid.node.geometry.surfaces import merge
from raygrid.node.links.link import Channel, Link
from raygrid.node.links.memory_channel import MemoryChannel
from raygrid.node.protocol.counters import BORN, DIED
from raygrid.node.protocol.messages import HEAD, MessageKind
from raygrid.node.protocol.packets import KINDS, SIZE
from raygrid.node.tracing.work_queues import CLASSES
from support.links import Passing
from support.scenes import Scene, space_of

Shape = tuple[int, int, int]
Sums = tuple[NDArray[np.int64], NDArray[np.int64]]
Order = Callable[[int], Iterable[int]]


def shape_of(name: str) -> Shape:
    """Cells on each axis of a name of `support.scenes.SHAPES`."""
    x, y, z = name.split()[-1].split("x")
    return int(x), int(y), int(z)


def launched(name: str, **options: Any) -> MemoryArray:
    """An array of that shape with all links up."""
    array = MemoryArray(shape_of(name), **options)
    array.driver.patience = 5.0
    array.driver.ready()
    return array


def load(array: MemoryArray, name: str, scene: Scene) -> None:
    """Load a scene."""
    array.driver.load(space_of(name, scene.step), scene.surfaces)


def trace(array: MemoryArray, scene: Scene, **options: Any) -> Sums:
    """Trace and collect."""
    array.driver.trace(scene.frame, **options)
    return array.driver.collect(scene.frame.width * scene.frame.height)


def render(array: MemoryArray, name: str, scene: Scene, **options: Any) -> Sums:
    """Load, trace and collect."""
    load(array, name, scene)
    return trace(array, scene, **options)


def same(one: Sums, other: Sums) -> bool:
    """Whether two results are the same bits."""
    return np.array_equal(one[0], other[0]) and np.array_equal(one[1], other[1])


# --- orders of turns -----------------------------------------------------------------------------


def forwards(n: int) -> Iterable[int]:
    """Every node once, in order."""
    return range(n)


def backwards(n: int) -> Iterable[int]:
    """Every node once, the last one first."""
    return range(n - 1, -1, -1)


def shuffled(seed: int) -> Order:
    """Every node once, in another order each round."""
    rng = np.random.default_rng(seed)
    return lambda n: rng.permutation(n)


def haphazard(seed: int) -> Order:
    """Any nodes, some of them several times, some not at all."""
    rng = np.random.default_rng(seed)
    return lambda n: rng.integers(0, n, int(rng.integers(1, 2 * n + 1)))


def lazy(seed: int) -> Order:
    """For long stretches some nodes get no turn at all."""
    rng = np.random.default_rng(seed)
    asleep: dict[str, Any] = {"rounds": 0, "nodes": np.zeros(0, np.bool_)}

    def order(n: int) -> Iterable[int]:
        if asleep["rounds"] == 0:
            asleep["rounds"], asleep["nodes"] = int(rng.integers(1, 30)), rng.random(n) < 0.4
        asleep["rounds"] -= 1
        return [int(node) for node in rng.permutation(n) if not asleep["nodes"][node]]

    return order


ORDERS: dict[str, Callable[[], Order]] = {
    "forwards": lambda: forwards,
    "backwards": lambda: backwards,
    "shuffled": lambda: shuffled(1),
    "haphazard": lambda: haphazard(2),
    "lazy": lambda: lazy(3),
}


def watch(array: MemoryArray, look: Callable[[], None]) -> None:
    """Call `look` after every turn of a node from now on."""
    order = array._order

    def watched(n: int) -> Iterator[int]:
        for node in order(n):
            yield int(node)
            look()

    array._order = watched


def hurry(array: MemoryArray, seed: int = 0, share: float = 0.7) -> None:
    """Let waves be answered by busy nodes too: whenever a node looks at its clock a second may have gone by."""
    rng = np.random.default_rng(seed)
    now = 0.0

    def clock() -> float:
        nonlocal now
        now += float(rng.random() < share)
        return now

    for processor in array.processors:
        processor.clock = clock


# --- looking -------------------------------------------------------------------------------------


def links_of(array: MemoryArray) -> list[Link]:
    """All ends of all links, the host's too."""
    ends = [link for processor in array.processors for link in processor.links.values()]
    return [*ends, *array.driver.links.values()]


def link_at(array: MemoryArray, index: Shape, port: int) -> Link:
    """The end of a link at a node."""
    (found,) = [processor for processor in array.processors if processor.index == index]
    return found.links[port]


def _queued(channel: Channel) -> list[bytes]:
    while isinstance(channel, Passing):
        channel = channel.inner
    assert isinstance(channel, MemoryChannel)
    return list(channel._outgoing)


def packets_alive(array: MemoryArray) -> NDArray[np.uint8]:
    """Every packet that is anywhere in the array or under way, uint8 (n, 25)."""
    found = []
    for processor in array.processors:
        node_state = processor.node_state
        found += [node_state.work_queues.packets(kind) for kind in range(CLASSES)]
        found += [row[HEAD : HEAD + held * SIZE] for row, held in zip(*node_state.outputs[:2], strict=True) if held]
    for link in links_of(array):
        found += [np.frombuffer(payload, np.uint8) for kind, _, payload in link.queued if kind == MessageKind.PACKETS]
        found += [np.frombuffer(raw, np.uint8)[HEAD:] for raw in _queued(link.channel) if raw[0] == MessageKind.PACKETS]
    return np.concatenate([np.zeros(0, np.uint8), *found]).reshape(-1, SIZE)


def trees_alive(array: MemoryArray) -> int:
    """Primary rays that are alive or have a descendant that is, while tracing."""
    packets = packets_alive(array)
    numbers = packets[:, 1:5].astype(np.int64) @ (1 << np.array([0, 8, 16, 24]))
    return len(np.unique(numbers))


def counted(array: MemoryArray) -> NDArray[np.int64]:
    """(born, died) by kind, over all nodes at this moment."""
    counts = sum(processor.node_state.counts for processor in array.processors)
    assert isinstance(counts, np.ndarray)
    return np.stack((counts[BORN : BORN + KINDS], counts[DIED : DIED + KINDS]))


def in_flight(array: MemoryArray) -> int:
    """Packets born and not yet dead, over all nodes at this moment."""
    born, died = counted(array).sum(axis=1)
    return int(born - died)


def retained_ids(array: MemoryArray) -> list[set[int]]:
    """The surfaces that each node retains."""
    return [
        {int(number) for batch in merge(processor.node_state.retained) for number in batch.ids}
        for processor in array.processors
    ]
