"""Draws probes on a terminal: a heat map of each layer of the array, and a table of the busiest nodes, as both fit.

The maps' scale is one and the same whatever the array does, so an idle array is blank; it is finer below, since many nodes
share a processor of this computer.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from raygrid.host.probes.sums import Gauges, NodeFigures

MOST_ROWS = 16  # of the table: the busiest nodes
LEAST_ROWS = 3  # of the table, before maps are made smaller
WIDTH, HEIGHT = 120, 1000  # where there is no terminal
SHADES = " .:-=+*#%@"
# shares of a processor from which each shade but the first is
FROM = (0.02, 0.04, 0.06, 0.1, 0.15, 0.25, 0.4, 0.6, 0.8)
COLOURS = ("", "grey30", "grey42", "blue", "dark_cyan", "green", "yellow4", "dark_orange", "red3", "red")
UNKNOWN = "?"
GAP = 3  # blanks between maps
# name, width, and which goes first where a terminal is too narrow for all
COLUMNS = (
    ("node", 8, 9),
    ("phase", 7, 0),
    ("busy", 4, 9),
    ("packets/s", 9, 5),
    ("returns", 7, 3),
    ("shadows", 7, 4),
    ("rays", 6, 6),
    ("unsent", 6, 2),
    ("surfaces", 8, 1),
    ("PSS", 7, 7),
)


def view(gauges: Gauges, width: int = WIDTH, height: int = HEIGHT, head: str | None = None) -> RenderableType:
    """All that is to be seen at one moment, in so many columns and lines. head: a line before all else."""
    lines = [*([] if head is None else [head]), *summary(gauges)]
    text = [Text(line, no_wrap=True, overflow="ellipsis") for line in lines]
    room = height - len(text) - 2 - 2  # the scale and the axes; the table's names and what it lacks
    maps, legend = heat_maps(gauges, width, room - LEAST_ROWS)
    rows = min(MOST_ROWS, max(LEAST_ROWS, room - len(maps)))
    below = [Text(line, "dim", no_wrap=True, overflow="ellipsis") for line in (scale(width), legend)]
    return Group(*text, *maps, *below, node_table(gauges, width, rows))


def summary(gauges: Gauges) -> tuple[str, str]:
    """Two lines on the whole array."""
    total, many = gauges.totals(), gauges.shape[0] * gauges.shape[1] * gauges.shape[2]
    return (
        f"{'x'.join(map(str, gauges.shape))}: {len(gauges)} of {many} nodes, {gauges.phase}; "
        f"busy {total['busy']:.2f} processors",
        f"{short(total['rate'])} packets/s, {short(total['held'])} held, "
        f"{short(total['pss'])}B memory (PSS), {short(total['bytes'])}B sent",
    )


# --- the table ----------------------------------------------------------------------------------------


def node_table(gauges: Gauges, width: int = WIDTH, rows: int = MOST_ROWS) -> RenderableType:
    """The busiest nodes, the busiest first."""
    shown = _columns(width)
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for name in shown:
        table.add_column(name, justify="left" if name in ("node", "phase") else "right", no_wrap=True)
    busiest = sorted(gauges, key=lambda state: (-state.busy, state.sample.node[::-1]))[:rows]
    for state in busiest:
        row = _row(state)
        table.add_row(*(row[name] for name in shown))
    if len(gauges) > rows:
        table.caption = f"the {rows} busiest of {len(gauges)} nodes"
        table.caption_justify = "left"
    return table


def _columns(width: int) -> list[str]:
    """The names of the columns that fit."""
    kept = list(COLUMNS)
    while len(kept) > 1 and sum(column[1] + 1 for column in kept) - 1 > width:
        kept.remove(min(kept, key=lambda column: column[2]))
    return [name for name, _, _ in kept]


def _row(state: NodeFigures) -> dict[str, str]:
    sample = state.sample
    return {
        "node": ",".join(map(str, sample.node)),
        "phase": sample.phase,
        "busy": f"{state.busy:.2f}",
        "packets/s": short(state.rate),
        "returns": short(sample.queues["travellers"]),
        "shadows": short(sample.queues["shadows"]),
        "rays": short(sample.queues["rays"]),
        "unsent": short(sum(sample.outputs.values()) + sum(link.waiting for link in sample.links.values())),
        "surfaces": short(sample.surfaces),
        "PSS": short(sample.memory["pss"]) + "B",
    }


# --- the maps -----------------------------------------------------------------------------------------


def level(busy: float) -> int:
    """The number of the shade of a share of a processor."""
    return bisect_right(FROM, busy)


def scale(width: int = WIDTH) -> str:
    """What the shades mean: the share of a processor from which each is."""
    steps = [(f"{share:g}".lstrip("0"), shade) for share, shade in zip(FROM, SHADES[1:], strict=True)]
    full = "busy, of a processor: blank, " + " ".join(f"{share} {shade}" for share, shade in steps)
    return full if len(full) <= width else "busy: " + " ".join(share + shade for share, shade in steps)


def heat_maps(gauges: Gauges, width: int = WIDTH, height: int = HEIGHT) -> tuple[list[Text], str]:
    """(lines, what they are): a map for each layer z, beside and below each other, x to the right and y upwards.

    Where they do not fit, a place of a map stands for several nodes, the busiest of which it shows; and if that does not
    suffice, only the layers with the busiest nodes are there.
    """
    nx, ny, nz = gauges.shape
    several, cell, down = 1, 2, height + 1
    while True:
        columns, rows = -(-nx // several), -(-ny // several)
        gutter = len(str(ny - 1)) + 2
        across = max(1, (width + GAP) // (gutter + columns * cell + GAP))
        fits = gutter + columns * cell <= width
        down = -(-nz // across) * (rows + 2)
        if fits and (down <= height or (several > 1 and rows + 2 <= height) or rows <= 4):
            break
        several, cell = (several, 1) if cell == 2 else (several + 1, 1)
        if several > max(nx, ny):
            break
    layers = _busiest_layers(gauges, across * max(1, height // (rows + 2)))
    lines: list[Text] = []
    for first in range(0, len(layers), across):
        blocks = [_Layer(gauges, z, several, cell).lines() for z in layers[first : first + across]]
        lines += [_beside(parts) for parts in zip(*blocks, strict=True)]
    legend = "x to the right, y upwards" if several == 1 else f"x right, y up; busiest of {several}x{several} nodes"
    if len(layers) < nz:
        legend += f"; {len(layers)} busiest of {nz} layers"
    return lines, legend


def _busiest_layers(gauges: Gauges, most: int) -> list[int]:
    """So many layers, those of the busiest nodes, in order."""
    nz = gauges.shape[2]
    if nz <= most:
        return list(range(nz))
    busy = [0.0] * nz
    for state in gauges:
        z = state.sample.node[2]
        busy[z] = max(busy[z], state.busy)
    return sorted(sorted(range(nz), key=lambda z: (-busy[z], z))[:most])


def _beside(parts: Sequence[Text]) -> Text:
    line = Text(no_wrap=True)
    for number, part in enumerate(parts):
        line.append(" " * GAP if number else "")
        line.append_text(part)
    return line


class _Layer:
    """The map of a layer: a head, rows with y before them, and x below, all equally wide."""

    def __init__(self, gauges: Gauges, z: int, several: int, cell: int) -> None:
        self._gauges, self._z, self._several, self._cell = gauges, z, several, cell
        self._columns, self._rows = (-(-side // several) for side in gauges.shape[:2])
        self._gutter = len(str(gauges.shape[1] - 1)) + 1

    def lines(self) -> list[Text]:
        """All of it."""
        wide = self._gutter + 1 + self._columns * self._cell
        head = Text(f"z={self._z}"[:wide].ljust(wide))
        return [head, *(self._row(y) for y in reversed(range(self._rows))), Text(self._below().ljust(wide), "dim")]

    def _row(self, y: int) -> Text:
        line = Text()
        line.append(f"{y * self._several}|".rjust(self._gutter + 1), "dim")
        for x in range(self._columns):
            busy = self._busiest(x, y)
            shade = 0 if busy is None else level(busy)
            text = UNKNOWN if busy is None else SHADES[shade]
            colour = COLOURS[shade]
            line.append(text * self._cell, f"on {colour}" if colour else "")
        return line

    def _below(self) -> str:
        """Where x is what: of each place if there is room, else of the first and the last."""
        first = "x".rjust(self._gutter) + " "
        numbers = [str(x * self._several) for x in range(self._columns)]
        if max(map(len, numbers)) < self._cell:
            return first + "".join(number.ljust(self._cell) for number in numbers)
        room = self._columns * self._cell - len(numbers[0])
        return first + (numbers[0] + numbers[-1].rjust(room) if len(numbers[-1]) < room else numbers[0])

    def _busiest(self, x: int, y: int) -> float | None:
        """Of the nodes of a place; None if none of them has told yet."""
        several, (nx, ny, _) = self._several, self._gauges.shape
        states = (
            self._gauges.get((i, j, self._z))
            for j in range(y * several, min(ny, (y + 1) * several))
            for i in range(x * several, min(nx, (x + 1) * several))
        )
        return max((state.busy for state in states if state is not None), default=None)


def short(value: float) -> str:
    """1234567 as 1.23M."""
    for size, letter in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"
