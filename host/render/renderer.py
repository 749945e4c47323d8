"""Names what an array can do for a caller who need not know whether it was launched here or stays. Light to import."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self, Unpack, runtime_checkable

if TYPE_CHECKING:
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.given_settings import GivenSettings
    from raygrid.host.render.progress import ProgressHook
    from raygrid.host.scene.load import SceneLike


@runtime_checkable
class Renderer(Protocol):
    """An array that renders: of `raygrid.launch` (a Machine) or of `raygrid.connect` (a Service).

    Same calls, same bits: a function that takes a Renderer works with both.
    """

    @property
    def shape(self) -> tuple[int, int, int]:
        """Processors on each axis."""

    def render(
        self,
        scene: SceneLike,
        *,
        program: str | Path | None = None,
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> Picture:
        """Render a scene, and give the picture back."""

    def render_frames(
        self,
        scene: SceneLike,
        frames: Iterable[int] | None = None,
        *,
        program: str | Path | None = None,
        progress: ProgressHook | bool = True,
        **settings: Unpack[GivenSettings],
    ) -> Iterator[Picture]:
        """Render frames of a shot one after the other; frames: their numbers, None: all of them."""

    def reset(self) -> object:
        """Empty the array."""

    def close(self) -> None:
        """End the array that was launched, or close the connection to the one that stays."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
