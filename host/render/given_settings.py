"""Names the settings of a render that callers may give. Light to import."""

from __future__ import annotations

from typing import Any, TypedDict, cast

from raygrid.host.scene.view import VIEW, GivenView


class GivenFrame(TypedDict, total=False):
    """Settings of the frame; left out or None: what the scene's file asks for (`raygrid.host.render.machine_job.Settings`)."""

    size: tuple[int, int] | None
    samples: int | None
    depth: int | None
    min_weight: float | None
    highlights: bool | None
    split: str


class GivenSettings(GivenFrame, GivenView, total=False):
    """Settings by keyword: of the frame, and from where and in which light the scene is seen (`GivenView`)."""


SETTINGS = (*GivenFrame.__annotations__, *VIEW)


def parted(given: GivenSettings) -> tuple[dict[str, Any], GivenView]:
    """The settings of the frame, and those of the view."""
    view = {name: value for name, value in given.items() if name in VIEW}
    return {name: value for name, value in given.items() if name not in VIEW}, cast(GivenView, view)
