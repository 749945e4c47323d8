"""Draws docs/architecture.svg: the packages and what they import, read from the sources. `make picture`

An arrow means "imports". One that only shortens a longer way of arrows is left out, as are those to `node.errors`,
`node.faces` and `node.remarks`, which everything may import. Where a box stands is said here by hand; the arrows come from
the imports, so a package or an import that is new either fits in or is named as lacking a place. The same sources give the
same bytes.
"""

from __future__ import annotations

import argparse
import sys
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.modules import Edge, Modules, edges, reached, read_modules  # noqa: E402

PICTURE = ROOT / "docs" / "architecture.svg"
WIDTH, HEIGHT = 1440, 822
BOX_WIDTH, BOX_HEIGHT = 130, 50
LEFT, PITCH = 36, 151.75  # of a column
FOR_ALL = ("node.errors", "node.faces", "node.remarks")  # arrows to them would only hide the others

BANDS = {  # layer -> (top, height, what it is)
    "host": (58, 262, "the front end"),
    "emulator": (348, 190, "the array"),
    "node": (566, 204, "one processor"),
}
PLACES = {  # package -> (column, its middle below the top of the band, what it holds)
    "host.text": (0, 220, "words for people"),
    "host.files": (1, 220, "whole or not at all"),
    "host.image": (2, 138, "pictures, films"),
    "host.scene": (2.9, 220, "formats, animation"),
    "host.render": (3.85, 186, "jobs, retry, Python"),
    "host.client": (4.55, 64, "protocol of clients"),
    "host.machine_time": (5.6, 214, "costs, the law"),
    "host.export": (5.6, 138, "for POV-Ray"),
    "host.journal": (5.6, 64, "jobs that last"),
    "host.probes": (6.78, 138, "record, figures"),
    "host.service": (6.78, 64, "an array that stays"),
    "host.cli": (8, 138, "the commands"),
    "host.facade": (8, 64, "import raygrid"),
    "emulator.partition": (3.52, 142, "planes between cells"),
    "emulator.topology": (4.55, 142, "wiring, bounds"),
    "emulator.driver": (6.2, 142, "load, trace, collect"),
    "emulator.processes": (5.4, 62, "fork server, nodes"),
    "emulator.simulator": (6.9, 62, "all in one process"),
    "emulator.analysis": (8, 62, "ray trees, deadlock"),
    "node.faces": (0, 58, "what packages give"),
    "node.errors": (0, 117, "what is raised"),
    "node.remarks": (0, 176, "what is remarked"),
    "node.jit": (1, 117, "compiled kernels"),
    "node.geometry": (2, 117, "space, surfaces, hits"),
    "node.protocol": (3, 117, "every byte sent"),
    "node.tracing": (4, 72, "the ray step"),
    "node.links": (4.5, 162, "between neighbours"),
    "node.programs": (5, 72, "code that is loaded"),
    "node.runtime": (6, 117, "a living node"),
    "node.timed": (7, 117, "machine time"),
    "node.main": (8, 117, "its process"),
}
# Points in columns and pixels that an arrow goes through, where it would pass behind a box.
WAYS: dict[Edge, list[tuple[float, float]]] = {
    ("host.image", "node.tracing"): [(2, 480)],
    ("host.service", "host.render"): [(6.1, 159)],
    ("host.probes", "host.client"): [(5.6, 159)],
    ("host.cli", "host.journal"): [(6.78, 159)],
    ("host.cli", "host.export"): [(6.78, 231)],
    ("host.cli", "host.machine_time"): [(6.78, 242)],
    ("host.probes", "emulator.driver"): [(6.2, 400)],
    ("emulator.processes", "emulator.partition"): [(4.15, 450)],
    ("emulator.analysis", "emulator.driver"): [(7.3, 452)],
}
STYLE = """
text { font-family: "Helvetica Neue", Helvetica, Arial, sans-serif; fill: #1f2933; }
.paper { fill: #ffffff; }
.title { font-size: 21px; font-weight: 600; }
.band text { font-size: 17px; font-weight: 600; }
.band .what, .note { font-size: 13px; font-weight: 400; fill: #52606d; }
.box text { font-size: 14.5px; font-weight: 600; text-anchor: middle; }
.box .what { font-size: 11.5px; font-weight: 400; fill: #3e4c59; }
.box rect { stroke-width: 1.4; }
.band rect { stroke: none; }
path { fill: none; stroke-width: 1.6; }
.host .band rect { fill: #fdf3e3; } .host .box rect { fill: #ffe0a8; stroke: #b7791f; }
.emulator .band rect { fill: #e8f5ec; } .emulator .box rect { fill: #bfe5cb; stroke: #2f855a; }
.node .band rect { fill: #e8f0fb; } .node .box rect { fill: #bcd6f7; stroke: #2b6cb0; }
path.host { stroke: #b7791f; } path.emulator { stroke: #2f855a; } path.node { stroke: #2b6cb0; }
marker path { stroke: none; }
#to-host path { fill: #b7791f; } #to-emulator path { fill: #2f855a; } #to-node path { fill: #2b6cb0; }
@media (prefers-color-scheme: dark) {
  text { fill: #f0f4f8; }
  .paper { fill: #151b23; }
  .band .what, .note, .box .what { fill: #cbd2d9; }
  .host .band rect { fill: #2b2417; } .host .box rect { fill: #5c4413; stroke: #e0a83f; }
  .emulator .band rect { fill: #17281d; } .emulator .box rect { fill: #1f5135; stroke: #58b27d; }
  .node .band rect { fill: #172333; } .node .box rect { fill: #1e4573; stroke: #63a0e4; }
  path.host { stroke: #e0a83f; } path.emulator { stroke: #58b27d; } path.node { stroke: #63a0e4; }
  #to-host path { fill: #e0a83f; } #to-emulator path { fill: #58b27d; } #to-node path { fill: #63a0e4; }
}
"""


