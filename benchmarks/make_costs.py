"""Work out the cost models of emulator/costs from operation counts: python benchmarks/make_costs.py

OPERATIONS says how many operations of each sort our kernels do (node/*.py); MACHINES what an operation costs in
clocks, from the makers' tables; both as low, middle and high. A test writes the files again and compares. What the
numbers mean, and where they come from, is told in docs/costs.md.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parents[1] / "emulator" / "costs"
Triple = tuple[float, float, float]


class Ops(NamedTuple):
    """Operations of a piece of work: add or subtract, multiply, divide, square root, compare (floating point); powers;
    whole-number instructions of 16 bits."""

    add: int = 0
    mul: int = 0
    div: int = 0
    sqrt: int = 0
    compare: int = 0
    power: int = 0
    whole: int = 0


# (the least that happens, the most that happens); the middle is half way
OPERATIONS: dict[str, tuple[Ops, Ops]] = {
    # a packet taken out of its queue, its kind looked at, handed to the work it needs
    "packet": (Ops(whole=40), Ops(whole=100)),
    # decode origin and direction, unit vector, three inverses, three times of entry and exit, the exit port
    "walk": (Ops(11, 17, 4, 1, 12, whole=150), Ops(11, 17, 4, 1, 20, whole=250)),
    # a node of the hierarchy: eight boxes, three slabs each; those met are put in order
    "box": (Ops(48, 48, compare=48, whole=60), Ops(48, 48, compare=96, whole=120)),
    # rejected at u; accepted
    "triangle": (Ops(16, 13, 1, compare=3, whole=20), Ops(27, 36, 1, compare=7, whole=30)),
    "smooth": (Ops(16, 13, 1, compare=3, whole=20), Ops(27, 36, 1, compare=7, whole=30)),
    # the plane lies elsewhere; six edges are looked at
    "polygon": (Ops(5, 6, 1, compare=3, whole=20), Ops(20, 15, 1, compare=23, whole=80)),
    "sphere": (Ops(11, 10, compare=1, whole=15), Ops(15, 14, 1, 1, 5, whole=20)),
    "cylinder": (Ops(30, 37, compare=1, whole=30), Ops(40, 47, 2, 2, 10, whole=50)),
    "cone": (Ops(30, 37, compare=1, whole=30), Ops(40, 47, 2, 2, 10, whole=50)),
    # point, normal (flat; interpolated and made a unit vector), cosine, mirror direction, weights
    "hit": (Ops(11, 16, compare=4, whole=150), Ops(19, 31, 1, 1, 4, whole=250)),
    # direction to the light, cosine, three weights, origin lifted and rounded; with a highlight
    "shadow": (Ops(32, 42, 12, 1, 12, whole=200), Ops(38, 52, 12, 1, 14, 1, 300)),
    # origin lifted and rounded, direction and weight packed; refracted, by Snell's law
    "ray": (Ops(27, 37, 12, compare=16, whole=250), Ops(34, 48, 12, 1, 20, whole=350)),
    # weights unpacked and multiplied
    "return": (Ops(0, 6, compare=3, whole=120), Ops(0, 9, compare=6, whole=200)),
    # the eye's ray of a sample again, where it enters the world box, in which cell that is
    "home": (Ops(26, 27, 7, 1, 11, whole=150), Ops(26, 27, 7, 1, 11, whole=300)),
    # the same, and an origin beside the ray: the nearest lattice point; the best of 16 of them, as our kernel does
    "primary": (Ops(60, 60, 14, 1, 30, whole=300), Ops(290, 280, 30, 1, 45, whole=700)),
    # three intensities made whole numbers and added
    "keep": (Ops(3, 3, compare=3, whole=60), Ops(3, 3, compare=6, whole=100)),
    "pixel": (Ops(whole=60), Ops(whole=120)),
    # the output chosen, the packet put into it
    "hand_on": (Ops(whole=20), Ops(whole=50)),
    # a description tested against the node's box and up to three branches: boxes apart; a triangle's edges, too
    "description": (Ops(compare=12, whole=60), Ops(54, 54, compare=80, whole=200)),
}


class Machine(NamedTuple):
    """A computer: clocks of each operation, and its links."""

    about: str
    hertz: int
    costs: dict[str, Triple]
    search: str
    moves: str
    bytes_per_second: int
    latency: tuple[int, int, int]
    moving_in: Triple = (0.0, 0.0, 0.0)  # clocks in which the processor takes 25 bytes in


I8086_IN = (13 * 30, 13 * 36 + 240, 13 * 42 + 500)  # 13 words of IN, STOSW, LOOP, and the interrupt that says so
MACHINES = {
    "8086": Machine(
        "Intel 8086 and 8087 at 5 MHz, the processor of the paper's estimates; it moves the bytes itself",
        5_000_000,
        {
            "add": (85, 105, 130),
            "mul": (138, 158, 180),
            "div": (198, 220, 245),
            "sqrt": (183, 190, 200),
            "compare": (60, 90, 120),
            "power": (1600, 1900, 2200),
            "whole": (6, 10, 15),
        },
        "list",
        "processor",
        260_000,
        (5, 10, 50),
        I8086_IN,
    ),
    "8086-soft": Machine(
        "Intel 8086 at 5 MHz without the 8087: floating point by software",
        5_000_000,
        {
            "add": (500, 2000, 8000),
            "mul": (800, 2700, 9200),
            "div": (1200, 4400, 16000),
            "sqrt": (2500, 15600, 98000),
            "compare": (150, 1000, 6500),
            "power": (8000, 26000, 85500),
            "whole": (6, 10, 15),
        },
        "list",
        "processor",
        260_000,
        (5, 10, 50),
        I8086_IN,
    ),
    "t800": Machine(
        "Inmos T800 transputer at 20 MHz with four links of 20 Mbit/s (six are assumed), which move the bytes themselves",
        20_000_000,
        {
            "add": (7, 10, 15),
            "mul": (11, 16, 28),
            "div": (17, 25, 40),
            "sqrt": (60, 130, 200),
            "compare": (5, 8, 12),
            "power": (300, 500, 900),
            "whole": (2, 3, 5),
        },
        "list",
        "link",
        1_740_000,
        (20, 40, 100),
        (20, 40, 60),
    ),
}
NAMES = {
    "unit": (
        "one tick for everything, for theory: a link takes one tick for a packet and one more for the way",
        1,
        "list",
        "link",
        25,
        (1, 1, 1),
    ),
    "modern": (
        "a core of a computer of the 2020s, as raygrid was measured (emulator/partition/cost_grid.py): nanoseconds; "
        "links of 10 Gbit/s",
        1_000_000_000,
        "tree",
        "link",
        1_250_000_000,
        (600, 1000, 2000),
    ),
}
MEASURED = {  # nanoseconds
    "packet": 20,
    "walk": 90,
    "box": 45,
    "triangle": 8,
    "smooth": 8,
    "polygon": 10,
    "sphere": 8,
    "cylinder": 20,
    "cone": 20,
    "hit": 120,
    "shadow": 60,
    "ray": 60,
    "return": 30,
    "home": 20,
    "primary": 180,
    "keep": 60,
    "pixel": 20,
    "hand_on": 80,
    "description": 200,
}
TESTS = ("triangle", "smooth", "polygon", "sphere", "cylinder", "cone")


def clocks(machine: Machine, work: str) -> tuple[int, int, int]:
    """Low: the fewest operations at their quickest. High: the most at their slowest. Middle: half way at the middle."""
    least, most = OPERATIONS[work]
    low, middle, high = (machine.moving_in[k] if work == "packet" else 0.0 for k in range(3))
    for name in Ops._fields:
        few, many = getattr(least, name), getattr(most, name)
        cost = machine.costs[name]
        low += few * cost[0]
        middle += (few + many) / 2 * cost[1]
        high += many * cost[2]
    return math.ceil(low), math.ceil(middle), math.ceil(high)


def text_of(
    head: tuple[str, int, str, str, int, tuple[int, int, int]], ticks: dict[str, tuple[int, int, int]], source: str
) -> str:
    """A cost model as TOML."""
    about, hertz, search, moves, rate, latency = head
    lines = [
        f"# {source}; see docs/costs.md",
        f'about = "{about}"',
        f"hertz = {hertz:_}  # ticks in a second",
        f'search = "{search}"  # of hits: list (test all that the cell holds) or tree (the hierarchy)',
        "",
        "[link]",
        f"bytes_per_second = {rate:_}",
        f"latency = {list(latency)}",
        f'moves = "{moves}"  # who moves the bytes: processor or link',
        "",
        "[ticks]  # low, middle, high",
        *[f"{name} = {list(value)}" for name, value in ticks.items() if name not in TESTS],
        "",
        "[ticks.test]",
        *[f"{name} = {list(ticks[name])}" for name in TESTS],
    ]
    return "\n".join(lines) + "\n"


def files() -> dict[str, str]:
    """Name of each file and what stands in it."""
    made = {}
    for name, m in MACHINES.items():
        head = (m.about, m.hertz, m.search, m.moves, m.bytes_per_second, m.latency)
        ticks = {work: clocks(m, work) for work in OPERATIONS}
        made[f"{name}.toml"] = text_of(head, ticks, "worked out by benchmarks/make_costs.py")
    made["unit.toml"] = text_of(NAMES["unit"], dict.fromkeys(OPERATIONS, (1, 1, 1)), "for theory")
    measured = {work: (math.ceil(0.6 * n), n, math.ceil(1.6 * n)) for work, n in MEASURED.items()}
    made["modern.toml"] = text_of(NAMES["modern"], measured, "measured, written by benchmarks/make_costs.py")
    return made


if __name__ == "__main__":
    for name, text in files().items():
        (HERE / name).write_text(text)
        print(HERE / name, file=sys.stdout)
