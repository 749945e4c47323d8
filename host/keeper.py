"""An array that is kept: it remembers what it holds, and is repaired when it fails. For use by one thread."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from raygrid.emulator.array import Array
from raygrid.emulator.places import process_state
from raygrid.node.errors import ArrayError, LostProcess, ProtocolError, RaygridError, TooLarge

if TYPE_CHECKING:
    from raygrid.host.picture import Picture
    from raygrid.host.render import Watch
    from raygrid.host.scene_store import Ready

ATTEMPTS = 4  # to render a frame, faults between them
GONE = ("", "Z", "X")  # states of a process that has ended

Shape = tuple[int, int, int]
OnFault = Callable[[str], None]


class NoArray(ArrayError):
    """There is no array, and none can be launched now."""


class Keeper:
    """Keeps one array.

    shape    processors on each axis
    options  of `Array`
    floods   how often a scene was loaded
    on_fault told of each fault that was repaired
    """

    def __init__(self, shape: Shape, on_fault: OnFault, **options: Any) -> None:
        self.shape, self.floods = shape, 0
        self._on_fault = on_fault
        self._options = options
        self._array: Array | None = None
        self._holds = ""  # digest of what the array holds

    def launch(self) -> None:
        """Launch the array. Raises NoArray."""
        self._holds = ""
        try:
            self._array = Array.launch(self.shape, **self._options)
        except (RaygridError, OSError, MemoryError) as error:
            raise NoArray(f"the array cannot be launched: {error}") from error

    @property
    def pids(self) -> list[int]:
        """Process ids of the nodes, x fastest; empty while there is no array. May be asked by any thread."""
        array = self._array
        return [] if array is None else list(array.pids)

    def check(self) -> None:
        """Repair the array if it has lost a node while it had nothing to do, or is not there. Raises NoArray."""
        if self._array is None:
            self.launch()
        gone = [pid for pid in self.pids if process_state(pid) in GONE]
        if gone:
            self._on_fault(f"node process {gone[0]} ended while the array had nothing to do")
            self.reset()

    def reset(self) -> None:
        """Empty the array, whatever its state. Raises NoArray if it cannot be launched again."""
        self._holds = ""
        self.close()
        self.launch()

    def render(self, ready: Ready, budget: int, watch: Watch) -> Picture:
        """Render a frame, again if the array fails meanwhile. Raises RaygridError."""
        from raygrid.host.render import render_job

        for attempt in range(1, ATTEMPTS + 1):
            if self._array is None:
                self.launch()
            assert self._array is not None
            try:
                loaded = self._holds == ready.loaded
                noted = self._noting(ready, loaded, watch)
                return render_job(self._array.driver, ready.job, budget, noted, loaded)
            except (ArrayError, ProtocolError) as error:
                if isinstance(error, TooLarge):
                    raise
                if attempt == ATTEMPTS:
                    self.reset()
                    raise
                self._on_fault(str(error))
                self.reset()
        raise LostProcess("unreachable")

    def _noting(self, ready: Ready, loaded: bool, watch: Watch) -> Watch:
        """A watch that notes when the surfaces are all there."""
        if not loaded:
            self._holds = ""

        def noting(phase: str, progress: Any) -> None:
            if phase == "load":
                self.floods += 1
            elif phase == "trace" and progress is None:
                self._holds = ready.loaded
            watch(phase, progress)

        return noting

    def close(self) -> None:
        """End the array. May be called twice."""
        array, self._array = self._array, None
        if array is not None:
            with contextlib.suppress(RaygridError):
                array.close()
