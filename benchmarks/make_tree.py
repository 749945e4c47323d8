"""Write scenes/tree.nff: a small tree on a very large ground, all the work in a small part of the world box.

    python benchmarks/make_tree.py scenes/tree.nff

A branch is a cone with a ball at its upper end. From each ball three thinner branches go on, turned about the old
direction by a third of a circle and a little more each time. No random numbers: the same file every time.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
LEVELS = 7  # of branches
TRUNK, THIN = 0.75, 0.075  # length and radius of the first
SHORTER, THINNER = 0.74, 0.6  # each level against the one before
SPREAD = math.radians(38.0)  # between a branch and the ones that go on from it
TURN = math.radians(47.0)  # of each level against the one before
GROUND = 50.0  # half an edge

HEAD = """# A tree of cones and balls, three units high, on a ground of a hundred: nearly all the work is in a
# small part of the scene. Written by benchmarks/make_tree.py.
b 0.55 0.70 0.90
v
from -4.2 3.6 1.9
at 0 0 1.25
up 0 0 1
angle 42
hither 0.1
resolution 512 512
l 9 2 12
l -8 6 9
l -3 -11 8
l 4 10 6
l -12 -2 14
l 1 -5 20
l 7 7 5
f 0.45 0.50 0.35  0.9 0 0 0 0
p 4
"""


def around(axis: F64) -> tuple[F64, F64]:
    """Two unit vectors square to an axis and to each other."""
    least = np.eye(3)[np.argmin(np.abs(axis))]
    side = np.cross(axis, least)
    side /= np.linalg.norm(side)
    return side, np.cross(axis, side)


def grow(foot: F64, along: F64, length: float, radius: float, turn: float, level: int, lines: list[list[str]]) -> None:
    """Append the lines of a branch, and of all that grow from it, to those of their level."""
    top, thin = foot + length * along, radius * THINNER
    lines[level].append("c")
    lines[level].append(" ".join(f"{x:.4f}" for x in (*foot, radius)))
    lines[level].append(" ".join(f"{x:.4f}" for x in (*top, thin)))
    lines[level].append("s " + " ".join(f"{x:.4f}" for x in (*top, thin)))
    if level + 1 == LEVELS:
        return
    side, other = around(along)
    for number in range(3):
        angle = turn + number * 2.0 * math.pi / 3.0
        away = math.cos(angle) * side + math.sin(angle) * other
        onward = math.cos(SPREAD) * along + math.sin(SPREAD) * away
        grow(top, onward, length * SHORTER, thin, turn + TURN, level + 1, lines)


def tree() -> str:
    """The whole file."""
    lines: list[list[str]] = [[] for _ in range(LEVELS)]
    grow(np.zeros(3), np.array([0.0, 0.0, 1.0]), TRUNK, THIN, 0.3, 0, lines)
    text = HEAD
    for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        text += f"{x * GROUND:g} {y * GROUND:g} 0\n"
    for level, branches in enumerate(lines):
        share = level / (LEVELS - 1)
        colour = (0.45 - 0.20 * share, 0.30 + 0.30 * share, 0.18 + 0.02 * share)
        text += "f " + " ".join(f"{x:.3f}" for x in colour) + "  0.85 0.15 20 0 0\n" + "\n".join(branches) + "\n"
    return text


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(tree())
