"""Describes the provenance of a pixel in the scene's own terms: a map ready for JSON, and lines for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from raygrid.emulator.analysis import Provenance, Ray, SampleTree
from raygrid.host.render.job import Job
from raygrid.host.scene.scene import light_kind
from raygrid.host.text.misuse import SceneMisuse
from raygrid.node.geometry import AnyKind
from raygrid.node.tracing import UNIT

VERSION = 1
Facts = dict[str, Any]  # docs/trace.md
SHADOW = "shadow"


def trace_pixel(job: Job, x: int, y: int, only: int | None = None) -> Facts:
    """The ray trees of the samples of a pixel, row 0 on top; `only`: of that sample (docs/trace.md).

    Raises SceneMisuse for a pixel or sample that is not there, ArrayError if the array contradicts itself.
    """
    _check_place(job, x, y, only)
    samples = Provenance(job.space, job.surfaces, job.frame).pixel(x, y, only)
    trees = _Trees(job)
    units = np.sum([sample.units for sample in samples], axis=0)
    return {
        "version": VERSION,
        "scene": job.scene.name,
        "frame": job.number,
        "frames": None if job.scene.shot is None else job.scene.shot.frames,
        "array": list(job.space.shape),
        "size": [job.frame.width, job.frame.height],
        "depth": job.frame.depth,
        "samples": job.frame.samples,
        "pixel": [x, y],
        "unit": int(UNIT),
        "sum": units.tolist(),
        "linear": (units / (UNIT * len(samples))).tolist(),
        "trees": [trees.sample(sample) for sample in samples],
    }


def _check_place(job: Job, x: int, y: int, only: int | None) -> None:
    frame = job.frame
    if not (0 <= x < frame.width and 0 <= y < frame.height):
        raise SceneMisuse(f"a pixel came as {x},{y}, wanted 0,0 to {frame.width - 1},{frame.height - 1}")
    if only is not None and not 0 <= only < frame.samples:
        raise SceneMisuse(f"a sample came as {only}, wanted 0 to {frame.samples - 1}")


class _Trees:
    """Turns trees in machine coordinates into maps in scene coordinates."""

    def __init__(self, job: Job) -> None:
        self._world, self._lights = job.world, job.scene.lights
        self._kinds: dict[int, AnyKind] = {}
        self._surfaces = job.surfaces

    def sample(self, sample: SampleTree) -> Facts:
        ray = None if sample.ray is None else self._ray(sample.ray)
        return {"sample": sample.number, "units": list(sample.units), "ray": ray}

    def _ray(self, ray: Ray) -> Facts:
        facts: Facts = {"kind": ray.kind.name.lower(), "depth": ray.depth}
        if ray.light is not None:
            facts["light"] = ray.light
            facts["light_kind"] = light_kind(self._lights[ray.light])
        if ray.inside:
            facts["total_internal_reflection"] = True
        facts |= {
            "weight": list(ray.weight),
            "origin": self._point(ray.origin),
            "direction": list(ray.direction),
            "born": list(ray.cells[0]),
            "cells": [list(cell) for cell in ray.cells[ray.start :]],
            "hit": None,
        }
        if ray.start:
            facts["handed_to_start"] = [list(cell) for cell in ray.cells[: ray.start]]
        if ray.met is not None:
            facts["hit"] = {
                "surface": ray.met.surface,
                "kind": self._kind(ray.met.surface).name.lower(),
                "material": ray.met.material,
                "point": self._point(ray.met.point),
                "distance": ray.met.distance / self._world.scale,
                "cell": list(ray.met.cell),
            }
        back = ray.came_back
        facts["returned"] = back and {
            "intensity": list(back.intensity),
            "units": list(back.units),
            "cells": [list(cell) for cell in back.cells],
            "home": list(back.cells[-1]),
        }
        facts["children"] = [self._ray(child) for child in ray.children]
        return facts

    def _point(self, point: tuple[float, float, float]) -> list[float]:
        """Machine coordinates as the scene's."""
        there: list[float] = (np.array(point) / self._world.scale + self._world.centre).tolist()
        return there

    def _kind(self, surface: int) -> AnyKind:
        if surface not in self._kinds:
            (kind,) = (batch.kind for batch in self._surfaces if np.any(batch.ids == surface))
            self._kinds[surface] = kind
        return self._kinds[surface]


# --- for people ----------------------------------------------------------------------------------


def headline(facts: Facts) -> str:
    """What was asked, and what all samples add up to."""
    x, y = facts["pixel"]
    width, height = facts["size"]
    shown, samples = len(facts["trees"]), facts["samples"]
    many = f"{samples} sample{'s' * (samples != 1)}" if shown == samples else f"{shown} of {samples} samples"
    frame = "" if facts["frame"] is None else f"frame {facts['frame']} of {facts['frames']}, "
    return (
        f"{frame}pixel {x},{y} of {width}x{height}, {many}, array {_cell(facts['array'], 'x')}: "
        f"linear {_three(facts['linear'])}, sum {' '.join(map(str, facts['sum']))}"
    )


def sample_line(tree: Facts) -> str:
    """One line on a sample."""
    adds = _three([units / UNIT for units in tree["units"]])
    missed = "" if tree["ray"] else ", its ray misses the world box: background"
    return f"sample {tree['sample']}: {adds}{missed}"


def ray_line(ray: Facts) -> str:
    """One line on a ray: what it is, where it went, how it ended, what came back."""
    what = f"{ray['kind']} ray, depth {ray['depth']}, weight {_three(ray['weight'])}"
    if "light" in ray:
        what = f"shadow ray to light {ray['light']} ({ray['light_kind']}), weight {_three(ray['weight'])}"
    if ray.get("total_internal_reflection"):
        what += ", total internal reflection"
    return f"{what}; {_way(ray)}; {_end(ray)}" + _back(ray)


def _way(ray: Facts) -> str:
    before = "".join(f"born in {_cell(cell)}, " for cell in ray.get("handed_to_start", [])[:1])
    return before + "cells " + " > ".join(_cell(cell) for cell in ray["cells"])


def _end(ray: Facts) -> str:
    hit, shadow = ray["hit"], ray["kind"] == SHADOW
    if hit is None:
        return "reached its light" if shadow else "left the world"
    return (
        f"{'blocked by' if shadow else 'hit'} {hit['kind']} {hit['surface']} (material {hit['material']}) "
        f"at {_three(hit['point'])}, distance {hit['distance']:.6g}"
    )


def _back(ray: Facts) -> str:
    back = ray["returned"]
    if back is None:
        return "" if ray["hit"] else "; nothing came back"
    way = " > ".join(_cell(cell) for cell in back["cells"])
    return f"; {_three(back['intensity'])} came back to {_cell(back['home'])}" + (
        f" by way of {way}" if len(back["cells"]) > 1 else ""
    )


def plain_lines(facts: Facts) -> Iterator[str]:
    """The whole tree as text, two blanks a level."""
    yield headline(facts)
    for tree in facts["trees"]:
        yield sample_line(tree)
        waiting = [(1, tree["ray"])] if tree["ray"] else []
        while waiting:
            level, ray = waiting.pop()
            yield "  " * level + ray_line(ray)
            waiting += [(level + 1, child) for child in reversed(ray["children"])]


def _cell(cell: list[int], between: str = ",") -> str:
    return between.join(map(str, cell))


def _three(values: list[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
