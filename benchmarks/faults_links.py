"""Bad links and uninvited peers for the fault campaign."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import zmq
from faults_bed import ATTEMPTS, BUDGET, Bed, Case, Outcome, job, right

from raygrid.emulator.processes.array import Array
from raygrid.host.render.session import RenderSession
from raygrid.node.errors import RaygridError
from raygrid.node.links.faulty_channel import FAULT_KINDS, FaultPlan
from raygrid.node.links.link import VERSION
from raygrid.node.protocol.messages import MessageKind, pack_message, pack_order

BATCH = 64  # packets a message: many messages, and so many that can be hit
FRAMES = 4  # frames over the same bad links
RATE = 4e-4


def _bad_links(kind: str) -> Callable[[random.Random], list[Case]]:
    """Frames of one array whose neighbour links are bad; each frame is a case."""

    def cases(rng: random.Random) -> list[Case]:
        plan = FaultPlan(kind, RATE, rng.randrange(1 << 30))
        lent: list[Array] = []  # launched by the first case, closed by the last

        def do(bed: Bed, number: int) -> Outcome:
            if not lent:
                lent.append(Array.launch(bed.shape, batch=BATCH, fault=plan))
            (array,) = lent
            try:
                return _frame(array, bed)
            finally:
                if number == FRAMES - 1:
                    lent.clear()
                    array.close()

        return [Case(f"{kind} frame {number}", lambda bed, number=number: do(bed, number)) for number in range(FRAMES)]

    return cases


def _frame(array: Array, bed: Bed) -> Outcome:
    try:
        picture = RenderSession(array, ATTEMPTS).render(job(bed.shape), BUDGET)
    except RaygridError as error:
        with contextlib.suppress(RaygridError):
            array.reset()
        return Outcome("refused", str(error)) if "\n" not in str(error) else Outcome("wrong", str(error))
    ready = tuple(fault["seconds"][1] for fault in picture.stats["faults"])
    return Outcome("same", ready=ready) if right(picture, bed.shape) else Outcome("wrong", "other bits")


# --- uninvited peers ------------------------------------------------------------------------------


@contextlib.contextmanager
def intruder(array: Array, work: Callable[[zmq.Context[zmq.Socket[bytes]], Path], None]) -> Iterator[None]:
    """While this lasts, another thread does something to every socket file that appears, as any process of the same
    user could: it is not asked in, and wins or loses the race for each link."""
    assert array._place is not None
    place, stop = Path(array._place.path), threading.Event()
    met: set[str] = set()

    def roam() -> None:
        with zmq.Context() as context:
            while not stop.is_set():
                with contextlib.suppress(OSError):
                    for name in set(os.listdir(place)) - met - {"pid"}:
                        met.add(name)
                        with contextlib.suppress(OSError, zmq.ZMQError):
                            work(context, place / name)
                time.sleep(0.0005)

    thread = threading.Thread(target=roam)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _says(context: zmq.Context[zmq.Socket[bytes]], path: Path, messages: list[list[bytes]]) -> None:
    with context.socket(zmq.PAIR) as pair:
        pair.setsockopt(zmq.LINGER, 20)
        pair.connect(f"ipc://{path}")
        for parts in messages:
            with contextlib.suppress(zmq.Again):
                pair.send_multipart(parts, zmq.NOBLOCK)
        pair.poll(5)


def _hello(machine: str) -> bytes:
    order = {"machine": machine, "node": [0, 0, 0], "port": 1, "version": VERSION}
    return pack_message(int(MessageKind.HELLO), 0, 0, 0, 0, pack_order(order))


def _babble(rng: random.Random) -> Callable[[zmq.Context[zmq.Socket[bytes]], Path], None]:
    """One of: rubbish, a HELLO of another machine, parts without end, bytes that are not even ZeroMQ."""
    how, seed = rng.choice(("rubbish", "hello", "parts", "bytes")), rng.random()

    def work(context: zmq.Context[zmq.Socket[bytes]], path: Path) -> None:
        own = random.Random(seed)
        if how == "bytes":
            with socket.socket(socket.AF_UNIX) as plain:
                plain.settimeout(0.01)
                plain.connect(str(path))
                plain.sendall(own.randbytes(own.choice((1, 64, 4000))))
        elif how == "hello":
            _says(context, path, [[_hello("0" * 16)]])
        elif how == "parts":
            _says(context, path, [[own.randbytes(25)] * 50])
        else:
            _says(context, path, [[own.randbytes(own.choice((0, 1, 16, 20, 45, 1000)))] for _ in range(20)])

    return work


def _uninvited(when: str) -> Callable[[random.Random], list[Case]]:
    """Peers that come while links are up, or while they are made."""

    def do(bed: Bed, work: Callable[[zmq.Context[zmq.Socket[bytes]], Path], None]) -> Outcome:
        from faults_bed import judge, render

        faults: list[float] = []
        with intruder(bed.array, work):
            if when == "new links":
                with contextlib.suppress(RaygridError):
                    bed.array.reset()
        return judge(lambda: render(bed.array, on_fault=lambda fault: faults.append(fault.seconds[1])), bed)

    def cases(rng: random.Random) -> list[Case]:
        work = _babble(rng)
        return [Case(f"uninvited on {when}", lambda bed: do(bed, work))]

    return cases


GROUPS = {
    **{f"links that {kind}": _bad_links(kind) for kind in FAULT_KINDS},
    "uninvited peer on links that are up": _uninvited("links"),
    "uninvited peer on new links": _uninvited("new links"),
}
