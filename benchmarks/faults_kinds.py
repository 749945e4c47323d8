"""What the fault campaign tries, on what: stages that are set up once, and the kinds of faults that are tried on each."""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import faults_cache
import faults_cancel
import faults_cleaners
import faults_content
import faults_crowd
import faults_ends
import faults_journal
import faults_links
import faults_nodes
import faults_outputs
import faults_signals
import faults_time
import faults_user
from faults_bed import SHAPES, Bed, Case, text_of
from faults_service import ServiceBed

Cases = Callable[[random.Random], list[Case]]
ARRAY_KINDS: dict[str, Cases] = {
    **faults_nodes.GROUPS,
    **faults_time.GROUPS,
    **faults_links.GROUPS,
    **faults_ends.GROUPS,
}
SERVICE_KINDS: dict[str, Cases] = {
    **faults_content.GROUPS,
    **faults_outputs.GROUPS,
    **faults_cancel.GROUPS,
    **faults_crowd.GROUPS,
    **faults_signals.GROUPS,
    **faults_journal.GROUPS,
    **faults_cleaners.GROUPS,
}


@dataclass(frozen=True)
class Stage:
    """On what kinds of faults are tried: made once for all of them, in a folder of the campaign.

    cannot  why they cannot be tried here; "" if they can
    """

    name: str
    make: Callable[[Path], AbstractContextManager[Any]]
    kinds: dict[str, Cases]
    cannot: Callable[[], str] = lambda: ""


STAGES = [
    *(Stage(text_of(shape), partial(Bed, shape), ARRAY_KINDS) for shape in SHAPES),
    Stage("service", ServiceBed, SERVICE_KINDS),
    Stage("service, another user", ServiceBed, faults_user.GROUPS, faults_user.cannot),
    Stage("commands", faults_cache.CacheBed, faults_cache.GROUPS),
]
