"""A fuzz of the front end: malformed greetings and requests into an array that renders, which renders right after.

    python benchmarks/fuzz_service.py --messages 20000 --seed 1

Each message goes in over a connection of its own, half of them by a client that was let in. What comes back must be an error
and nothing else; a request that is none must never be carried out. Prints what was sent and refused, by kind;
exit code 1 if one was not refused, the service grew by more than 10 MB, or a frame afterwards has other bits than before.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import socket
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import psutil
from bench_run import RAYGRID, ROOT, run

import raygrid
from raygrid.host.client.protocol import LONGEST, VERSION, message_splitter, pack
from raygrid.host.client.service_files import SOCKET, TOKEN, find
from raygrid.node.protocol.framing import LENGTH

NAME = "bench-fuzz"
JOB = {"do": "submit", "scene": "/none.nff", "outputs": ["/none.png"], "settings": {"size": [8, 8]}, "frames": None}
BASES: list[dict[str, Any]] = [
    JOB,
    {"do": "follow", "job": 1},
    {"do": "cancel", "jobs": [1]},
    {"do": "jobs", "ended": 3},
]
WRONG = [None, True, -1, 1 << 63, 0.5, float("inf"), "", "x" * 5000, [], {}, [[[[[[[[]]]]]]]], {"do": "down"}, b"bytes"]


def _framed(body: bytes) -> bytes:
    return LENGTH.pack(len(body)) + body


def _rubbish(rng: random.Random) -> bytes:
    return _framed(b"\xc1" + rng.randbytes(rng.randrange(200)))


def _unknown(rng: random.Random) -> bytes:
    return _framed(msgpack.packb({"do": rng.choice(["", "fly", "DOWN", "hello", "submit\0"]), "job": 1}))


def _wrong_value(rng: random.Random) -> bytes:
    base = dict(rng.choice(BASES))
    key = rng.choice([key for key in base if key != "frames"])
    wrong = [value for value in WRONG if not (key in ("jobs", "settings") and value in (None, [], {}))]
    return _framed(msgpack.packb(base | {key: rng.choice(wrong)}))


def _unasked(rng: random.Random) -> bytes:
    return _framed(msgpack.packb(rng.choice(BASES) | {f"key{rng.randrange(99)}": 1}))


def _missing(rng: random.Random) -> bytes:
    base = dict(rng.choice(BASES[:3]))
    del base[rng.choice([key for key in base if key not in ("settings", "frames")])]
    return _framed(msgpack.packb(base))


def _torn(rng: random.Random) -> bytes:
    body = msgpack.packb(rng.choice(BASES))
    return _framed(body[: rng.randrange(len(body))])


def _too_long(rng: random.Random) -> bytes:
    return LENGTH.pack(rng.randrange(LONGEST + 1, 1 << 32)) + rng.randbytes(20)


def _deep(rng: random.Random) -> bytes:
    return _framed(msgpack.packb({"do": "status"})[:-6] + b"\x91" * rng.randrange(10, 4000))


KINDS: dict[str, Callable[[random.Random], bytes]] = {
    "rubbish": _rubbish,
    "unknown request": _unknown,
    "wrong value": _wrong_value,
    "key too many": _unasked,
    "key missing": _missing,
    "torn": _torn,
    "too long": _too_long,
    "deep": _deep,
}


def refused(path: str, token: str | None, message: bytes) -> bool:
    """Send one message, after a greeting if there is a token; whether it was answered by an error and nothing else."""
    splitter = message_splitter()
    with socket.socket(socket.AF_UNIX) as peer:
        peer.settimeout(30.0)
        peer.connect(path)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            if token is not None:
                peer.sendall(pack({"do": "hello", "version": VERSION, "token": token}))
            peer.sendall(message)
            peer.shutdown(socket.SHUT_WR)  # who sent a request that is none would be listened to further
        with contextlib.suppress(ConnectionResetError):
            while piece := peer.recv(1 << 16):
                splitter.feed(piece)
    answers = []
    while (answer := splitter.next()) is not None:
        answers.append(answer["is"])
    return answers in (["welcome", "error"], ["error"], [])  # a reset may take the answer with it


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=20_000, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="N")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    sent: Counter[str] = Counter()
    passed: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_STATE_HOME"] = name
        run([RAYGRID, "up", "--array", "2x1x1", "--name", NAME])
        try:
            with raygrid.connect(NAME) as array:
                scene, frame = ROOT / "scenes" / "tiny.nff", Path(name) / "frame.npy"
                array.submit(scene, output=frame, size=(64, 48)).wait()
                before, service = frame.read_bytes(), psutil.Process(array.pid)
                memory = service.memory_full_info().uss
                long = array.submit(scene, output=f"{name}/%d.npy", turntable=90_000, size=(64, 48))
                record = find(NAME)
                path, token = os.path.join(record.directory, SOCKET), Path(record.directory, TOKEN).read_text()
                for number in range(options.messages):
                    kind = rng.choice(list(KINDS))
                    sent[kind] += 1
                    passed[kind] += not refused(path, token if number % 2 else None, KINDS[kind](rng))
                long.cancel()
                array.submit(scene, output=frame, size=(64, 48)).wait()
                same, grown = frame.read_bytes() == before, service.memory_full_info().uss - memory
                status = array.status()
        finally:
            run([RAYGRID, "down", "--name", NAME])
    print("| kind | sent | not refused |\n|---|---|---|")
    for kind, count in sorted(sent.items()):
        print(f"| {kind} | {count:,} | {passed[kind]:,} |")
    frames = status["frames"]["done"]
    print(
        f"\n{frames:,} frames meanwhile, the last {'the same' if same else 'NOT THE SAME'} bits as the first;", end=" "
    )
    print(f"the service grew by {grown / 1e6:.1f} MB; it counted {status['refused']}")
    raise SystemExit(0 if same and not passed.total() and grown < 10_000_000 else 1)


if __name__ == "__main__":
    main()
