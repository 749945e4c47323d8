"""The array of real processes: launch, drive, end.

    with Array.launch((2, 2, 2)) as array:
        array.driver.load(space, surfaces)
        array.driver.trace(frame)
        sums, samples = array.driver.collect(frame.width * frame.height)

`begin` starts the nursery and returns at once, so that a scene can be read meanwhile; `launch` waits. What takes half a
second to import, because it brings in numba, is imported only then: the nursery does the same at the same time.
"""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any

import zmq

from raygrid.node.errors import ArrayError, LostProcess, RaygridError

from .launch import Ended, Nursery, Warming
from .limits import check_fits
from .places import Index, Place, endpoint, host_endpoint, process_state

if TYPE_CHECKING:
    from raygrid.node.pair import Pair

    from .driver import Driver

BATCH = 4096  # most packets a message
EPOCH = 0
WARM_SECONDS = 300.0  # a first run compiles; nothing takes longer than this on a slow machine
END_SECONDS = 5.0


class Array:
    """An array of node processes on this computer. Use as a context manager; nothing is left behind.

    shape    processors on each axis
    batch    most packets a message, 1 or more
    patience seconds without any progress after which the array is taken to hang (`driver.PATIENCE`)
    profile  whether nodes say where their time goes (`node.profile`)
    timed    whether nodes can keep machine time (`node.timed_processor`)
    """

    def __init__(
        self,
        shape: Index,
        batch: int = BATCH,
        patience: float | None = None,
        on_warming: Callable[[int, int, str], None] | None = None,
        profile: bool = False,
        timed: bool = False,
    ) -> None:
        check_fits(shape)
        self.profile, self.timed = profile, timed
        self.shape, self.batch, self.patience = shape, batch, patience
        self._on_warming = on_warming
        self._nursery: Nursery | None = None
        self._place: Place | None = None
        self._context: zmq.Context[Any] | None = None
        self._pairs: dict[int, Pair] = {}
        self._poller = zmq.Poller()
        self._driver: Driver | None = None
        self._closing = False
        self._lost: LostProcess | None = None
        self.pids: list[int] = []

    @classmethod
    def launch(cls, shape: Index, **options: Any) -> Array:
        """A ready array. Options as for the class. Raises TooLarge, ArrayError."""
        array = cls(shape, **options)
        try:
            array.begin()
            array.wait_ready()
        except BaseException:
            array.close()
            raise
        return array

    @property
    def driver(self) -> Driver:
        """What loads, traces and collects. Raises ArrayError if the array is not ready."""
        if self._driver is None:
            raise ArrayError("the array is not ready: it was not launched, or it was closed")
        return self._driver

    def begin(self) -> None:
        """Start the nursery, which warms up while the caller does other things."""
        self._place = Place.create(self.shape)
        warm = "raygrid.emulator.warm:warm_timed" if self.timed else "raygrid.emulator.warm:warm"
        self._nursery = Nursery.start(warm=warm, on_warming=self._on_warming, directory=self._place.path)

    def wait_warm(self) -> None:
        """Wait until the nursery has every kernel, and all that it compiled is in the cache on disk."""
        if self._nursery is None:
            raise ArrayError("the array has not begun")
        self._nursery.wait_warm(WARM_SECONDS)

    def wait_ready(self) -> None:
        """Fork the nodes once the nursery is warm, and wait until every link is up."""
        if self._nursery is None or self._place is None:
            raise ArrayError("the array has not begun")
        from raygrid.node.flood import corners
        from raygrid.node.pair import Pair

        from .driver import PATIENCE, Driver
        from .topology import host_links

        self.wait_warm()
        machine = secrets.token_hex(8)
        self.pids = self._nursery.launch(self._configs(machine))
        self._context = zmq.Context(io_threads=1)
        for corner, index in corners(self.shape).items():
            pair = Pair(self._context, host_endpoint(self._place.path, EPOCH, index), bind=True)
            self._pairs[corner] = pair
            self._poller.register(pair.socket, zmq.POLLIN)
        self._poller.register(self._nursery.fileno(), zmq.POLLIN)
        links = host_links(self.shape, self._pairs, machine, EPOCH)
        patience = PATIENCE if self.patience is None else self.patience
        self._driver = Driver(self.shape, links, self._pump, patience, self._why_silent)
        self._driver.ready()

    def _configs(self, machine: str) -> list[dict[str, Any]]:
        """What each node is told: itself, its ports and their endpoints, and nothing of any other node."""
        from raygrid.node.flood import corners
        from raygrid.node.walk import HOST

        from .topology import indices, neighbour_links

        assert self._place is not None
        place = self._place.path
        links: dict[Index, list[dict[str, Any]]] = {index: [] for index in indices(self.shape)}
        for wire in neighbour_links(self.shape):
            name = endpoint(place, EPOCH, wire.lower, wire.axis)
            links[wire.lower].append({"port": wire.lower_port, "endpoint": name, "bind": True})
            links[wire.upper].append({"port": wire.upper_port, "endpoint": name, "bind": False})
        for index in corners(self.shape).values():
            links[index].append({"port": HOST, "endpoint": host_endpoint(place, EPOCH, index), "bind": False})
        return [
            {
                "index": list(index),
                "shape": list(self.shape),
                "epoch": EPOCH,
                "machine": machine,
                "batch": self.batch,
                "profile": self.profile,
                "timed": self.timed,
                "links": links[index],
            }
            for index in indices(self.shape)
        ]

    def _pump(self, seconds: float) -> None:
        """Wait for messages of corners and events of processes, and take them in."""
        if self._lost is not None:
            raise self._lost
        corner_of = {pair.socket: corner for corner, pair in self._pairs.items()}
        for ready, _ in self._poller.poll(int(seconds * 1000)):
            if ready in corner_of:
                self.driver.receive(corner_of[ready])
            else:
                self._take_events()
        for link in self.driver.links.values():
            if link.choked:
                link.push()

    def _why_silent(self) -> str:
        """Which nodes do not run, and why: "node 1,0,0 (pid 17) is stopped"."""
        from .topology import indices

        states = {"T": "stopped", "t": "stopped by a debugger", "Z": "dead", "D": "waiting for the kernel"}
        found = []
        for pid, index in zip(self.pids, indices(self.shape), strict=True):
            state = states.get(process_state(pid))
            if state is not None:
                found.append(f"node {','.join(map(str, index))} (pid {pid}) is {state}")
        return "; ".join(found[:8])

    def _take_events(self) -> None:
        assert self._nursery is not None
        for event in self._nursery.read_events():
            if isinstance(event, Ended) and not (self._closing and event.code == 0):
                place = ",".join(map(str, event.index))
                self._lost = LostProcess(f"node {place} (pid {event.pid}) ended: {event.why}")
                raise self._lost
            if isinstance(event, Warming) and self._on_warming is not None:
                self._on_warming(event.done, event.total, event.what)

    def close(self) -> None:
        """End all processes, close all sockets, remove all files. May be called twice, and at any time."""
        self._closing = True
        try:
            if self._driver is not None and self._lost is None:  # an array with a hole cannot say goodbye
                with contextlib.suppress(RaygridError):
                    self._driver.patience = min(self._driver.patience, END_SECONDS)
                    self._driver.end()
        finally:
            self._driver = None
            for pair in self._pairs.values():
                pair.close()
            self._pairs = {}
            if self._context is not None:
                self._context.destroy(linger=0)
                self._context = None
            if self._nursery is not None:
                self._nursery.end(END_SECONDS)
                self._nursery = None
            if self._place is not None:
                self._place.remove()
                self._place = None

    def __enter__(self) -> Array:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._driver = None  # nothing more is asked of an array that failed
        self.close()
