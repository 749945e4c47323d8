"""Takes part in the flood of surfaces: retains the descriptions that touch the node's cell, and hands them on."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from raygrid.node.errors import ProtocolError
from raygrid.node.geometry.overlap import meets
from raygrid.node.geometry.spanning_tree import Branch, branches
from raygrid.node.geometry.surfaces import F64, Batch
from raygrid.node.links.link import Arrival, Link
from raygrid.node.protocol.messages import MessageKind, pack_surfaces, read_surfaces
from raygrid.node.runtime.increments import MOVED, Path
from raygrid.node.runtime.node_state import NodeState

CLOGGED = 64  # waiting messages on a link at which no more surfaces are taken in


class SurfaceFlood:
    """The flood as one node sees it.

    unread     messages with descriptions that have come
    built      whether the tables were made, after which no more may come
    received, handed_on  descriptions since the last order `space`
    refuse     told why what came was refused
    """

    def __init__(self, node_state: NodeState, links: dict[int, Link], refuse: Callable[[str], None]) -> None:
        self._node_state, self._links, self._refuse = node_state, links, refuse
        self.unread: deque[tuple[Link, Arrival]] = deque()
        self.built = False
        self.received = self.handed_on = 0
        self._branches: dict[int, list[Branch]] = {}

    def begin(self) -> None:
        """A new world."""
        self.built = False
        self.received = self.handed_on = 0
        self._branches = {}

    @property
    def occupied(self) -> bool:
        """Whether descriptions wait to be taken in or handed on."""
        return bool(self.unread or self._node_state.increments.pending)

    @property
    def clogged(self) -> bool:
        """Whether a link has so much to send that no more can be handed on."""
        return any(link.waiting > CLOGGED for link in self._links.values())

    def work(self) -> None:
        """Take in what has come and send what a motion has brought to other cells, as far as the links allow."""
        while self.unread and not self.clogged:
            link, arrival = self.unread.popleft()
            # the credit goes back only now, so a slow branch slows the flood, not the memory
            link.grant()
            if self._node_state.halted:
                continue
            try:
                self._take(arrival)
            except ProtocolError as error:
                self._refuse(f"link {link.name}: {error}")
        pending = self._node_state.increments.pending
        while pending and not self.clogged:
            self._send(MOVED, pending.popleft())

    def _take(self, arrival: Arrival) -> None:
        """Retain the descriptions of a message, and hand them on. Raises ProtocolError."""
        node_state = self._node_state
        if node_state.space is None or node_state.cell is None:
            raise ProtocolError("surfaces came before a space")
        if self.built:
            raise ProtocolError("surfaces came after the order to build")
        corner, batch = read_surfaces(arrival.message, arrival.items)
        node_state.check_known(batch)
        self.received += len(batch)
        placed = node_state.increments.place(batch)
        boxes = placed.bounds()
        paths = self._paths(corner, batch, placed, boxes)
        if placed is batch:
            node_state.retain(batch, boxes)
        else:
            node_state.retain(placed, boxes, batch)
        for path in paths:
            self.handed_on += len(path.batch)
            self._send(corner, path)

    def _paths(self, corner: int, batch: Batch, placed: Batch, boxes: F64) -> list[Path]:
        """To whom descriptions go on: along the corner's tree, or after a motion along that of their owners."""
        space, cell = self._node_state.space, self._node_state.cell
        assert space is not None and cell is not None
        if corner == MOVED:
            return self._node_state.increments.relay(batch, placed, boxes, space, cell)
        if corner not in self._branches:
            self._branches[corner] = branches(corner, space, cell)
        onward = [Path(b.port, batch.select(meets(placed, b.low, b.high, boxes))) for b in self._branches[corner]]
        return [path for path in onward if len(path.batch)]

    def _send(self, corner: int, path: Path) -> None:
        payload = pack_surfaces(corner, path.batch)
        self._links[path.port].send_data(MessageKind.SURFACES, len(path.batch), payload)
