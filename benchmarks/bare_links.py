"""What packets over a PAIR socket cost when nothing is done with them: the floor of any array of processes.

    python benchmarks/bare_links.py --packets 1200 --packets 4096 --runs 5

Two processes, one sends messages of so many packets of 25 bytes, the other receives them; both copy nothing that ZeroMQ
does not. A JSON map a run: packets in a message, messages, CPU nanoseconds a packet of both processes, ZeroMQ's threads
included, and nanoseconds of the wall.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time

import zmq

SIZE, HEAD = 25, 20
WINDOW = 128  # messages that ZeroMQ may hold on each side, as in `node.links.zmq_channel`


def _receive(endpoint: str, messages: int, told: int) -> None:
    """Take in all messages, and write what that cost to a pipe."""
    with zmq.Context() as context, context.socket(zmq.PAIR) as socket:
        socket.setsockopt(zmq.RCVHWM, WINDOW)
        socket.connect(endpoint)
        socket.recv()
        spent = time.process_time()
        for _ in range(messages):
            socket.recv(copy=False)
        spent = time.process_time() - spent
        socket.send(b"")
        os.write(told, json.dumps(spent).encode())


def measure(packets: int, messages: int) -> dict[str, float]:
    """One run."""
    with tempfile.TemporaryDirectory() as folder:
        endpoint = f"ipc://{folder}/link"
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            _receive(endpoint, messages, write)
            os._exit(0)
        with zmq.Context() as context, context.socket(zmq.PAIR) as socket:
            socket.setsockopt(zmq.SNDHWM, WINDOW)
            socket.bind(endpoint)
            message = bytes(HEAD + packets * SIZE)
            socket.send(b"")
            spent, wall = time.process_time(), time.perf_counter()
            for _ in range(messages):
                socket.send(message, copy=True)
            socket.recv()
            spent, wall = time.process_time() - spent, time.perf_counter() - wall
        theirs = float(json.loads(os.read(read, 100)))
        os.waitpid(child, 0)
        os.close(read)
        os.close(write)
    many = packets * messages / 1e9
    return {"packets": packets, "messages": messages, "cpu_ns": (spent + theirs) / many, "wall_ns": wall / many}


def main() -> None:
    """Print a line a run."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--packets", type=int, action="append", required=True, metavar="N", help="in a message")
    parser.add_argument("--runs", type=int, default=3, metavar="N")
    options = parser.parse_args()
    for _ in range(options.runs):
        for packets in options.packets:
            print(json.dumps(measure(packets, max(1, 8_000_000 // packets))), flush=True)


if __name__ == "__main__":
    main()
