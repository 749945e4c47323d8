"""Launches, drives and ends an array of real processes.

    with Array.launch((2, 2, 2)) as array:
        array.driver.load(space, surfaces)
        array.driver.trace(frame)
        sums, samples = array.driver.collect(frame.width * frame.height)

`begin` starts the fork server and returns at once, so that a scene can be read meanwhile; `launch` waits. What takes half a
second to import, because it brings in numba, is imported only then: the fork server does the same at the same time.
"""

from __future__ import annotations

import contextlib
import os
import select
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, assert_never

from raygrid.emulator.processes.early_imports import import_links
from raygrid.emulator.processes.fork_server_client import ForkServerClient
from raygrid.emulator.processes.process_ended import ProcessEnded
from raygrid.emulator.topology.coordinates import Index, name_of
from raygrid.emulator.topology.limits import check_fits
from raygrid.emulator.topology.socket_directory import LAST_EPOCH, SocketDirectory, host_endpoint
from raygrid.node.errors import ArrayError, LostProcess, ProtocolError, RaygridError, Stuck

if TYPE_CHECKING:
    import zmq

    from raygrid.emulator.driver.driver import Driver
    from raygrid.emulator.driver.samples import NodeSample
    from raygrid.emulator.processes.control import Message
    from raygrid.emulator.processes.node_processes import NodeProcesses, ProcessState
    from raygrid.emulator.processes.process_watch import ProcessWatch
    from raygrid.node.links import FaultPlan, ZmqChannel

