"""Is the process of a service, which `raygrid up` starts: makes lock, log and socket directory, serves, and ends."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING, BinaryIO

from raygrid.emulator.topology import SocketDirectory
from raygrid.host.client.service_files import JOURNAL, Home
from raygrid.host.service.events import Options
from raygrid.host.service.service import ENDING, ArrayService
from raygrid.host.text.standard_streams import ready_streams
from raygrid.node.errors import RaygridError

if TYPE_CHECKING:
    from prometheus_client import Metric

FIGURES_SECONDS = 4.0  # for the service to say how it is


async def _serve(home: Home, options: Options, place: SocketDirectory, tell: BinaryIO, port: int | None) -> int:
    if port is None:
        return await ArrayService(home, options, place, tell).run()
    from raygrid.host.probes.metrics_server import Endpoint
    from raygrid.host.probes.prometheus import of_service

    loop, services = asyncio.get_running_loop(), list[ArrayService]()

    def families() -> Iterator[Metric]:
        for service in services:
            facts = asyncio.run_coroutine_threadsafe(service.answers.facts(), loop).result(FIGURES_SECONDS)
            yield from of_service(facts)

    endpoint = Endpoint(families, port)  # first: what keeps it from its port is said before anything is launched
    try:
        service = ArrayService(home, options, place, tell)
        service.state.prometheus = endpoint.port
        services.append(service)
        return await service.run()
    finally:
        await asyncio.to_thread(endpoint.close)  # a visit may wait for this thread


def main() -> None:
    """The whole life of a service. Tells `raygrid up` by lines of JSON on standard output how its start goes."""
    ready_streams()
    parser = argparse.ArgumentParser(prog="python -m raygrid.host.service.process")
    parser.add_argument("name")
    parser.add_argument("--array", nargs=3, type=int, required=True, metavar=("NX", "NY", "NZ"))
    parser.add_argument("--batch", type=int, required=True)
    parser.add_argument("--patience", type=float, required=True)
    parser.add_argument("--programs", action="store_true")
    parser.add_argument("--outside", action="store_true")
    parser.add_argument("--prometheus", type=int)
    given = parser.parse_args()
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # until there is somebody who cleans up
    tell = os.fdopen(os.dup(1), "wb")
    code = 1
    try:
        home = Home(given.name)
        home.begin_log()
        os.chdir("/")
        nx, ny, nz = given.array
        journal = home.directory / JOURNAL
        options = Options((nx, ny, nz), given.batch, given.patience, journal, given.programs, given.outside)
        with SocketDirectory.create((1, 1, 1)) as place:
            code = asyncio.run(_serve(home, options, place, tell, given.prometheus))
        home.close()
    except (RaygridError, OSError) as error:
        with contextlib.suppress(OSError, ValueError):
            tell.write((json.dumps({"is": "error", "error": str(error)}) + "\n").encode())
            tell.flush()
    os._exit(code)  # a thread that hangs in the array would keep us; its processes see that we are gone


if __name__ == "__main__":
    main()
