"""Names the kinds of kernels, and phrases what the fork server tells a front end of them."""

from __future__ import annotations

NODES, TIMED_NODES, SIMULATOR, ANALYSIS = KINDS = (
    "nodes",
    "nodes that keep machine time",
    "the simulator",
    "traces and jams",
)
NOTE = "note: "  # what begins so is a remark (`raygrid.node.remarks`)
COMPILING, FOR = "compiling ", " for "  # a function, for a kind


def compiling(function: str, kind: str) -> str:
    """That a function was compiled."""
    return f"{COMPILING}{function}{FOR}{kind}"


def kind_of(words: str) -> str | None:
    """The kind of the function that was compiled; None if the words are about something else."""
    return words.partition(FOR)[2] if words.startswith(COMPILING) else None