BATCH = 4096  # most packets a message
TRIES = 3  # epochs that are begun before an array counts as one that cannot be
WARM_SECONDS = 300.0  # a first run compiles; nothing takes longer than this on a slow machine
READY_SECONDS, READY_SECONDS_A_NODE = 10.0, 0.05  # for the links to come up; longer, and somebody else took one
END_SECONDS = 5.0
FAULT_PATIENCE = 3.0  # seconds: with faults on purpose a message that never comes is the likely reason of silence
LISTEN_SECONDS = 0.05  # how often control channels are listened to while probes are on
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
    programs  whether nodes take programs (`node.programs.programs`): code of others, with your rights
    injected  messages that were hit by it so far
    profile   whether nodes say where their time goes (`node.runtime.profile`)
    timed     whether nodes can keep machine time (`node.timed.timed_processor`)
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
        self.programs, self.profile, self.timed, self.injected = programs, profile, timed, 0
        self.epoch, self.restarts, self.refused_samples = -1, 0, 0
        self.lost_nodes: list[str] = []
        self._rate = self._listened = 0.0
        self._on_sample: Callable[[NodeSample], object] | None = None
        self._on_warming = on_warming
        self.on_wait: Callable[[], None] | None = None
        self._fork_server: ForkServerClient | None = None
        self._node_processes: NodeProcesses | None = None
        self._place: SocketDirectory | None = None
        self._context: zmq.Context[Any] | None = None
        self._pairs: dict[int, ZmqChannel] = {}
        self._poller: zmq.Poller | None = None  # of an epoch
        self._driver: Driver | None = None
        self._begun = self._closing = False
        self._lost: RaygridError | None = None
        self._watch: ProcessWatch | None = None

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
        return [] if self._node_processes is None else list(self._node_processes.pids.values())

    def nodes(self) -> list[ProcessState]:
        """Every node, x fastest, with its process and that process' state ("running", "waiting", "stopped", "dead")."""
        return [] if self._node_processes is None else self._node_processes.states()

    def begin(self) -> None:
        """Start the fork server, which warms up while the caller does other things."""
        self._begun = True
        self._place = SocketDirectory.create(self.shape)
        warm = "raygrid.emulator.processes.warm:warm_timed" if self.timed else "raygrid.emulator.processes.warm:warm"
        self._fork_server = ForkServerClient.start(warm=warm, on_warming=self._on_warming, directory=self._place.path)

    def wait_warm(self) -> None:
        """Wait until the fork server has every kernel, and all that it compiled is in the cache on disk."""
        if self._fork_server is None:
            raise ArrayError("the array has not begun")
        self._fork_server.wait_warm(WARM_SECONDS, self.on_wait)

    def is_warm(self) -> bool:
        """Whether nodes could be forked at once. Raises ArrayError if the fork server has failed."""
        return self._fork_server is not None and self._fork_server.is_warm()

    def wait_ready(self) -> None:
        """Fork the nodes once the fork server is warm, and wait until every link is up.

        Raises LostProcess, Stuck or ProtocolError if that fails several times, ArrayError if nodes cannot be forked.
        """
        import_links()
        self.wait_warm()
        assert self._fork_server is not None
        import zmq

        from raygrid.emulator.processes.node_processes import NodeProcesses
        from raygrid.emulator.processes.process_watch import ProcessWatch

        self._node_processes, self._watch = NodeProcesses(self._fork_server), ProcessWatch()
        self._context = zmq.Context(io_threads=1)
        self._begin_epochs()

    def reset(self) -> None:
        """The reset line: whatever the array's state, after this it is empty, in a new epoch, and ready.

        Nodes that live drop all they hold and open new links; those that are dead, stopped or do not answer within
        a second are forked anew. If the nodes cannot be brought to work together, or the fork server is gone or stopped, the
        whole array is launched anew. Raises ArrayError and its kinds, or ProtocolError, if that fails as well.
        """
        if self._closing or not self._begun:
            raise ArrayError("the array cannot be reset: it was not launched, or it was closed")
        self.lost_nodes = []
        try:
            there = self._place is not None and self._place.keep()  # or no link could be made in it
            serving = self._fork_server is not None and self._fork_server.serving
            if there and serving and self._node_processes is not None:
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
                if left == 0 or self._fork_server is None or not self._fork_server.serving:
                    raise
            except (OSError, zmq.ZMQError) as error:
                raise ArrayError(f"the links of the array cannot be opened: {error.strerror}") from error

    def _begin_epoch(self) -> None:
        """Drop the links, bring all nodes to the next epoch, and wait until all links are up."""
        import zmq

        from raygrid.emulator.driver.driver import PATIENCE, Driver
        from raygrid.emulator.topology.topology import host_links
        from raygrid.emulator.topology.wiring import node_configs
        from raygrid.node.geometry import corners
        from raygrid.node.links import ZmqChannel

        assert self._node_processes is not None
        assert self._watch is not None
        assert self._place is not None
        assert self._context is not None
        self._hang_up()
        self._poller = poller = zmq.Poller()
        self._lost = None
        self._watch.forget()
        self.epoch = (self.epoch + 1) & LAST_EPOCH  # after the last one nodes refuse the first, and are forked anew
        machine = os.urandom(8).hex()
        for corner, index in corners(self.shape).items():
            zmq_channel = ZmqChannel(self._context, host_endpoint(self._place.path, self.epoch, index), bind=True)
            self._pairs[corner] = zmq_channel
            poller.register(zmq_channel.socket, zmq.POLLIN)
        told = {"batch": self.batch, "fault": self.fault, "programs": self.programs}
        told |= {"profile": self.profile, "timed": self.timed}
        before = len(self._node_processes.pids)
        forked = self._node_processes.begin(node_configs(self.shape, self._place.path, self.epoch, machine, **told))
        self.restarts += forked if before else 0
        self.lost_nodes += [event.told for event in self._node_processes.lost]
        self._node_processes.lost.clear()
        for descriptor in self._node_processes.filenos():
            poller.register(descriptor, zmq.POLLIN)
        links = host_links(self.shape, self._pairs, machine, self.epoch)
        patience = PATIENCE if self.patience is None else self.patience
        ready = READY_SECONDS + READY_SECONDS_A_NODE * len(self.pids)
        self._driver = Driver(self.shape, links, self._pump, min(patience, ready), self._node_processes.why_silent)
        self._driver.ready()
        self._driver.patience = patience
        self._place.forget_epochs_before(self.epoch)
        if self._rate:  # nodes that were forked anew have not heard of it
            self._tell_rate()

    def _hang_up(self) -> None:
        """Close the host's ends of the links."""
        self._driver = None
        self._poller = None
        for zmq_channel in self._pairs.values():
            zmq_channel.close()
        self._pairs = {}

    # --- while it lives ------------------------------------------------------------------------------

    def probe(self, rate: float, watch: Callable[[NodeSample], object] | None) -> None:
        """Let every node tell `rate` times a second how it stands, from now on, after resets too; 0: no more.

        `watch` is called with each sample while somebody waits for the array: by the driver's calls, and by `check`.
        Samples only read: pictures, counts and machine time are the same with any rate. Raises ProtocolError for a
        rate that cannot be.
        """
        from raygrid.node.runtime import read_rate

        self._rate, self._on_sample = read_rate({"rate": rate}), watch
        self._tell_rate()

    def _tell_rate(self) -> None:
        if self._node_processes is None or self._driver is None or self._poller is None:  # told when the array is ready
            return
        channels = self._node_processes.control_channels
        for index in self._node_processes.pids:
            channels.send(index, {"do": "probe", "rate": self._rate})
        if self._rate:  # waking for each sample costs more than reading it: `_pump` listens now and then instead
            with contextlib.suppress(KeyError):
                self._poller.unregister(channels.fileno())
        else:
            self._poller.register(channels.fileno(), select.POLLIN)

    def check(self) -> None:
        """Look after an array that nobody waits for: take in what has come, and look at the processes.

        Raises LostProcess, naming the node, if one ended or is stopped, or the fork server is; ProtocolError if one gave up its
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
        corner_of = {zmq_channel.socket: corner for corner, zmq_channel in self._pairs.items()}
        milliseconds = int(min(seconds, LISTEN_SECONDS if self._rate else seconds) * 1000)
        found = [] if self._poller is None else self._poller.poll(milliseconds)
        try:
            if self._rate and time.monotonic() - self._listened >= LISTEN_SECONDS:
                self._take_events()
            for ready, _ in found:
                if ready in corner_of:
                    self.driver.receive(corner_of[ready])
                else:
                    self._take_events()
            for link in self.driver.links.values():
                if link.choked:
                    link.push()
            if not found and seconds > 0.0:
                self._look()
        except FAULTS as error:
            self._lost = error  # and say so again, until the reset
            raise

    def _take_events(self) -> None:
        """Take in the ends of processes and what nodes say on their control channels."""
        from raygrid.emulator.processes.node_messages import EpochBegun, FaultInjected, LinksBroken, SampleTaken

        assert self._node_processes is not None
        self._listened = time.monotonic()
        for event in self._node_processes.read_events():
            if isinstance(event, ProcessEnded):
                if not (self._closing and event.code == 0):
                    raise LostProcess(event.told)
                continue
            match event.said:
                case LinksBroken(epoch, why):
                    if epoch == self.epoch:
                        pid = self._node_processes.pids[event.index]
                        raise ProtocolError(f"node {name_of(event.index)} (pid {pid}): {why}")
                case SampleTaken(fields):
                    self._take_sample(event.index, fields)
                case FaultInjected():
                    self.injected += 1
                case EpochBegun():
                    pass  # waited for by `NodeProcesses.begin`
                case unknown:
                    assert_never(unknown)

    def _take_sample(self, index: Index, fields: Message) -> None:
        from raygrid.emulator.driver.samples import read_sample

        if self._on_sample is not None:
            try:
                sample = read_sample(index, fields)
            except ProtocolError:
                self.refused_samples += 1
            else:
                self._on_sample(sample)

    def _look(self, idle: bool = False) -> None:
        """Look, now and then, for nodes that do not run; `idle`: for a fork server that does not, too, which a frame can do
        without. Raises LostProcess."""
        if self._watch is None or not self._watch.is_due():
            return
        if self._place is not None:
            self._place.keep()
        lost = self._watch.lost(self.nodes(), self._fork_server if idle else None)
        if lost is not None:
            self._lost = LostProcess(lost)
            raise self._lost

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
        node_processes, fork_server, place = self._node_processes, self._fork_server, self._place
        self._node_processes = self._fork_server = self._place = None
        try:
            if fork_server is not None:
                fork_server.end(END_SECONDS)
        finally:
            if node_processes is not None:
                node_processes.close()
            if place is not None:
                place.remove()

    def __enter__(self) -> Array:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if error is not None:
            self._driver = None  # nothing more is asked of an array that failed
        self.close()
