"""Carries out `raygrid up`: starts a service, and says how its start goes until it is ready."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypedDict

from raygrid.host.cli.progress import ProgressReporter
from raygrid.host.client.service_files import LOG, make_state_directory, read_record, running, runs_already
from raygrid.host.image.outputs import write_lines, write_result
from raygrid.node.errors import ArrayError

GRACE = 10.0  # seconds for a service to end that was told to


@dataclass(frozen=True)
class UpRequest:
    """What the command line asks for."""

    shape: tuple[int, int, int]
    name: str
    batch: int
    patience: float
    allow_programs: bool
    allow_outside: bool
    as_json: bool
    quiet: bool
    prometheus: int | None = None


# "is" is no name of Python's
ReadyFacts = TypedDict(
    "ReadyFacts",
    {"is": str, "pid": int, "nodes": list[int], "unfinished": int, "remarks": list[str], "prometheus": int | None},
)


def run_up(launch: UpRequest) -> None:
    """Start the service and wait until it is ready. Raises RaygridError for what keeps it from that."""
    begun = time.perf_counter()
    directory = make_state_directory(launch.name)
    record = read_record(directory)
    if record is not None and record.alive:
        raise runs_already(directory)
    processors = launch.shape[0] * launch.shape[1] * launch.shape[2]
    with ProgressReporter(launch.quiet) as reporter:
        reporter.phase(f"launching {processors} processors")
        ready = _start(launch, reporter)
    seconds = round(time.perf_counter() - begun, 3)
    if launch.as_json:
        facts = {"name": launch.name, "array": list(launch.shape), **ready, "wall_seconds": seconds}
        write_result(json.dumps({key: value for key, value in facts.items() if key != "is"}))
        return
    pids = ready["nodes"]
    shown = " ".join(map(str, pids[:64])) + (" ..." if len(pids) > 64 else "")
    write_lines([f"{launch.name}: {_text(launch.shape)} ready, service {ready['pid']}, nodes {shown}"])
    if ready["unfinished"] and not launch.quiet:
        count = ready["unfinished"]
        ProgressReporter(False).remark(
            f"{count} {'job goes' if count == 1 else 'jobs go'} on: raygrid jobs --name {launch.name}"
        )
    for remark in ready["remarks"]:
        ProgressReporter(False).remark(remark)
    if ready["prometheus"] and not launch.quiet:
        from raygrid.host.probes.metrics_server import figures_url

        ProgressReporter(False).remark(f"figures for Prometheus are at {figures_url(ready['prometheus'])}")
    if not launch.quiet and sys.stderr.isatty():
        others = ", ".join(other.name for other in running() if other.name != launch.name)
        ProgressReporter(False).say(
            f"ready in {seconds:.2f} s of wall time" + (f"; also up: {others}" if others else "")
        )


def _start(launch: UpRequest, reporter: ProgressReporter) -> ReadyFacts:
    """Start the process; returns what it says when it is ready."""
    arguments = [launch.name, "--array", *map(str, launch.shape)]
    arguments += ["--batch", str(launch.batch), "--patience", str(launch.patience)]
    arguments += ["--programs"] * launch.allow_programs + ["--outside"] * launch.allow_outside
    arguments += [] if launch.prometheus is None else ["--prometheus", str(launch.prometheus)]
    process: subprocess.Popen[bytes] | None = None
    try:
        with _signals_held():  # or Ctrl-C while it is forked would leave it behind
            # -P: modules that happen to lie where the user stands are not what the service imports.
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "raygrid.host.service.process", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        ready = _listen(process, launch.name, reporter)
    except BaseException as error:
        if process is not None:
            _end(process)
        elif isinstance(error, OSError):
            raise ArrayError(f"the service cannot be started with {sys.executable!r}: {error}") from error
        raise
    process.returncode = 0  # it lives on, and nobody waits for it
    return ready


def _listen(process: subprocess.Popen[bytes], name: str, reporter: ProgressReporter) -> ReadyFacts:
    assert process.stdout is not None
    assert process.stderr is not None
    with process.stdout as said, process.stderr as words:
        for line in said:
            message = json.loads(line)
            if message["is"] == "warming":
                reporter.warming(message["done"], message["total"], message["what"])
            elif message["is"] == "ready":
                ready: ReadyFacts = message
                return ready
            else:
                raise ArrayError(message["error"])
        last = words.read(1 << 14).decode(errors="replace").strip().splitlines()[-1:]
    why = last[0] if last else _end_of_log(name)
    raise ArrayError(f"the service ended before it was ready: {why}")


def _end_of_log(name: str) -> str:
    path = make_state_directory(name) / LOG
    with contextlib.suppress(OSError):
        lines = path.read_text(errors="replace").strip().splitlines()
        if lines:
            return f"{lines[-1]} ({path})"
    return "without a word"


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a service that is not wanted any more; its nodes end with it."""
    with _signals_held():
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGTERM)
        try:
            process.wait(GRACE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """What asks the program to end waits until this is over. A mask would not do: it holds for one thread, and Python lets
    the main thread answer for all."""
    came: list[int] = []
    before = {}
    with contextlib.suppress(ValueError):  # only the main thread may, and nothing is raised in others
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            before[number] = signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


def _text(shape: tuple[int, int, int]) -> str:
    return "x".join(map(str, shape))
