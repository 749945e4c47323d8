"""Drives an array through its corners: loads, traces, collects, ends. Knows no processes and no sockets.

The driver owns the host's end of the corner links and a `pump`, which waits for messages (real array) or
runs the nodes (in-memory array) and then lets the driver receive.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.emulator.driver.admission import EAGER_FLUSH, Progress, batching, next_quota
from raygrid.emulator.driver.collector import Collected, Samples
from raygrid.emulator.driver.dealing import deal_surfaces
from raygrid.emulator.driver.increments import HeldSurfaces, check_moves, increment
from raygrid.emulator.topology.coordinates import name_of
from raygrid.node.errors import ArrayError, Garbled, ProtocolError, SceneError, Stuck
from raygrid.node.geometry import Moves, Space, SurfaceSet, groups_order
from raygrid.node.links import Link, LinkPhase
from raygrid.node.programs import Program, program_order
from raygrid.node.protocol import (
    BORN,
    DIED,
    PIXEL,
    Frame,
    MessageKind,
    TraceCommand,
    check_packets,
    frame_order,
    pack_surfaces,
    read_order,
    space_order,
)
from raygrid.node.runtime import (
    ALLOWED,
    COLLECTING,
    HANDED_ON,
    REFUSED,
    SUM_DATA_DONE,
    SUM_DATA_SENT,
    SUM_RECEIVED,
    SUM_WAITING,
    pack_request,
    read_reply,
    read_sums,
)

BUDGET = 1 << 20  # packets in flight below which primaries are admitted, and so the most primaries alive (`bounds`)
PATIENCE = 30.0  # seconds without any progress after which the array is taken to hang
HOLD = 0.02  # seconds for which a busy node may hold a wave, and a millisecond more for every node
PROGRAM_SECONDS = 600.0  # one process compiles a program, which takes half a minute on an idle computer


class Driver:
    """Drives one array. `links`: corner number -> the host's end of the link to that corner's node."""

    def __init__(
        self,
        shape: tuple[int, int, int],
        links: dict[int, Link],
        pump: Callable[[float], None],
        patience: float = PATIENCE,
        why_silent: Callable[[], str] = lambda: "",
    ) -> None:
        self._why_silent = why_silent
        self._answered = True  # whether the last wave has come back
        self._quiet = True  # whether nothing of an unfinished pass or load can be under way
        self._settling = False
        self.shape, self.links, self._pump, self.patience = shape, links, pump, patience
        self.nodes = shape[0] * shape[1] * shape[2]
        self._processors = len(os.sched_getaffinity(0))
        self._wave_number = 0
        self._answer: dict[str, Any] | None = None
        self._collected: Collected | None = None  # what comes of the pass that is being collected
        self.held: HeldSurfaces | None = None  # by the nodes together; None: nothing whole
        self.program: Program | None = None  # what the nodes run
        self.waves = 0
        self.most_in_flight = 0

    # --- messages ------------------------------------------------------------------------------------

    def receive(self, corner: int) -> None:
        """Take in what the link to a corner has. Raises ProtocolError."""
        link = self.links[corner]
        while (arrival := link.receive()) is not None:
            if arrival.kind == MessageKind.PACKETS:
                check_packets(arrival.message, arrival.items)
                self._take_pixels(arrival.message, arrival.items)
                link.grant()
            elif arrival.kind == MessageKind.UP and corner == 0:
                self._answer = read_order(arrival.message)
            elif arrival.kind == MessageKind.REDUCED and corner == 0:
                number, sums = read_reply(arrival.message)
                self._answer = {"wave": number, "sums": sums.tobytes()}
            else:
                raise ProtocolError(f"link {link.name}: {arrival.kind.name} came, which a node never sends to the host")

    def _take_pixels(self, message: bytes, count: int) -> None:
        if self._settling:
            return
        if self._collected is None:
            raise ProtocolError(f"{count} pixel packets came, but no frame is being collected")
        self._collected.take(message, count)

    def wave(self, command: TraceCommand | dict[str, Any]) -> dict[str, Any]:
        """Send a command over the array and wait for the answer of all. Raises Stuck, ProtocolError, LostProcess."""
        order = command.as_map() if isinstance(command, TraceCommand) else command
        if not self._answered:  # the caller gave up waiting for the last one
            self._wait(lambda: self._answer is not None, "the order before came back")
        self._wave_number += 1
        self.waves += 1
        self._answer, self._answered = None, False
        request = pack_request(self._wave_number, command) if isinstance(command, TraceCommand) else None
        if request is None:
            self.links[0].send_order(MessageKind.DOWN, {**order, "wave": self._wave_number})
        else:
            self.links[0].send_payload(MessageKind.REDUCE, request)
        self._wait(lambda: self._answer is not None, f"the order {order['do']!r} came back")
        self._answered = True
        answer: dict[str, Any] = self._answer  # type: ignore[assignment]
        sums = answer["sums"] = read_sums(answer).tolist()
        if answer.get("wave") != self._wave_number:
            raise ProtocolError(f"wave {self._wave_number} ({order['do']}) came back as another one")
        if sums[REFUSED] and request is not None:  # which says how often, and another wave why
            return self.wave({"do": "loaded"})
        if sums[REFUSED]:
            raise Garbled(f"{sums[REFUSED]} times a node refused what came: " + "; ".join(answer["refusals"]))
        return answer

    def _wait(self, done: Callable[[], bool], what: str) -> None:
        """Pump until a condition holds. Raises Stuck after `patience` seconds without any message."""
        since, seen = time.monotonic(), -1
        while not done():
            self._pump(0.25)
            received = sum(link.received for link in self.links.values())
            if received != seen:
                since, seen = time.monotonic(), received
            elif time.monotonic() - since > self.patience:
                why = self._why_silent()
                raise Stuck(
                    f"nothing came from the array for {self.patience:g} seconds while waiting until {what}"
                    + (f"; {why}" if why else "")
                )

    def settle(self, patience: float) -> None:
        """Let the nodes drop what a pass or load has left under way that was given up.

        patience  seconds without any message after which they are taken to hang
        Raises Stuck, and what goes wrong besides; an array that is reset then has nothing under way either.
        """
        before, self.patience = self.patience, min(self.patience, patience)
        try:
            if not self._answered:
                self._wait(lambda: self._answer is not None, "the order before came back")
                self._answered = True
            self._settle()
        finally:
            self.patience = before

    def _settle(self) -> None:
        """Drop what an unfinished pass or load has left under way, so that nothing of it comes into the next one.

        Nodes that are halted send no packets or surfaces. So when all that were sent have been received, as told by
        a wave that began after all nodes were halted, none is under way.
        """
        if self._quiet:
            return
        self._settling = True
        try:
            self.wave({"do": "halt"})
            since = time.monotonic()
            while True:
                sums = self.wave({"do": "halt"})["sums"]
                sent = sums[SUM_DATA_SENT] + sum(link.data_sent for link in self.links.values())
                done = sums[SUM_DATA_DONE] + sum(link.data_done for link in self.links.values())
                if sent == done:
                    break
                if time.monotonic() - since > self.patience:
                    raise Stuck(f"of {sent} messages with packets or surfaces {done} were received")
        finally:
            self._settling = False
        self._quiet = True

    # --- loading -------------------------------------------------------------------------------------

    def ready(self) -> None:
        """Wait until every link of every node is up."""
        self.wave({"do": "ready"})

    def load_program(self, program: Program | None) -> None:
        """Let all nodes compile and try a program, and use it if all are content; None: the step without one.

        Surfaces must be loaded anew afterwards. Raises ArrayError with what the nodes say if one is not; then all use
        what they used before.
        """
        self.held = None
        self._settle()
        self._quiet = False
        patience, self.patience = self.patience, max(self.patience, PROGRAM_SECONDS)
        try:
            self.wave(program_order(program))
            self.wave({"do": "use"})
        except Garbled as error:
            self._settle()  # so that nodes forget what they refused
            raise ArrayError(f"a program was refused: {error}") from None
        finally:
            self.patience = patience
        self.program = program

    def load(self, space: Space, surfaces: SurfaceSet, moves: Moves | None = None, key: str = "") -> None:
        """Deal surfaces (machine coordinates) over the corners, and wait until every node has built its tables.

        `moves`: of some surfaces, which then are given at rest, the groups and where these are. `key`: by which it is known
        again (`HeldSurfaces`). Raises SceneError for motions that are not finite, or by which a surface leaves the world box.
        """
        self.held = None
        if moves is not None:
            check_moves(space, surfaces, moves)
        self._settle()
        self._quiet = False
        self.wave(space_order(space))
        if moves is not None and moves.groups.many:
            self.wave(groups_order(moves))
        dealt = 0
        for corner, batch in deal_surfaces(surfaces, self.shape, moves, self._look_up):
            link = self.links[corner]
            link.send_data(MessageKind.SURFACES, len(batch), pack_surfaces(corner, batch))
            dealt += len(batch)
            if link.waiting > 4:
                self._wait(lambda link=link: link.waiting <= 4, "a corner takes more surfaces")  # type: ignore[misc]
        self._wait(lambda: all(link.waiting == 0 for link in self.links.values()), "the corners take all surfaces")
        self._wait_arrived(dealt, -1)
        self.wave({"do": "build"})
        self._quiet = True
        self.held = HeldSurfaces(space, surfaces, moves, dealt, key)

    def move(self, moves: Moves, key: str = "") -> bool:
        """Bring the surfaces of the last load to where `moves` has them, by telling nodes only what has changed.

        Returns whether that was more than nothing. Raises SceneError as `load` does, and then the nodes hold what they
        held; ArrayError without a load of the same groups before.
        """
        held, self.held = self.held, None
        if held is None or held.moves is None or held.moves.groups is not moves.groups:
            raise ArrayError("an increment came without a load of the same groups before it")
        try:
            order = increment(held, moves)
        except SceneError:
            self.held = held
            raise
        if order is not None:
            self._settle()
            self._quiet = False
            self.wave(order)
            self._wait_arrived(held.dealt, self.wave({"do": "hand"})["sums"][SUM_RECEIVED])
            self.wave({"do": "build"})
            self._quiet = True
        self.held = held._replace(moves=moves, key=key)
        return order is not None

    def _look_up(self) -> None:
        """Take in what has come, without waiting: whoever drives us is heard, and a lost node noticed, amid long work."""
        self._pump(0.0)

    def _wait_arrived(self, dealt: int, received: int) -> None:
        """Wait until all descriptions that were sent have come; `received`: the count of the wave before, -1: none.

        What a wave counts is no picture of one moment, so two are compared. What the first found received had been, and
        what the second found sent was all, at the moment between them: if these are the same, none was under way.
        """
        while True:
            sums = self.wave({"do": "loaded"})["sums"]
            if received == dealt + sums[HANDED_ON]:
                return
            received = sums[SUM_RECEIVED]

    # --- tracing -------------------------------------------------------------------------------------

    def trace(
        self,
        frame: Frame,
        budget: int = BUDGET,
        progress: Callable[[Progress], None] | None = None,
        prices: dict[str, Any] | None = None,
    ) -> Progress:
        """Trace a pass to completion: two successive waves with equal sums, born = died, nothing left to admit.

        prices   of machine time (`node.protocol.timestamps.prices_order`), for an array that keeps it
        """
        self._settle()
        self._quiet = False
        answer = self.wave({**frame_order(frame), **(prices or {})})
        hold = HOLD + 0.001 * self.nodes
        before: Progress | None = None
        moved = time.monotonic()
        self.most_in_flight = 0
        while True:
            now = Progress.of(answer["sums"])
            self.most_in_flight = max(self.most_in_flight, now.in_flight)
            if progress is not None:
                progress(now)
            if now != before:
                moved = time.monotonic()
            elif now.homes_left == 0 and now.in_flight == 0:
                self._quiet = True
                return now
            elif time.monotonic() - moved > self.patience:
                raise Stuck(self._why_stuck(now))
            quota = next_quota(budget, now, before, answer["sums"][ALLOWED])
            before = now
            command = batching(now.in_flight, self.nodes, self._processors)
            answer = self.wave(command._replace(quota=quota, hold=hold))

    def _why_stuck(self, now: Progress) -> str:
        waiting = [f"{name_of(node['index'])} holds {node['waiting']}" for node in self.report() if node["waiting"]]
        return (
            f"no counter moved for {self.patience:g} seconds with {now.in_flight} packets in flight and "
            f"{now.homes_left} homes with samples left; " + ("; ".join(waiting[:8]) or "no node holds a packet")
        )

    def collect(self, pixels: int, into: Collected | None = None) -> tuple[NDArray[np.int64], Samples]:
        """(sums (pixels, 3) in fixed point, samples (pixels,)) of the pass, from the homes by way of the corners.

        into  where they are added, of as many pixels; None: a new one, for as many samples as a uint16 counts
        """
        self._quiet = False
        self._collected = collected = into or Collected(pixels)
        hold = HOLD + 0.001 * self.nodes
        command: TraceCommand | dict[str, Any] = {"do": "collect", "hold": hold}
        since = time.monotonic()
        while True:
            sums = self.wave(command)["sums"]
            born, died = sums[BORN + PIXEL], sums[DIED + PIXEL]
            if sums[COLLECTING] == 0 and sums[SUM_WAITING] == 0 and born == died:
                break
            if time.monotonic() - since > self.patience + pixels / 1e4:
                raise Stuck(f"{born} pixel packets were born and {died} reached a corner")
            command = TraceCommand(0, hold, flush=EAGER_FLUSH)
        self._wait(lambda: collected.received >= born, "all pixel packets are here")
        if collected.received != born:
            raise Garbled(f"{collected.received} pixel packets came, {born} were born")
        self._collected = None
        self._quiet = True
        return collected.sums, collected.samples

    # --- other ---------------------------------------------------------------------------------------

    def report(self) -> list[dict[str, Any]]:
        """The record of every node (`node.runtime.processor.Processor.record`), in order of their places."""
        return sorted(self.wave({"do": "report"})["nodes"], key=lambda node: node["index"][::-1])

    def end(self) -> None:
        """Tell every node to end, and close the corner links."""
        self.wave({"do": "end"})
        for link in self.links.values():
            link.close()
        self._wait(
            lambda: all(link.state == LinkPhase.CLOSED for link in self.links.values()), "the corners say goodbye"
        )
