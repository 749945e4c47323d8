"""Keeps an array: launches it, lends it to frames, and repairs it when it fails. For use by one thread."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from raygrid.emulator.processes import RESET_SECONDS, RESET_SECONDS_A_NODE, Array
from raygrid.node.errors import ArrayError, ProtocolError, RaygridError, TooLarge

if TYPE_CHECKING:
    from raygrid.emulator.driver import NodeSample
    from raygrid.host.image.picture import Picture
    from raygrid.host.render.frame import Watch
    from raygrid.host.render.machine_job import Job
    from raygrid.host.render.retry import FaultReport
    from raygrid.host.render.session import RenderSession

Shape = tuple[int, int, int]
OnFault = Callable[[str], None]


class NoArray(ArrayError):
    """There is no array, and none can be launched now."""


class ArraySupervisor:
    """Keeps one array.

    shape     processors on each axis
    options   of `Array`
    session   that renders on it, and counts how often what was loaded; None before the first launch
    on_fault  told of each fault that was repaired
    on_wait   called often while a frame is rendered or the array launched or reset; raises to give that up
    rate      of the array's probes, in samples a second of each node; any thread may set it
    on_sample told of each sample; to be set before the rate
    """

    def __init__(self, shape: Shape, on_fault: OnFault, on_wait: Callable[[], None], **options: Any) -> None:
        self.shape = shape
        self.session: RenderSession | None = None  # on the array that there is, or was
        self._on_fault, self._on_wait = on_fault, on_wait
        self._options = options
        self._array: Array | None = None
        self.rate = self._rate = 0.0  # wanted, and told to the array
        self.on_sample: Callable[[NodeSample], object] | None = None
        self._spoilt = False  # and must be reset before the next frame
        self._given_up = False  # nodes may still be at work on a frame that nobody waits for

    def launch(self) -> None:
        """Launch the array. Raises NoArray, and what `on_wait` raises."""
        self._rate = 0.0
        with self._launching():
            self._array = Array(self.shape, **self._options)
            self._array.on_wait = self._on_wait  # a first run compiles for a minute, and may be given up
            self._array.begin()
            from raygrid.host.render.session import RenderSession  # takes a second; the fork server warms up beside it

            self._array.wait_ready()
            self._array.on_wait = None
            self.session = self.session or RenderSession(self._array, on_fault=self._tell)
            self.session.array = self._array

    @contextlib.contextmanager
    def _launching(self) -> Any:
        """What goes wrong in this block leaves no array. Raises NoArray."""
        try:
            yield
        except BaseException as error:
            self.close()
            if isinstance(error, RaygridError | OSError | MemoryError):
                raise NoArray(f"the array cannot be launched: {error or 'out of memory'}") from error
            raise

    @property
    def there(self) -> bool:
        """Whether there is an array."""
        return self._array is not None

    @property
    def pids(self) -> list[int]:
        """Process ids of the nodes, x fastest; empty while there is no array. May be asked by any thread."""
        array = self._array
        return [] if array is None else list(array.pids)

    @property
    def epoch(self) -> int:
        """How often the array was reset since it was launched. May be asked by any thread."""
        array = self._array
        return -1 if array is None else array.epoch

    def check(self) -> None:
        """Repair the array if it has failed while it had nothing to do, or is not there. Raises NoArray."""
        if self._array is None:
            self.launch()
            return
        try:
            self._set_rate()
            self._array.check()
            if self._given_up:
                self._settle()
        except (ArrayError, ProtocolError) as error:
            begun = time.perf_counter()
            self.reset()
            self._on_fault(f"{error}; it was idle, and repaired in {time.perf_counter() - begun:.2f} s")

    def reset(self) -> None:
        """Empty the array, whatever its state. Raises NoArray if that cannot be, and what `on_wait` raises."""
        self._spoilt, self._given_up = False, False
        if self._array is None:
            self.launch()
            return
        with self._launching():
            self._array.on_wait = self._on_wait  # what cannot be reset is launched anew
            self._array.reset()
            self._array.on_wait = None

    def render(self, job: Job, budget: int, watch: Watch) -> Picture:
        """Render a frame, again if the array fails meanwhile. Raises RaygridError, and what `on_wait` raises."""
        if self._spoilt:  # a frame before was given up, or failed for good
            self.reset()
        elif self._array is None:
            self.launch()
        elif self._given_up:
            self._settle()
        assert self._array is not None
        assert self.session is not None
        epoch = self._array.epoch
        self._array.on_wait = self._wait
        try:
            return self.session.render(job, budget, watch)
        except BaseException as error:
            # The driver drops what is left of a frame that was given up; only a reset that was given up must be repeated.
            failed = isinstance(error, ArrayError | ProtocolError) and not isinstance(error, TooLarge)
            self._spoilt = failed or self._array.epoch != epoch
            self._given_up = not isinstance(error, RaygridError)
            raise
        finally:
            if self._array is not None:
                self._array.on_wait = None

    def _settle(self) -> None:
        """Let the nodes drop a frame that was given up, or reset them if they do not: one may run a program that never
        ends. Raises NoArray, and what `on_wait` raises."""
        assert self._array is not None
        self._array.on_wait = self._on_wait
        try:
            self._array.driver.settle(_settle_seconds(self.shape))
            self._given_up = False
        except (ArrayError, ProtocolError):
            self._array.on_wait = None
            self.reset()
        finally:
            if self._array is not None:
                self._array.on_wait = None

    def _wait(self) -> None:
        self._set_rate()
        self._on_wait()

    def _set_rate(self) -> None:
        if self._array is not None and self._rate != self.rate:
            self._rate = self.rate
            self._array.probe(self._rate, self.on_sample)

    def _tell(self, fault: FaultReport) -> None:
        self._on_fault(f"{fault.what}; repaired in {fault.seconds[1]:.2f} s, {fault.restarts} nodes forked anew")

    def close(self) -> None:
        """End the array. May be called twice."""
        array, self._array = self._array, None
        given_up = self._given_up
        self._spoilt, self._given_up = False, False
        if array is not None:
            array.on_wait = None
            if given_up:  # then it may not say goodbye either
                with contextlib.suppress(RaygridError):
                    array.driver.patience = _settle_seconds(self.shape)
            with contextlib.suppress(RaygridError):
                array.close()


def _settle_seconds(shape: Shape) -> float:
    """How long nodes may say nothing while they drop a frame; as long as a reset waits for them."""
    return RESET_SECONDS + RESET_SECONDS_A_NODE * shape[0] * shape[1] * shape[2]
