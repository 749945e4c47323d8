"""Writes what `raygrid law` says of the three laws side by side: rows of Markdown, and a plot of what each is off by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from raygrid.host.machine_time.law_rivals import LEAST_POINTS, RIVALS, Errors, RivalFit, has_few_rays
from raygrid.host.machine_time.plots import new_figure
from raygrid.host.machine_time.prediction_law import FEW_RAYS
from raygrid.host.machine_time.scaling_law import KINDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLOT = "law_rivals.png"


def rival_rows(fits: Sequence[RivalFit], scenes: int) -> list[str]:
    """The section of the report."""
    rows = [
        "## Three laws side by side",
        "",
        "W is the time that the busiest processor works, I its work by that of the mean one. Each law has three numbers, fitted",
        "to all scenes together by least squares of log(T / law). `out of sample`: each scene is told by the fit to the others.",
        f"Frames with fewer than {FEW_RAYS:g} primary rays a processor are not fitted, and are told apart by the same fit. Errors",
        "are factors less 1: 10 % is a time of 1.1 or 1 / 1.1 of what the law has.",
        "",
        f"| law, k | frames | R^2 of log T | in sample: {HEAD} | out of sample: {HEAD} | few rays: frames; {HEAD} |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for fit in fits:
        few = "-" if fit.few is None else f"{fit.few.frames}; {_errors(fit.few)}"
        rows.append(
            f"| {fit.name}: {RIVALS[fit.name][0]}, {KINDS[fit.kind]} ({fit.kind}) | {fit.inside.frames} | {fit.r2:.4f} "
            f"| {_errors(fit.inside)} | {_errors(fit.outside)} | {few} |"
        )
    if not fits:
        rows.append(f"| none: too few frames with {FEW_RAYS:g} rays a processor | | | | | |")
    if scenes == 1:
        rows += ["", "With a single scene there is nothing out of sample: name more of them."]
    for fit in fits:
        if fit.name == "busiest":
            alone, every = int((~fit.by_others).sum()), len(fit.frames)
            if alone and scenes > 1:
                why = f"the other scenes have fewer than the {LEAST_POINTS} frames that a law is fitted to"
                rows += ["", f"{fit.kind}: {alone} of {every} frames are not told out of sample: {why}."]
            share, latency, a_step = fit.values
            rows += ["", f"{fit.kind}: T = {share:.4f} W + {latency:.3g} s + {a_step:.3g} s n."]
    return [*rows, "", f"![what each law is off by]({PLOT})"]


HEAD = "median, 95 % within, worst"


def _errors(errors: Errors | None) -> str:
    if errors is None:
        return "-"
    return ", ".join(_part(part) for part in (errors.median, errors.most_of, errors.worst))


def _part(part: float) -> str:
    return f"{part:.1%}" if part < 10.0 else f"{part + 1.0:.0f} times"


def rivals_figure(fits: Sequence[RivalFit]) -> Figure:
    """T by each law over T, against rays a processor; frames with few rays are hollow."""
    names = list(dict.fromkeys(fit.name for fit in fits)) or list(RIVALS)
    figure = new_figure(4.2 * len(names), 4.2)
    axes = figure.subplots(1, len(names), squeeze=False, sharex=True, sharey=True)
    for axis, name in zip(axes.flat, names, strict=True):
        for fit in fits:
            if fit.name != name:
                continue
            few = np.array([has_few_rays(point) for point in fit.frames])
            rays = np.array([point.rays / point.processors for point in fit.frames])
            ratio = np.maximum(fit.told, 1e-300) / [point.seconds for point in fit.frames]
            mark, colour = ("s", "tab:blue") if fit.kind == "square" else ("o", "tab:orange")
            axis.plot(rays[~few], ratio[~few], mark, color=colour, markersize=4, label=fit.kind)
            axis.plot(rays[few], ratio[few], mark, color=colour, markersize=4, fillstyle="none")
        axis.axhline(1.0, color="grey", linewidth=0.8)
        axis.axvline(FEW_RAYS, color="grey", linewidth=0.8, linestyle=":")
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_title(f"{name}: T = {RIVALS[name][0]}", fontsize=9)
        axis.set_xlabel("primary rays a processor")
        if axis.lines[2:]:
            axis.legend(fontsize=8)
    axes.flat[0].set_ylabel("T by the law / T simulated")
    told = "each scene told by the fit to the others"
    if fits and not any(fit.by_others.any() for fit in fits):
        told = "told by the fit to all"
    elif not all(fit.by_others.all() for fit in fits):
        told += f", by the fit to all where these have fewer than {LEAST_POINTS} frames"
    figure.suptitle(f"{told}; hollow: few rays, not fitted", fontsize=9)
    return figure
