"""What a node replies to a wave, and what comes from its children."""

from __future__ import annotations

import numpy as np
import pytest

from raygrid.node.errors import ProtocolError
from raygrid.node.runtime.reduction import SUMS
from raygrid.node.runtime.waves import MOST_SHOWN, WaveReply, read_sums


def reply(number: int, refusals: int = 0) -> WaveReply:
    """Of a node whose sums are all this number."""
    whys = [f"why {number}.{k}" for k in range(refusals)]
    return WaveReply(np.full(SUMS, number, np.int64), [{"index": [number, 0, 0]}], whys)


def test_replies_of_children_are_added():
    mine = reply(1, 2)
    mine.add(reply(10, 2).as_map(7))
    mine.add(reply(100).as_map(7))
    told = mine.as_map(7)
    assert told["wave"] == 7
    assert read_sums(told).tolist() == [111] * SUMS
    assert [node["index"][0] for node in told["nodes"]] == [1, 10, 100]
    assert told["refusals"] == ["why 1.0", "why 1.1", "why 10.0"]
    assert len(told["refusals"]) == MOST_SHOWN


@pytest.mark.parametrize("change", [{"sums": None}, {"sums": b"8 bytes."}, {"nodes": None}, {"refusals": "why"}])
def test_what_is_no_reply_is_refused(change):
    with pytest.raises(ProtocolError, match="a reply came without its"):
        reply(1).add(reply(2).as_map(1) | change)
