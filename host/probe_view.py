"""Probes on a terminal: a table of the nodes and a heat map of each layer of the array."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raygrid.host.probe_sums import Gauges, NodeState

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

MOST_ROWS = 16  # of the table: the busiest nodes
SHADES = ".:-=+*#%@"  # from idle to busy; colours are added where there are any
COLOURS = ("grey30", "blue", "cyan", "green", "yellow", "dark_orange", "red")
LEAST_BUSY = 0.02  # share of a processor below which nobody counts as busy, and maps are empty


def view(gauges: Gauges) -> RenderableType:
    """All that is to be seen at one moment."""
    from rich.console import Group
    from rich.text import Text

    busiest = f"{SHADES[-1]} ({_busiest(gauges):.2f})"
    legend = f"busy: part of a processor's wall time; maps: from idle {SHADES[0]} to the busiest {busiest}"
    return Group(Text(summary(gauges)), node_table(gauges), heat_maps(gauges), Text(legend, "dim"))


def summary(gauges: Gauges) -> str:
    """One line on the whole array."""
    total, many = gauges.totals(), gauges.shape[0] * gauges.shape[1] * gauges.shape[2]
    return (
        f"{'x'.join(map(str, gauges.shape))}: {len(gauges)} of {many} nodes, {gauges.phase}; "
        f"busy {total['busy']:.2f} processors, {_short(total['rate'])} packets/s, {_short(total['held'])} held, "
        f"{_short(total['pss'])}B memory (PSS), {_short(total['bytes'])}B sent"
    )


def node_table(gauges: Gauges) -> RenderableType:
    """The busiest nodes, in order of their places."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("node", "phase", "busy", "packets/s", "returns", "shadows", "rays", "unsent", "surfaces", "PSS"):
        table.add_column(name, justify="left" if name in ("node", "phase") else "right", no_wrap=True)
    busiest = sorted(gauges, key=lambda state: (-state.busy, state.sample.node[::-1]))[:MOST_ROWS]
    for state in sorted(busiest, key=lambda state: state.sample.node[::-1]):
        table.add_row(*_row(state))
    if len(gauges) > MOST_ROWS:
        table.caption = f"the {MOST_ROWS} busiest of {len(gauges)} nodes"
        table.caption_justify = "left"
    return table


def _row(state: NodeState) -> tuple[str, ...]:
    sample = state.sample
    return (
        ",".join(map(str, sample.node)),
        sample.phase,
        f"{state.busy:.2f}",
        _short(state.rate),
        *(_short(sample.queues[name]) for name in ("travellers", "shadows", "rays")),
        _short(sum(sample.outputs.values()) + sum(link.waiting for link in sample.links.values())),
        _short(sample.surfaces),
        _short(sample.memory["pss"]) + "B",
    )


def _busiest(gauges: Gauges) -> float:
    return max((state.busy for state in gauges), default=0.0)


def heat_maps(gauges: Gauges) -> RenderableType:
    """Busy nodes against the busiest, a map for each layer (z), beside each other; x runs to the right, y upwards."""
    from rich.columns import Columns

    return Columns([_layer(gauges, z) for z in range(gauges.shape[2])], padding=(0, 3))


def _layer(gauges: Gauges, z: int) -> Text:
    from rich.text import Text

    nx, ny, _ = gauges.shape
    most = max(_busiest(gauges), LEAST_BUSY)
    text = Text(f"z={z}")
    for y in reversed(range(ny)):
        text.append("\n")
        for x in range(nx):
            state = gauges.get((x, y, z))
            if state is None:
                text.append("??")
                continue
            shade = SHADES[min(len(SHADES) - 1, int(state.busy / most * len(SHADES)))]
            colour = COLOURS[min(len(COLOURS) - 1, int(state.busy / most * len(COLOURS)))]
            text.append(shade * 2, f"on {colour}")
    return text


def _short(value: float) -> str:
    """1234567 as 1.23M."""
    for size, letter in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"
