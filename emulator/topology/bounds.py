"""Bounds how many packets the machine can have in flight (law 6).

Trees. A primary ray, with all that descends from it, is a tree; the tree is alive while any packet of it is. The
driver lets homes emit primaries so that never more trees are alive than the budget, or than there are homes if these
are more (`driver.admission.next_quota` says why).

Packets of a tree. A ray of depth d that hits something dies and emits at most one shadow ray a light, and at most
`branches` rays of depth d + 1 if d is below the frame's depth. A shadow ray, or a ray that leaves the scene, dies
and emits at most one return. So with L lights, depth D and b branches the most packets of a tree alive at once are

    A(D) = max(1, L)        A(d) = max(1, L + b A(d + 1))        A(1) = L (1 + b + ... + b^(D-1)) if L > 0

and likewise the most rays max(1, b^(D-1)), and the most shadow rays the sum above. Nothing in the order of work can
be counted on to keep it lower: what one node emits another one may be slow to serve. So

    packets in flight <= max(budget, homes) x A(1)

and no more than there are samples, times A(1). A test reaches these bounds with a node that is slow on purpose;
in ordinary pictures a few percent of them are used, because the deepest rays are served first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raygrid.node.protocol import SPECULAR, TRANSMISSION, Frame


class Growth(NamedTuple):
    """The most packets of one tree that can be alive at once: rays, shadow rays, and any packets."""

    rays: int
    shadows: int
    packets: int


def branches_of(frame: Frame) -> int:
    """Rays that one hit can emit: 0, 1 or 2."""
    reflects = (frame.materials[:, SPECULAR : SPECULAR + 3] > 0.0).any(axis=1)
    transmits = (frame.materials[:, TRANSMISSION : TRANSMISSION + 3] > 0.0).any(axis=1)
    return int(np.max(reflects.astype(np.int64) + transmits, initial=0))


def growth(depth: int, lights: int, branches: int) -> Growth:
    """How a tree can grow."""
    rays, shadows, packets = 1, lights, max(1, lights)
    for _ in range(depth - 1):
        rays, shadows = max(1, branches * rays), lights + branches * shadows
        packets = max(1, lights + branches * packets)
    return Growth(rays, shadows, packets)


def growth_of(frame: Frame) -> Growth:
    """How a tree of this frame can grow."""
    return growth(frame.depth, frame.n_lights, branches_of(frame))
