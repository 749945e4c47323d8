"""Takes samples of probes in as they come: records them, draws them as a trace, counts them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

from raygrid.emulator.driver import NodeSample
from raygrid.host.files.input_guard import check_outputs
from raygrid.host.image.outputs import check_named
from raygrid.host.probes.chrome_trace import ChromeTrace
from raygrid.host.probes.record import ProbeRecord
from raygrid.host.probes.sums import Gauges, NodeFigures, Shape
from raygrid.node.errors import OutputError


class Feed(NamedTuple):
    """Samples of an array, as they come; None now and then where none came for a while."""

    shape: Shape
    rate: float
    samples: Iterator[NodeSample | None]


class Probing:
    """Takes samples of one array in. Use as a context manager: at the end, however it ends, the files are written.

    record        path to which samples are added as they come, or None
    chrome_trace  path of a trace for Perfetto, written at the end, or None
    gauges        the latest state of every node
    Raises OutputError, at once if a file can surely not be written. A file that cannot be written later, as the disk is
    full, is no reason to give a frame up: what comes is taken on, and `check` and `close` raise.
    """

    def __init__(self, shape: Shape, rate: float, record: str | None = None, chrome_trace: str | None = None) -> None:
        self.gauges = Gauges(shape)
        self._trouble: OutputError | None = None
        written = [path for path in (record, chrome_trace) if path is not None]
        for path in written:
            check_named(path)
        check_outputs(written)
        self._trace_path = chrome_trace
        self._trace = None if chrome_trace is None else ChromeTrace(shape)
        # opened when the first sample comes: by then all is read that must not be written over
        self._record: ProbeRecord | None = None
        self._record_of = None if record is None else (record, shape, rate)

    def take(self, sample: NodeSample) -> NodeFigures:
        """Take a sample in."""
        state = self.gauges.take(sample)
        if self._trouble is None:
            try:
                self._open()
                if self._record is not None:
                    self._record.take(state)
            except OutputError as error:
                self._trouble = error
        if self._trace is not None:
            self._trace.take(sample)
        return state

    def _open(self) -> None:
        about, self._record_of = self._record_of, None
        if about is not None:
            self._record = ProbeRecord(*about)

    def check(self) -> None:
        """Raise OutputError if what has come could not be written."""
        if self._trouble is not None:
            raise self._trouble

    def close(self) -> None:
        """Write what is not written yet. May be called twice. Raises OutputError."""
        trace, self._trace = self._trace, None
        try:
            self._open()
            record, self._record = self._record, None
            if record is not None:
                record.close()
        finally:
            if trace is not None and self._trace_path is not None:
                trace.write(self._trace_path)
        trouble, self._trouble = self._trouble, None
        if trouble is not None:
            raise trouble

    def __enter__(self) -> Probing:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        with contextlib.suppress(*() if error is None else (OutputError,)):  # what went wrong first is what is told
            self.close()
