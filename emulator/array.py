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
import os
import select
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any

from raygrid.node.errors import ArrayError, LostProcess, ProtocolError, RaygridError, Stuck

from .launch import Ended, Nursery
from .limits import check_fits
from .places import LAST_EPOCH, Index, Place, host_endpoint

if TYPE_CHECKING:
    import zmq

    from raygrid.node.faulty import FaultPlan
    from raygrid.node.pair import Pair

    from .crew import Crew, NodeState
    from .driver import Driver
    from .lines import Words
    from .samples import Sample

BATCH = 4096  # most packets a message
TRIES = 3  # epochs that are begun before an array counts as one that cannot be
WARM_SECONDS = 300.0  # a first run compiles; nothing takes longer than this on a slow machine
READY_SECONDS, READY_SECONDS_A_NODE = 10.0, 0.05  # for the links to come up; longer, and somebody else took one
END_SECONDS = 5.0
FAULT_PATIENCE = 3.0  # seconds: with faults on purpose a message that never comes is the likely reason of silence
LOOK_SECONDS = 0.25  # how often the states of silent processes are looked at
LISTEN_SECONDS = 0.05  # how often lines are listened to while probes are on
STOPPED_SECONDS = (
    0.75  # a process that is stopped (SIGSTOP), or dead without a word of it, for longer than this is lost
)
FAULTS = (LostProcess, Stuck, ProtocolError)


