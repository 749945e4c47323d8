"""Speaks the link protocol: one end of a link between two neighbours, over any channel that carries whole messages in order.

A channel's word proves nothing (a black-holed ZeroMQ peer sees all its sends succeed), so the link itself
says HELLO and waits for ACK, numbers what it sends, and closes with BYE and its answer. It never blocks: a
message that may not go yet (no credit, or the channel is full) waits in the link.

    state     on send                   on receive
    NEW       HELLO, orders             HELLO once and first -> ACK;  ACK once;  orders
    UP        anything                  anything but HELLO, ACK, BYE_ACK
    CLOSING   BYE sent; ACK, BYE_ACK    as before, and BYE_ACK once
    CLOSED    nothing                   nothing

Who has seen BYE takes only ACK and BYE_ACK after it. What waits for credit when a link is closed is given up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from raygrid.node.errors import ProtocolError
from raygrid.node.jit.records import Record, Rows, record
from raygrid.node.protocol.messages import (
    HEAD,
    HEADER,
    IS_DATA,
    VERSION,
    WINDOW,
    MessageKind,
    is_whole,
    pack_message,
    pack_order,
    read_header,
    read_order,
    seal,
)
from raygrid.node.protocol.packets import SIZE

MESSAGE_OVERHEAD = 250  # bytes, more than a message that waits here takes beside its payload


class Channel(Protocol):
    """Carries whole messages in order to one peer, or not at all."""

    def send(self, message: bytes | memoryview) -> bool:
        """Hand over a message without blocking; False if there is no room now."""

    def receive(self) -> bytes | None:
        """The next message, or None if there is none now."""

    def close(self) -> None:
        """Give the channel up; messages under way may be lost."""


@record
class LinkState(Record):
    """What both Python and compiled code (`node.runtime.event_loop`) count of a link.

    socket         address of its ZeroMQ socket; 0: none that compiled code may use
    regular        `Link.regular`
    epoch          of its messages
    sent, received messages so far, and so the sequence numbers of the next ones
    data_sent      messages with data that were sent; credit: of these processed by the peer
    data_done      messages with data from the peer that were processed; data_told: of these told to it
    bytes_sent     headers included
    """

    socket: int
    regular: int
    epoch: int
    sent: int
    received: int
    data_sent: int
    credit: int
    data_done: int
    data_told: int
    bytes_sent: int


class LinkPhase(Enum):
    """Where a link stands."""

    NEW = "new"
    UP = "up"
    CLOSING = "closing"
    CLOSED = "closed"


class Arrival(NamedTuple):
    """A message for the owner of the link."""

    kind: MessageKind
    items: int
    message: bytes


class Link:
    """One end of a link.

    name      for error messages, "1,0,0 port +x"
    identity  what HELLO says: machine, coordinates, port; the peer's must equal `peer`
    """

    def __init__(
        self, channel: Channel, name: str, epoch: int, identity: dict[str, object], peer: dict[str, object]
    ) -> None:
        self.channel = channel
        self.name = name
        self.epoch = epoch
        self._counted = LinkState(epoch=epoch)
        self.state = LinkPhase.NEW
        self._identity = {**identity, "version": VERSION}
        self._peer = {**peer, "version": VERSION}
        self._hello_seen = self._acknowledged = self._bye_seen = self._bye_answered = False
        # data without credit, and orders that the channel had no room for; to be looked at, not changed, from outside
        self.queued: deque[tuple[MessageKind, int, bytes]] = deque()
        self.urgent: deque[tuple[MessageKind, bytes]] = deque()
        self.stale = 0
        self.most_waiting = self.most_waiting_bytes = self._waiting_bytes = 0
        self._post(MessageKind.HELLO, pack_order(self._identity))

    # --- sending ---------------------------------------------------------------------------------

    @property
    def waiting(self) -> int:
        """Messages that wait for credit or room."""
        return len(self.queued) + len(self.urgent)

    @property
    def choked(self) -> bool:
        """Whether a message could go by the link's rules, but the channel had no room for it."""
        return bool(self.urgent) or (bool(self.queued) and self._may_send_data())

    def send_order(self, kind: MessageKind, order: Mapping[str, object]) -> None:
        """Send an order or answer; it needs no credit, because waves are few."""
        self._post(kind, pack_order(order))

    def send_payload(self, kind: MessageKind, payload: bytes) -> None:
        """Send a message of a reduction; no credit either."""
        self._post(kind, payload)

    def send_data(self, kind: MessageKind, count: int, payload: bytes) -> None:
        """Send packets or surfaces, now or when there is credit."""
        self._wait_with(kind, count, payload)
        self.push()

    def send_packets(self, row: NDArray[np.uint8], held: int, batch: int) -> None:
        """Send the first `held` packets of an output row (HEAD bytes are free at its head), `batch` a message."""
        if held <= batch and not self.queued and not self.urgent and self._may_send_data():
            data = row.data
            message = data[: HEAD + held * SIZE]
            kind, *numbers = self._header(MessageKind.PACKETS, held)
            HEADER.pack_into(message, 0, kind, 0, *numbers, 0)
            seal(message)
            if self.channel.send(message):
                self._count_sent(HEAD + held * SIZE, data=True)
                return
        for first in range(0, held, batch):
            many = min(batch, held - first)
            begin = HEAD + first * SIZE
            self._wait_with(MessageKind.PACKETS, many, row[begin : begin + many * SIZE].tobytes())
        self.push()

    def push(self) -> None:
        """Send what waits, as far as credit and the channel allow."""
        while self.urgent:
            kind, payload = self.urgent[0]
            if not self._send_now(kind, 0, payload):
                return
            self.urgent.popleft()
        self._maybe_closed()
        while self.queued and self._may_send_data():
            kind, count, payload = self.queued[0]
            if not self._send_now(kind, count, payload):
                return
            self.queued.popleft()
            self._waiting_bytes -= len(payload) + MESSAGE_OVERHEAD

    def grant(self, messages: int = 1) -> None:
        """Say that this many data messages from the peer have been processed."""
        self._counted.data_done += messages
        if self._counted.data_done - self._counted.data_told >= WINDOW // 2 and self.state is LinkPhase.UP:
            self._post(MessageKind.CREDIT, b"")

    def give_up(self) -> None:
        """Forget the data that waits for credit or room."""
        self.queued.clear()
        self._waiting_bytes = 0

    def forget_peaks(self) -> None:
        """Let the most that waited be counted anew."""
        self.most_waiting, self.most_waiting_bytes = len(self.queued), self._waiting_bytes

    def close(self) -> None:
        """Say BYE; the link is CLOSED when both sides have said and answered it."""
        if self.state in (LinkPhase.NEW, LinkPhase.UP):
            self._post(MessageKind.BYE, b"")
            self.state = LinkPhase.CLOSING
            self._maybe_closed()

    def _wait_with(self, kind: MessageKind, count: int, payload: bytes) -> None:
        self.queued.append((kind, count, payload))
        self._waiting_bytes += len(payload) + MESSAGE_OVERHEAD
        self.most_waiting = max(self.most_waiting, len(self.queued))
        self.most_waiting_bytes = max(self.most_waiting_bytes, self._waiting_bytes)

    def _may_send_data(self) -> bool:
        return self.state == LinkPhase.UP and self._counted.data_sent - self._counted.credit < WINDOW

    def _header(self, kind: MessageKind, count: int) -> tuple[int, int, int, int, int]:
        sent, done = self._counted.sent & 0xFFFFFFFF, self._counted.data_done & 0xFFFFFFFF
        return int(kind), self.epoch, sent, done, count

    def _post(self, kind: MessageKind, payload: bytes) -> None:
        if self.urgent or not self._send_now(kind, 0, payload):
            self.urgent.append((kind, payload))

    def _send_now(self, kind: MessageKind, count: int, payload: bytes) -> bool:
        message = pack_message(*self._header(kind, count), payload)
        if not self.channel.send(message):
            return False
        self._count_sent(len(message), kind in IS_DATA)
        return True

    def _count_sent(self, size: int, data: bool) -> None:
        self._counted.sent += 1
        self._counted.data_sent += data
        self._counted.data_told = self._counted.data_done
        self._counted.bytes_sent += size

    # --- receiving -------------------------------------------------------------------------------

    def receive(self) -> Arrival | None:
        """The next message for the owner, None if there is none now. Raises ProtocolError.

        The link deals with HELLO, ACK, CREDIT, BYE and BYE_ACK itself; a message of another epoch is
        counted and dropped.
        """
        while self.state != LinkPhase.CLOSED:
            message = self.channel.receive()
            if message is None:
                return None
            header = read_header(message)
            if not is_whole(message):
                raise ProtocolError(
                    f"link {self.name}: a message of {len(message)} bytes came with another checksum than its own: "
                    "it was changed or cut on its way"
                )
            if header.epoch != self.epoch:
                self.stale += 1
                continue
            self._check_order(header.sequence, header.kind)
            self._take_credit(header.credit)
            if not self._is_for_link(header.kind, message):
                return Arrival(header.kind, header.items, message)
        return None

    def _check_order(self, sequence: int, kind: MessageKind) -> None:
        if sequence != self._counted.received & 0xFFFFFFFF:
            raise ProtocolError(
                f"link {self.name}: message {sequence} ({kind.name}) came, wanted {self._counted.received}: "
                "messages were lost, doubled or out of order"
            )
        self._counted.received += 1

    def _take_credit(self, credit: int) -> None:
        gained = (credit - self._counted.credit) & 0xFFFFFFFF
        if gained > self._counted.data_sent - self._counted.credit:
            raise ProtocolError(
                f"link {self.name}: the peer says it has processed {credit} messages, {self._counted.data_sent} were sent"
            )
        if gained:
            self._counted.credit += gained
            self.push()

    def _is_for_link(self, kind: MessageKind, message: bytes) -> bool:
        """Deal with the link's own messages; False for all others."""
        if kind in IS_DATA and self.state is not LinkPhase.NEW and not self._bye_seen:
            return False
        self._check_turn(kind)
        if kind is MessageKind.HELLO:
            self._meet(read_order(message))
        elif kind is MessageKind.ACK:
            self._acknowledged = True
        elif kind is MessageKind.BYE:
            self._bye_seen = True
            self._post(MessageKind.BYE_ACK, b"")
            self._maybe_closed()
        elif kind is MessageKind.BYE_ACK:
            self._bye_answered = True
            self._maybe_closed()
        elif kind is not MessageKind.CREDIT:
            return False
        if self.state == LinkPhase.NEW and self._hello_seen and self._acknowledged:
            self.state = LinkPhase.UP
            self.push()
        return True

    def _check_turn(self, kind: MessageKind) -> None:
        """Raise ProtocolError for a message that must not come in this state."""
        wrong = ""
        if kind is MessageKind.HELLO:
            wrong = "a second time" if self._hello_seen else ""
        elif not self._hello_seen:
            wrong = "before HELLO"
        elif kind is MessageKind.ACK:
            wrong = "a second time" if self._acknowledged else ""
        elif kind is MessageKind.BYE_ACK:
            wrong = "" if self.state is LinkPhase.CLOSING and not self._bye_answered else "without a BYE to answer"
        elif self._bye_seen:
            wrong = "after BYE"
        elif kind in IS_DATA and not self._acknowledged:
            wrong = "before ACK"
        if wrong:
            raise ProtocolError(f"link {self.name}: {kind.name} came {wrong}")

    def _meet(self, order: Mapping[str, object]) -> None:
        if order != self._peer:
            came = _shown(order, self._peer["machine"])
            raise ProtocolError(
                f"link {self.name}: HELLO came as {came}, wanted {_shown(self._peer, self._peer['machine'])}"
            )
        self._hello_seen = True
        self._post(MessageKind.ACK, b"")

    def _maybe_closed(self) -> None:
        if self._bye_seen and self._bye_answered and not self.urgent:
            self.state = LinkPhase.CLOSED

    def share_state(self, rows: Rows, row: int) -> LinkState:
        """Count in this record, shared with compiled code, from now on; what Python sees of it."""
        shared = LinkState.view(rows, row)
        shared.take(self._counted)
        self._counted = shared
        return shared

    @property
    def regular(self) -> bool:
        """Whether packets may come and go, and nothing waits to be sent: then compiled code may serve the link."""
        return self.state is LinkPhase.UP and not (self._bye_seen or self.queued or self.urgent)

    @property
    def messages_sent(self) -> int:
        """Messages that were sent so far, and so the sequence number of the next one."""
        return self._counted.sent

    @property
    def bytes_sent(self) -> int:
        """Bytes that were sent so far."""
        return self._counted.bytes_sent

    @property
    def data_sent(self) -> int:
        """Messages with packets or surfaces that were sent so far."""
        return self._counted.data_sent

    @property
    def data_done(self) -> int:
        """Messages with packets or surfaces from the peer that were processed so far."""
        return self._counted.data_done

    @property
    def received(self) -> int:
        """Messages that came so far."""
        return self._counted.received

    @property
    def peer_left(self) -> bool:
        """Whether the peer has said BYE."""
        return self._bye_seen


def _shown(hello: Mapping[str, object], machine: object) -> str:
    """A HELLO for an error, which many may read: by its machine's name a stranger could pass for a neighbour."""
    rest = {key: value for key, value in hello.items() if key != "machine"}
    return f"{rest} of {'this' if hello.get('machine') == machine else 'another'} machine"