def package(name: str) -> str:
    """The package right below the layer, in which a module lives."""
    return ".".join(name.split(".")[:2])


def arrows(modules: Modules) -> list[Edge]:
    """Imports between packages, without those that a longer way of imports implies."""
    all_edges = {(package(a), package(b)) for a, b in edges(modules)}
    after: dict[str, set[str]] = {}
    for a, b in all_edges:
        if a != b and b not in FOR_ALL and "." in a and "." in b:
            after.setdefault(a, set()).add(b)
    return sorted((a, b) for a in after for b in after[a] if not any(b in reached(c, after) for c in after[a] - {b}))


def middle(name: str) -> tuple[float, float]:
    column, below, _ = PLACES[name]
    return LEFT + 12 + column * PITCH + BOX_WIDTH / 2, BANDS[name.partition(".")[0]][0] + below


def way(edge: Edge) -> str:
    """The curve of an arrow: sideways to a box on its left, downwards to one below."""
    (ax, ay), (bx, by) = (middle(name) for name in edge)
    points = [(LEFT + 12 + column * PITCH + BOX_WIDTH / 2, y) for column, y in WAYS.get(edge, [])]
    sideways = edge[0].partition(".")[0] == edge[1].partition(".")[0] and abs(ax - bx) > BOX_WIDTH
    if sideways:
        start, end = (ax - BOX_WIDTH / 2, ay), (bx + BOX_WIDTH / 2 + 3, by)
    else:
        start, end = (ax, ay + BOX_HEIGHT / 2), (bx, by - BOX_HEIGHT / 2 - 3)
    stops = [start, *points, end]
    parts = [f"M{start[0]:.0f} {start[1]:.0f}"]
    for (x0, y0), (x1, y1) in pairwise(stops):
        if sideways:
            half = (x0 - x1) / 2
            parts.append(f"C{x0 - half:.0f} {y0:.0f} {x1 + half:.0f} {y1:.0f} {x1:.0f} {y1:.0f}")
        else:
            half = (y1 - y0) / 2
            parts.append(f"C{x0:.0f} {y0 + half:.0f} {x1:.0f} {y1 - half:.0f} {x1:.0f} {y1:.0f}")
    return "".join(parts)


def draw(modules: Modules) -> str:
    """The picture. Raises ValueError if a package has no place, or a place no package."""
    packages = {package(name) for name in modules if "." in name}
    if packages != set(PLACES):
        raise ValueError(f"PLACES of docs/make_picture.py and packages differ: {sorted(packages ^ set(PLACES))}")
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">',
        "<title>The packages of raygrid and what they import</title>",
        f"<style>{STYLE}</style>",
        "<defs>",
    ]
    lines += [
        f'<marker id="to-{layer}" viewBox="0 0 8 8" refX="5" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto" markerUnits="userSpaceOnUse"><path d="M0 0L8 4L0 8z"/></marker>'
        for layer in BANDS
    ]
    lines += ["</defs>", f'<rect class="paper" width="{WIDTH}" height="{HEIGHT}" rx="14"/>']
    lines.append(f'<text class="title" x="{LEFT}" y="38">raygrid: the packages, and what they import</text>')
    for layer, (top, height, what) in BANDS.items():
        lines.append(f'<g class="{layer}"><g class="band">')
        lines.append(f'<rect x="{LEFT - 12}" y="{top}" width="{WIDTH - 2 * LEFT + 24}" height="{height}" rx="12"/>')
        lines.append(
            f'<text x="{LEFT + 4}" y="{top + 27}">{layer}/ <tspan class="what" dx="4">{what}</tspan></text></g></g>'
        )
    for a, b in arrows(modules):
        layer = a.partition(".")[0]
        lines.append(f'<path class="{layer}" d="{way((a, b))}" marker-end="url(#to-{layer})"/>')
    for name, (_, _, what) in PLACES.items():
        x, y = middle(name)
        lines.append(f'<g class="{name.partition(".")[0]}"><g class="box">')
        left, top = x - BOX_WIDTH / 2, y - BOX_HEIGHT / 2
        lines.append(f'<rect x="{left:.0f}" y="{top:.0f}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="7"/>')
        lines.append(f'<text x="{x:.0f}" y="{y - 3:.0f}">{name.partition(".")[2]}</text>')
        lines.append(f'<text class="what" x="{x:.0f}" y="{y + 15:.0f}">{what}</text></g></g>')
    note = (
        "An arrow means: imports. Left out are arrows that a longer way of arrows implies, and those to faces, errors and "
        "remarks, which all may import."
    )
    lines += [f'<text class="note" x="{LEFT}" y="{HEIGHT - 22}">{note}</text>', "</svg>", ""]
    return "\n".join(lines)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Draw docs/architecture.svg from the imports of the sources.")
    parser.add_argument("--check", action="store_true", help="only say whether it is out of date (exit code 1)")
    options = parser.parse_args(words)
    picture = draw(read_modules(ROOT))
    if options.check:
        return int(not PICTURE.is_file() or PICTURE.read_text() != picture)
    PICTURE.write_text(picture)
    print(f"the picture is {PICTURE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
