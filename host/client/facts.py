"""Names what a service says of its jobs and of itself, key by key: maps as messages and `--json` have them (docs/service.md)."""

from __future__ import annotations

from typing import NotRequired, TypedDict

ENDED = ("done", "failed", "cancelled")  # states of a job of which nothing more will be done
JOB_STATES = ("queued", "running", *ENDED)
SERVICE_STATES = ("launching", "ready", "broken", "finishing", "ending")


class JobFacts(TypedDict):
    """What is said of a job.

    job, state, client  its number, what it is doing, whose it is
    scene, outputs      as submitted
    first, last         its frames; None if it names none
    frames, done        how many there are, and are done; `skipped` of them were there already
    priority            as submitted
    submitted, begun, ended  when, in seconds since 1970; None: not yet, or not known
    error               why it failed
    """

    job: int
    state: str
    client: str
    scene: str
    outputs: list[str]
    first: int | None
    last: int | None
    frames: int
    priority: int
    done: int
    skipped: int
    submitted: NotRequired[float | None]
    begun: NotRequired[float | None]
    ended: NotRequired[float | None]
    error: str


class NodeFacts(TypedDict):
    """What the kernel says of a node's process.

    node         its coordinates
    pid, state   of its process
    cpu_seconds  that it has used
    load         part of a processor that it used lately, 0 to 1; None if that is not known yet
    pss          bytes of its memory, of pages that n processes share the n-th part
    """

    node: list[int]
    pid: int
    state: str
    cpu_seconds: float
    load: float | None
    pss: int


class MovedFacts(TypedDict):
    """How far a frame is: its phase, the part of its rays that is traced (0 to 1), packets in flight."""

    phase: str
    part: float
    in_flight: int


class RunningFacts(TypedDict):
    """The frame under way; how far it is, if it was begun."""

    job: int
    frame: int | None
    scene: str
    phase: NotRequired[str]
    part: NotRequired[float]
    in_flight: NotRequired[int]


class FaultFacts(TypedDict):
    """A fault of the array: when, in seconds since 1970, what, and at which frame of which job."""

    at: float
    what: str
    job: NotRequired[int]
    frame: NotRequired[int | None]


class QueueFacts(TypedDict):
    """Jobs that have not ended, and frames of theirs that were not begun."""

    jobs: int
    frames: int


class FaultsFacts(TypedDict):
    """How many faults there were, and the last of them."""

    count: int
    last: list[FaultFacts]


class LinksFacts(TypedDict):
    """Whether links are served by compiled code or by Python, and why by that."""

    served_by: str
    why: str | None


class JournalFacts(TypedDict):
    """Where the journal is, why it cannot be written ("" if it can), and what was mended of it."""

    path: str
    trouble: str
    remarks: list[str]


class StatusFacts(TypedDict):
    """How an array is, as `raygrid status --json` prints it."""

    name: str
    state: str
    why: str
    pid: int
    started: float
    array: list[int]
    load: float | None
    pss: int
    nodes: list[NodeFacts]
    jobs: dict[str, int]
    queue: QueueFacts
    running: RunningFacts | None
    frames: dict[str, int]
    floods: int
    increments: int
    links: LinksFacts
    resets: int
    faults: FaultsFacts
    clients: int
    refused: dict[str, int]
    journal: JournalFacts
    outside: bool
    prometheus: int | None
