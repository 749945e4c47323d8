"""Writes the report of `raygrid law`: Markdown, plots and the data as CSV, in a folder."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from raygrid.host.image.outputs import write_whole
from raygrid.host.machine_time.cost_models import CostModel
from raygrid.host.machine_time.law_rivals import rivals_of
from raygrid.host.machine_time.law_rivals_report import PLOT, rival_rows, rivals_figure
from raygrid.host.machine_time.plots import new_figure, save_figure
from raygrid.host.machine_time.scaling_law import CONFIDENCE, KINDS, Fit, Point, law

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("scene", "kind", "n", "processors", "rays", "ticks", "seconds", "busy", "busiest", "hops", "law_seconds")
FORMULA = {"square": "A + B n + C R / n^2", "cubic": "A + B n + C R / n^3"}
Fits = dict[tuple[str, str], Fit]


def report_paths(folder: str, scenes: Sequence[str]) -> list[str]:
    """The files of a report: the table, the text, a plot of the laws side by side, and one for each scene."""
    names = ["law.csv", "law.md", PLOT, *(f"law_{Path(scene).stem}.png" for scene in dict.fromkeys(scenes))]
    return [str(Path(folder) / name) for name in names]


def write_report(folder: str, points: Sequence[Point], fits: Fits, cost: CostModel, command: str) -> list[str]:
    """Write law.csv, law.md and the plots; returns their paths. Raises OutputError."""
    scenes = list(dict.fromkeys(point.scene for point in points))
    paths = report_paths(folder, scenes)
    write_whole(paths[0], lambda file: file.writelines([_table(points, fits).encode()]))
    rivals = rivals_of(points)
    save_figure(rivals_figure(rivals), paths[2])
    for scene, path in zip(scenes, paths[3:], strict=True):
        save_figure(_figure(scene, {kind: fits[s, kind] for s, kind in fits if s == scene}), path)
    text = "\n".join(_report(scenes, points, fits, cost, command, rival_rows(rivals, len(scenes)))) + "\n"
    write_whole(paths[1], lambda file: file.writelines([text.encode()]))
    return paths


def _table(points: Sequence[Point], fits: Fits) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for p in points:
        guessed = float(fits[p.scene, p.kind].time(p.n, p.rays))
        row = (p.scene, p.kind, p.n, p.processors, p.rays, p.ticks, p.seconds, p.busy, p.busiest, p.hops, guessed)
        writer.writerow([f"{value:.6g}" if isinstance(value, float) else value for value in row])
    return text.getvalue()


def _report(
    scenes: list[str], points: Sequence[Point], fits: Fits, cost: CostModel, command: str, rivals: list[str]
) -> list[str]:
    rows = [
        "# The law",
        "",
        f"`{command}`",
        "",
        f"Machine time by the cost model {cost.name} ({cost.file.about}), middle costs. n is the edge of the array, R the",
        "number of primary rays. A, B and C are fitted by least squares of logarithmic residuals, log(T / law), and held at 0",
        f"or above; the bounds are those of {CONFIDENCE:.0%} confidence, as far as a law that is not exact can have them. R^2 is",
        "of log T, too. `off by`: the factor between T and the law, in the middle (the root of the mean of the squares) and at",
        "worst; `above`: how many frames took longer than the law has it. The free power is that of n in the third term if it",
        "is fitted, too: what the frames would rather have instead of 2 or 3.",
        "",
        *rivals,
        "",
        "## The law of 1983, scene by scene",
        "",
        "| scene | law | A, s | B, s | C, s a ray | R^2 of log T | off by: middle, worst | above | free power of n | frames |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (scene, kind), found in fits.items():
        a, b, c = (
            f"{v:.3g} ± {off:.2g}" if v > 0.0 else "0" for v, off in zip(found.values, found.bounds, strict=True)
        )
        middle, worst = np.exp([np.sqrt(np.mean(found.residuals**2)), np.abs(found.residuals).max()])
        power = "{:.2f} ({:.2f} to {:.2f})".format(*found.power)
        rows.append(
            f"| {scene} | {FORMULA[kind]} | {a} | {b} | {c} | {found.r2:.4f} | {middle:.2f}, {worst:.2f} "
            f"| {found.above} | {power} | {len(found.points)} |"
        )
    rows += ["", "## The best size", "", *_best(fits), "", "## Square against cubic", "", *_against(scenes, points)]
    for scene in scenes:
        rows += ["", f"## {scene}", "", f"![{scene}](law_{Path(scene).stem}.png)", "", *_points(scene, fits)]
    return rows


def _best(fits: Fits) -> list[str]:
    """Where the least time lies, simulated and by the law."""
    rows = [
        "The least of the simulated times, and where the law has its least. `inside`: it is neither the smallest nor the",
        "largest size that was simulated.",
        "",
        "| scene | array | rays | best n simulated | seconds | inside | best n by the law |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (scene, kind), found in fits.items():
        for rays in sorted({p.rays for p in found.points}):
            line = sorted((p for p in found.points if p.rays == rays), key=lambda p: p.n)
            best = min(line, key=lambda p: p.ticks)
            inside = "yes" if line[0].n < best.n < line[-1].n else "no"
            rows.append(
                f"| {scene} | {kind} | {rays:,} | {best.n} | {best.seconds:.4g} | {inside} | {_edge(found.best(rays))} |"
            )
    return rows


def _edge(n: float) -> str:
    return f"{n:.1f}" if np.isfinite(n) else "none"


def _against(scenes: list[str], points: Sequence[Point]) -> list[str]:
    """Where both kinds were simulated with the same number of processors and rays."""
    by = {(p.scene, p.kind, p.processors, p.rays): p for p in points}
    rows = [
        "At equal numbers of processors.",
        "",
        "| scene | processors | rays | square, s | cubic, s | cubic / square |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for (scene, kind, processors, rays), square in by.items():
        cubic = by.get((scene, "cubic", processors, rays))
        if kind == "square" and cubic is not None and processors > 1:
            rows.append(
                f"| {scene} | {processors} | {rays:,} | {square.seconds:.4g} | {cubic.seconds:.4g} "
                f"| {cubic.ticks / square.ticks:.2f} |"
            )
    return rows


def _points(scene: str, fits: Fits) -> list[str]:
    rows = [
        "| array | rays | seconds | law | seconds / law | efficiency | busy | busiest |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (of, kind), found in fits.items():
        if of != scene:
            continue
        for point, residual in zip(found.points, found.residuals, strict=True):
            rows.append(
                f"| {'x'.join(map(str, point.shape))} ({kind}) | {point.rays:,} | {point.seconds:.4g} "
                f"| {float(found.time(point.n, point.rays)):.4g} | {np.exp(residual):.2f} "
                f"| {_efficiency(point, found.points)} | {point.busy:.1%} | {point.busiest:.1%} |"
            )
    return rows


def _efficiency(point: Point, points: Sequence[Point]) -> str:
    """Time of one processor over processors times time; "-" if one processor was not simulated."""
    alone = [p for p in points if p.n == 1 and p.rays == point.rays]
    return f"{alone[0].ticks / (point.processors * point.ticks):.1%}" if alone else "-"


def _figure(scene: str, fits: dict[str, Fit]) -> Figure:
    """T against n with the fit; its three terms; square against cubic and efficiency over processors."""
    figure = new_figure(11, 8)
    axes = figure.subplots(2, 2)
    for kind, found in fits.items():
        ns = np.geomspace(1, max(p.n for p in found.points), 200)
        axis = axes[0, 0 if kind == "square" else 1]
        for rays in sorted({p.rays for p in found.points}):
            line = [p for p in found.points if p.rays == rays]
            (mark,) = axis.plot([p.n for p in line], [p.seconds for p in line], "o", label=f"{rays:,} rays")
            axis.plot(ns, found.time(ns, rays), color=mark.get_color(), linewidth=0.9)
            counts = [p.processors for p in line]
            style = "o-" if kind == "square" else "s--"
            axes[1, 0].plot(counts, [p.seconds for p in line], style, label=f"{kind}, {rays:,} rays", linewidth=0.8)
            alone = [p.ticks for p in line if p.n == 1]
            if alone:
                shares = [alone[0] / (p.processors * p.ticks) for p in line]
                axes[1, 1].plot(counts, shares, style, label=f"{kind}, {rays:,} rays", linewidth=0.8)
        most = max(p.rays for p in found.points)
        for name, term in zip("ABC", found.values * np.eye(3), strict=True):
            curve = law(KINDS[kind], ns, most) @ term
            if term.any():
                axis.plot(ns, curve, ":", color="grey", linewidth=0.8)
                axis.annotate(name, (ns[-1], float(curve[-1])), fontsize=8, color="grey")
        axis.set_title(f"{kind}: T = {FORMULA[kind]} (dotted: the terms for {most:,} rays)", fontsize=9)
        axis.set_xlabel("n")
    axes[1, 0].set_title("square and cubic", fontsize=9)
    axes[1, 1].set_title("efficiency: T(1) / (processors T)", fontsize=9)
    for axis in axes.flat:
        axis.set_xscale("log", base=2)
        axis.set_yscale("log")
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_formatter("{x:g}")  # 16 and not 2^4, 0.1 and not 10^-1
        axis.legend(fontsize=7)
    for axis in axes.flat[:3]:
        axis.set_ylabel("machine seconds")
    lowest = min(p.seconds for found in fits.values() for p in found.points)
    for axis in axes[0]:
        axis.set_ylim(bottom=lowest / 10)
    for axis in axes[1]:
        axis.set_xlabel("processors")
    figure.suptitle(scene)
    return figure


assert set(KINDS) == set(FORMULA)