class Array:
    """An array of node processes on this computer. Use as a context manager; nothing is left behind.

    shape     processors on each axis
    batch     most packets a message, 1 or more
    patience  seconds without any progress after which the array is taken to hang (`driver.PATIENCE`)
    epoch     number of resets so far; -1 before the array was ready
    restarts  nodes that were forked anew so far
    lost_nodes  what ended of itself since the reset before the last, until all nodes had been told of the last one:
              "node 1,0,0 (pid 17) ended: exit code 1: ..."
    refused_samples  what came as a sample of a probe and was none
    fault     what goes wrong on purpose on links between neighbours, for experiments; patience is FAULT_PATIENCE then
    programs  whether nodes take programs (`node.programs`): code of others, with your rights
    injected  messages that were hit by it so far
    profile   whether nodes say where their time goes (`node.profile`)
    timed     whether nodes can keep machine time (`node.timed_processor`)
    on_words  called as on_words(index, words) with what a node says on its line, but for its acknowledgements
    on_wait   called whenever the host waits for the array, four times a second or more; what it raises is passed on
    """

    def __init__(
        self,
        shape: Index,
        batch: int = BATCH,
        patience: float | None = None,
        on_warming: Callable[[int, int, str], None] | None = None,
        fault: FaultPlan | None = None,
        programs: bool = False,
        profile: bool = False,
        timed: bool = False,
    ) -> None:
        check_fits(shape)
        if fault is not None:
            patience = min(FAULT_PATIENCE, FAULT_PATIENCE if patience is None else patience)
        self.shape, self.batch, self.patience, self.fault = shape, batch, patience, fault
        self.programs = programs
        self.injected, self.profile, self.timed = 0, profile, timed
        self.epoch, self.restarts = -1, 0
        self.lost_nodes: list[str] = []
        self.on_words: Callable[[Index, Words], None] | None = None
        self.refused_samples = 0
        self._rate = 0.0
        self._on_sample: Callable[[Sample], object] | None = None
        self._on_warming = on_warming
        self.on_wait: Callable[[], None] | None = None
        self._nursery: Nursery | None = None
        self._crew: Crew | None = None
        self._place: Place | None = None
        self._context: zmq.Context[Any] | None = None
        self._pairs: dict[int, Pair] = {}
        self._poller: zmq.Poller | None = None  # of an epoch
        self._driver: Driver | None = None
        self._begun = self._closing = False
        self._lost: RaygridError | None = None
        self._looked = self._heard = 0.0
        self._lame_since: dict[tuple[tuple[int, ...], int], float] = {}  # (index, pid) of what does not run

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
        """What loads, traces and collects. Raises ArrayError if the array is not ready, or why it ceased to be."""
        if self._driver is None:
            raise self._lost or ArrayError("the array is not ready: it was not launched, or it was closed")
        return self._driver

    @property
    def pids(self) -> list[int]:
        """The processes of the nodes, x fastest; they change when nodes are forked anew."""
        return [] if self._crew is None else list(self._crew.pids.values())

    def nodes(self) -> list[NodeState]:
        """Every node, x fastest, with its process and that process' state ("running", "waiting", "stopped", "dead")."""
        return [] if self._crew is None else self._crew.states()

    def begin(self) -> None:
        """Start the nursery, which warms up while the caller does other things."""
        self._begun = True
        self._place = Place.create(self.shape)
        warm = "raygrid.emulator.warm:warm_timed" if self.timed else "raygrid.emulator.warm:warm"
        self._nursery = Nursery.start(warm=warm, on_warming=self._on_warming, directory=self._place.path)

    def wait_warm(self) -> None:
        """Wait until the nursery has every kernel, and all that it compiled is in the cache on disk."""
        if self._nursery is None:
            raise ArrayError("the array has not begun")
        self._nursery.wait_warm(WARM_SECONDS, self.on_wait)

    def is_warm(self) -> bool:
        """Whether nodes could be forked at once. Raises ArrayError if the nursery has failed."""
        return self._nursery is not None and self._nursery.is_warm()

    def wait_ready(self) -> None:
        """Fork the nodes once the nursery is warm, and wait until every link is up.

        Raises LostProcess, Stuck or ProtocolError if that fails several times, ArrayError if nodes cannot be forked.
        """
        import_links()
        self.wait_warm()
        assert self._nursery is not None
        import zmq

        from .crew import Crew

        self._crew = Crew(self._nursery)
        self._context = zmq.Context(io_threads=1)
        self._begin_epochs()

    def reset(self) -> None:
        """The reset line: whatever the array's state, after this it is empty, in a new epoch, and ready.

        Nodes that live drop all they hold and open new links; those that are dead, stopped or do not answer within
        a second are forked anew. If the nodes cannot be brought to work together, or the nursery is gone or stopped, the
        whole array is launched anew. Raises ArrayError and its kinds, or ProtocolError, if that fails as well.
        """
        if self._closing or not self._begun:
            raise ArrayError("the array cannot be reset: it was not launched, or it was closed")
        self.lost_nodes = []
        try:
            there = self._place is not None and self._place.keep()  # or no link could be made in it
            if there and self._crew is not None and self._nursery is not None and self._nursery.serving:
                with contextlib.suppress(*FAULTS):
                    self._begin_epochs()
                    return
            restarts = self.restarts + len(self.pids)
            self._drop()
            self.begin()
            self.wait_ready()
            self.restarts = restarts
        except RaygridError as error:
            self._lost = error
            raise

    def _begin_epochs(self) -> None:
        """Begin an epoch, and another if that goes wrong. Raises as the last one did."""
        import zmq

        for left in reversed(range(TRIES)):
            try:
                self._begin_epoch()
                return
            except FAULTS:
                if left == 0 or self._nursery is None or not self._nursery.serving:
                    raise
            except (OSError, zmq.ZMQError) as error:
                raise ArrayError(f"the links of the array cannot be opened: {error.strerror}") from error

    def _begin_epoch(self) -> None:
        """Drop the links, bring all nodes to the next epoch, and wait until all links are up."""
        import zmq

        from raygrid.node.flood import corners
        from raygrid.node.pair import Pair

        from .driver import PATIENCE, Driver
        from .topology import host_links
        from .wiring import node_configs

        assert self._crew is not None
        assert self._place is not None
        assert self._context is not None
        self._hang_up()
        self._poller = poller = zmq.Poller()
        self._lost = None
        self._lame_since.clear()
        first = not self._crew.pids
        self.epoch = (self.epoch + 1) & LAST_EPOCH  # after the last one nodes refuse the first, and are forked anew
        machine = os.urandom(8).hex()
        for corner, index in corners(self.shape).items():
            pair = Pair(self._context, host_endpoint(self._place.path, self.epoch, index), bind=True)
            self._pairs[corner] = pair
            poller.register(pair.socket, zmq.POLLIN)
        told = {"batch": self.batch, "fault": self.fault, "programs": self.programs}
        told |= {"profile": self.profile, "timed": self.timed}
        forked = self._crew.begin(node_configs(self.shape, self._place.path, self.epoch, machine, **told))
        self.restarts += 0 if first else forked
        self.lost_nodes += map(_told, self._crew.lost)
        self._crew.lost.clear()
        for descriptor in self._crew.filenos():
            poller.register(descriptor, zmq.POLLIN)
        links = host_links(self.shape, self._pairs, machine, self.epoch)
        patience = PATIENCE if self.patience is None else self.patience
        ready = READY_SECONDS + READY_SECONDS_A_NODE * len(self.pids)
        self._driver = Driver(self.shape, links, self._pump, min(patience, ready), self._why_silent)
        self._driver.ready()
        self._driver.patience = patience
        self._place.forget_epochs_before(self.epoch)
        if self._rate:  # nodes that were forked anew have not heard of it
            self._tell_rate()

    def _hang_up(self) -> None:
        """Close the host's ends of the links."""
        self._driver = None
        self._poller = None
        for pair in self._pairs.values():
            pair.close()
        self._pairs = {}

    # --- while it lives ------------------------------------------------------------------------------

    def probe(self, rate: float, watch: Callable[[Sample], object] | None) -> None:
        """Let every node tell `rate` times a second how it stands, from now on, after resets too; 0: no more.

        `watch` is called with each sample while somebody waits for the array: by the driver's calls, and by `check`.
        Samples only read: pictures, counts and machine time are the same with any rate. Raises ProtocolError for a
        rate that cannot be.
        """
        from raygrid.node.probe import read_rate

        self._rate, self._on_sample = read_rate({"rate": rate}), watch
        self._tell_rate()

    def _tell_rate(self) -> None:
        if self._crew is None or self._driver is None or self._poller is None:  # told when the array is ready
            return
        for index in self._crew.pids:
            self._crew.lines.send(index, {"do": "probe", "rate": self._rate})
        if self._rate:  # waking for each sample costs more than reading it: `_pump` listens now and then instead
            with contextlib.suppress(KeyError):
                self._poller.unregister(self._crew.lines.fileno())
        else:
            self._poller.register(self._crew.lines.fileno(), select.POLLIN)

    def check(self) -> None:
        """Look after an array that nobody waits for: take in what has come, and look at the processes.

        Raises LostProcess, naming the node, if one ended or is stopped, or the nursery is; ProtocolError if one gave up its
        links.
        """
        self._pump(0.0)
        self._look(idle=True)

    def _pump(self, seconds: float) -> None:
        """Wait for messages of corners and events of processes, and take them in."""
        if self._lost is not None:
            raise self._lost
        if self.on_wait is not None and not self._closing:
            self.on_wait()
        corner_of = {pair.socket: corner for corner, pair in self._pairs.items()}
        milliseconds = int(min(seconds, LISTEN_SECONDS if self._rate else seconds) * 1000)
        found = [] if self._poller is None else self._poller.poll(milliseconds)
        try:
            if self._rate and time.monotonic() - self._heard >= LISTEN_SECONDS:
                self._hear()
            for ready, _ in found:
                if ready in corner_of:
                    self.driver.receive(corner_of[ready])
                else:
                    self._hear()
            for link in self.driver.links.values():
                if link.choked:
                    link.push()
            if not found and seconds > 0.0:
                self._look()
        except FAULTS as error:
            self._lost = error  # and say so again, until the reset
            raise

    def _hear(self) -> None:
        """Take in the ends of processes and what nodes say on their lines."""
        assert self._crew is not None
        self._heard = time.monotonic()
        for event in self._crew.hear():
            if isinstance(event, Ended):
                if not (self._closing and event.code == 0):
                    raise LostProcess(_told(event))
            elif event.words.get("is") == "broken":
                if event.words.get("epoch") == self.epoch:
                    pid = self._crew.pids[event.index]
                    raise ProtocolError(f"node {_name(event.index)} (pid {pid}): {event.words.get('why')}")
            elif event.words.get("is") == "sample":
                self._take_sample(event.index, event.words)
            elif event.words.get("is") == "injected":
                self.injected += 1
            elif event.words.get("is") != "reset" and self.on_words is not None:
                self.on_words(event.index, event.words)

    def _take_sample(self, index: Index, words: Words) -> None:
        from .samples import read_sample

        if self._on_sample is None:
            return
        try:
            sample = read_sample(index, words)
        except ProtocolError:
            self.refused_samples += 1
            return
        self._on_sample(sample)

    def _look(self, idle: bool = False) -> None:
        """Look, now and then, for nodes that are stopped, which send nothing and do not end, and for dead ones of which the
        nursery does not tell; `idle`: for a nursery that is stopped, too, which a frame can do without. Raises LostProcess.
        """
        now = time.monotonic()
        if now - self._looked < LOOK_SECONDS:
            return
        self._looked = now
        if self._place is not None:
            self._place.keep()
        lame = {(node.index, node.pid): node for node in self.nodes() if node.state in ("stopped", "dead")}
        said: dict[tuple[tuple[int, ...], int], str] = {
            key: f"node {_name(node.index)} (pid {node.pid}) is {node.state}" for key, node in lame.items()
        }
        if idle and self._nursery is not None and self._nursery.stopped:
            said[(), self._nursery.pid] = f"the nursery (process {self._nursery.pid}) is stopped"
        self._lame_since = {key: self._lame_since.get(key, now) for key in said}
        for key, since in self._lame_since.items():
            if now - since >= STOPPED_SECONDS:
                self._lost = LostProcess(said[key])
                raise self._lost

    def _why_silent(self) -> str:
        """Which nodes do not run, and why: "node 1,0,0 (pid 17) is stopped"."""
        lame = [node for node in self.nodes() if node.state not in ("running", "waiting")]
        return "; ".join(f"node {_name(node.index)} (pid {node.pid}) is {node.state}" for node in lame[:8])

    def close(self) -> None:
        """End all processes, close all sockets, remove all files. May be called twice, and at any time."""
        self._closing = True
        try:
            if self._driver is not None and self._lost is None:  # an array with a hole cannot say goodbye
                with contextlib.suppress(RaygridError):
                    self._driver.patience = min(self._driver.patience, END_SECONDS)
                    self._driver.end()
        finally:
            self._drop()

    def _drop(self) -> None:
        """End all processes, close all sockets, remove all files, without a goodbye."""
        self._hang_up()
        if self._context is not None:
            self._context.destroy(linger=0)
            self._context = None
        crew, self._crew = self._crew, None
        nursery, self._nursery = self._nursery, None
        place, self._place = self._place, None
        try:
            if nursery is not None:
                nursery.end(END_SECONDS)
        finally:
            if crew is not None:
                crew.close()
            if place is not None:
                place.remove()

    def __enter__(self) -> Array:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._driver = None  # nothing more is asked of an array that failed
        self.close()


def _told(event: Ended) -> str:
    return f"node {_name(event.index)} (pid {event.pid}) ended: {event.why}"


def import_links() -> None:
    """Import what an array needs once its nursery is warm; it costs nothing beside the warming."""
    import zmq  # noqa: F401

    from raygrid.node import flood, pair  # noqa: F401

    from . import crew, driver, topology, wiring  # noqa: F401
    from .collected import load

    load()


def _name(index: Index) -> str:
    return ",".join(map(str, index))
