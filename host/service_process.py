"""The process of a service, started by `raygrid up`: its lock, its log, its sockets' directory, and its end."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from raygrid.emulator.places import Place
from raygrid.host.service import ENDING, Service
from raygrid.host.service_files import JOURNAL, LOG, make_state_directory, take_lock
from raygrid.host.worker import Options
from raygrid.node.errors import RaygridError

FIGURES_SECONDS = 4.0  # for the service to say how it is


async def _serve(name: str, options: Options, place: Place, tell: Any, port: int | None) -> int:
    if port is None:
        return await Service(name, options, place, tell).run()
    from raygrid.host.figures_server import Endpoint
    from raygrid.host.prometheus import of_service

    loop, services = asyncio.get_running_loop(), list[Service]()

    def families() -> Iterator[Any]:
        for service in services:
            yield from of_service(asyncio.run_coroutine_threadsafe(service.facts(), loop).result(FIGURES_SECONDS))

    endpoint = Endpoint(families, port)  # first: what keeps it from its port is said before anything is launched
    try:
        service = Service(name, options, place, tell)
        service.prometheus = endpoint.port
        services.append(service)
        return await service.run()
    finally:
        await asyncio.to_thread(endpoint.close)  # a visit may wait for this thread


def main() -> None:
    """The whole life of a service. Tells `raygrid up` by lines of JSON on standard output how its start goes."""
    parser = argparse.ArgumentParser(prog="python -m raygrid.host.service_process")
    parser.add_argument("name")
    parser.add_argument("--array", nargs=3, type=int, required=True, metavar=("NX", "NY", "NZ"))
    parser.add_argument("--batch", type=int, required=True)
    parser.add_argument("--patience", type=float, required=True)
    parser.add_argument("--programs", action="store_true")
    parser.add_argument("--prometheus", type=int)
    given = parser.parse_args()
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # until there is somebody who cleans up
    tell = os.fdopen(os.dup(1), "wb")
    code = 1
    try:
        directory = make_state_directory(given.name)
        lock = take_lock(directory)
        _keep_log(directory)
        os.chdir("/")
        nx, ny, nz = given.array
        options = Options((nx, ny, nz), given.batch, given.patience, directory / JOURNAL, given.programs)
        with Place.create((1, 1, 1)) as place:
            code = asyncio.run(_serve(given.name, options, place, tell, given.prometheus))
        os.close(lock)
    except (RaygridError, OSError) as error:
        with contextlib.suppress(OSError, ValueError):
            tell.write((json.dumps({"is": "error", "error": str(error)}) + "\n").encode())
            tell.flush()
    os._exit(code)  # a thread that hangs in the array would keep us; its processes see that we are gone


def _keep_log(directory: Path) -> None:
    """Standard output and error go to the log from now on; the log of the time before is kept as one older."""
    with contextlib.suppress(FileNotFoundError):
        os.replace(directory / LOG, directory / f"{LOG}.1")
    log = os.open(directory / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)


if __name__ == "__main__":
    main()
