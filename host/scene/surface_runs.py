"""Says which numbers of surfaces are what: of which kind, material and group. For those who read layers of a picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.scene import Scene
from raygrid.node.geometry import SURFACE_KINDS

LOOKS = ("diffuse", "specular", "transmission")  # of a material


def surface_runs(scene: Scene, seen: NDArray[np.integer]) -> dict[str, list[dict[str, Any]]]:
    """Describe the surfaces and materials that are seen, ready for JSON.

    seen  numbers of surfaces, ascending; -1, which is none, may be among them

    surfaces   runs of numbers from "first" to "last" that have one "kind", "material" and "group" (None for none); those of
               which at least one number is seen
    materials  "number", "name" in the file ("" for none) and linear colours of those that these surfaces have
    """
    ids, kinds, materials = _columns(scene)
    groups = np.full(len(ids), -1, np.int64) if scene.shot is None else scene.shot.groups.of(ids)
    facts = np.stack((kinds, materials, groups), axis=1)
    begins = np.concatenate(([0], np.flatnonzero((np.diff(facts, axis=0) != 0).any(axis=1)) + 1))
    lasts = np.append(ids[begins[1:] - 1], ids[-1])
    shown = np.unique(np.searchsorted(ids[begins], seen[seen >= 0], side="right") - 1)
    runs = [
        {
            "first": int(ids[begins[run]]),
            "last": int(lasts[run]),
            "kind": SURFACE_KINDS[kinds[begins[run]]].name.lower(),
            "material": int(materials[begins[run]]),
            "group": None if groups[begins[run]] < 0 or scene.shot is None else scene.shot.names[groups[begins[run]]],
        }
        for run in shown.tolist()
    ]
    rows = sorted({run["material"] for run in runs})
    names = scene.material_names or ("",) * len(scene.materials)
    looks = [
        {"number": row, "name": names[row]} | {look: scene.materials[row][look].tolist() for look in LOOKS}
        for row in rows
    ]
    return {"surfaces": runs, "materials": looks}


def _columns(scene: Scene) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """(numbers, kinds, materials) of all surfaces, by ascending numbers."""
    ids = np.concatenate([batch.ids for batch in scene.surfaces]).astype(np.int64)
    kinds = np.concatenate([np.full(len(batch), SURFACE_KINDS.index(batch.kind), np.int64) for batch in scene.surfaces])
    materials = np.concatenate([batch.materials for batch in scene.surfaces]).astype(np.int64)
    order = np.argsort(ids)
    return ids[order], kinds[order], materials[order]
