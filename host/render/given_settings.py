"""Names the settings of a render that callers may give. Light to import."""

from __future__ import annotations

from typing import TypedDict


class GivenSettings(TypedDict, total=False):
    """Settings by keyword; left out or None: what the scene's file asks for (`raygrid.host.render.machine_job.Settings`)."""

    size: tuple[int, int] | None
    samples: int | None
    depth: int | None
    min_weight: float | None
    highlights: bool | None
    split: str


SETTINGS = tuple(GivenSettings.__annotations__)
