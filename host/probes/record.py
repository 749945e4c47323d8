"""Writes and reads samples of probes as lines of JSON: one that describes the array, then one a sample (docs/probes.md)."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO

from raygrid.emulator.driver import NodeSample
from raygrid.host.files.input_guard import check_kept, note
from raygrid.host.image.outputs import check_named, open_now
from raygrid.host.probes.sums import NodeFigures, sample_record
from raygrid.node.errors import OutputError

VERSION = 2  # 1 had another figure of memory


def header(shape: tuple[int, int, int], rate: float) -> dict[str, object]:
    """What the first line says. `wall` and `time` are the same moment on two clocks: since 1970, and that of the samples."""
    return {
        "is": "array",
        "version": VERSION,
        "array": list(shape),
        "rate": rate,
        "wall": round(time.time(), 3),
        "time": round(time.monotonic(), 6),
    }


def record_line(state: NodeFigures) -> str:
    """A sample as a line."""
    return json.dumps({"is": "sample", **sample_record(state)}, separators=(",", ":"))


class ProbeRecord:
    """A file to which samples are added as they come, so that it is there, too, if the array fails.

    Raises OutputError if it cannot be written; after the first such error nothing more is written.
    """

    def __init__(self, path: str, shape: tuple[int, int, int], rate: float) -> None:
        check_named(path)
        check_kept(path)
        self._path = path
        try:
            self._file: IO[str] | None = open_now(path)
        except OSError as error:
            raise OutputError(f"{path}: the file cannot be written ({error.strerror})") from None
        self._write(json.dumps(header(shape, rate)))

    def take(self, state: NodeFigures) -> None:
        """Add a sample."""
        self._write(record_line(state))

    def _write(self, line: str) -> None:
        if self._file is None:
            return
        try:
            self._file.write(line + "\n")
        except OSError as error:
            self._give_up()
            raise OutputError(f"{self._path}: the file cannot be written ({error.strerror})") from None

    def _give_up(self) -> None:
        with contextlib.suppress(OutputError):
            self.close()

    def close(self) -> None:
        """Write what waits. May be called twice."""
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                raise OutputError(f"{self._path}: the file cannot be written ({error.strerror})") from None


# --- reading ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ProbeReplay:
    """A recording: of an array of this shape, at this rate. `close` it if not all samples are taken."""

    shape: tuple[int, int, int]
    rate: float
    samples: Iterator[NodeSample]
    close: Callable[[], None]


def replay(path: str) -> ProbeReplay:
    """A recording that `ProbeRecord` wrote. Raises OutputError, here and while it is read, for a file that is none."""
    from pydantic import TypeAdapter, ValidationError

    reader = TypeAdapter(NodeSample)
    note(path, "the same file as the recording")
    try:
        file = open(path, encoding="utf-8")  # noqa: SIM115  (closed by its reader, or below)
    except OSError as error:
        raise OutputError(f"{path}: the recording cannot be read ({error.strerror})") from None

    def samples() -> Iterator[NodeSample]:
        with file:
            for number, line in enumerate(file, 2):
                try:
                    yield reader.validate_json(line)
                except ValidationError as error:
                    first = error.errors(include_url=False)[0]
                    where = ".".join(map(str, first["loc"])) or "the line"
                    raise OutputError(f"{path}: line {number}: {where}: {first['msg']}") from None

    try:
        head = json.loads(file.readline(10_000))
        nx, ny, nz = head["array"]
        if head["is"] != "array" or head["version"] != VERSION or not all(_is_side(side) for side in (nx, ny, nz)):
            raise ValueError(head)
        return ProbeReplay((nx, ny, nz), float(head["rate"]), samples(), file.close)
    except (OSError, ValueError, KeyError, TypeError):
        file.close()
        raise OutputError(f"{path}: the first line is not that of a recording of probes, version {VERSION}") from None


def _is_side(value: object) -> bool:
    return type(value) is int and value > 0
