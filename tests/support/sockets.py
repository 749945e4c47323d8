"""What a process holds open, and who is at the other end: unix sockets by way of the kernel's sock_diag."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from pathlib import Path
from typing import NamedTuple

NETLINK_SOCK_DIAG, SOCK_DIAG_BY_FAMILY = 4, 20
DONE, ERROR = 3, 2
REQUEST_DUMP = 0x301
SHOW_NAME, SHOW_PEER = 1, 4
NAME, PEER = 0, 2  # attributes of an answer
LISTENING = 10


class UnixSocket(NamedTuple):
    """A unix socket: its path, "" for none, the inode of the other end, 0 for none, whether it listens, and whether it
    may be a line: without a path, of whole messages."""

    path: str
    peer: int
    listens: bool
    line: bool


def unix_sockets() -> dict[int, UnixSocket] | None:
    """All unix sockets of this computer by inode; None where the kernel does not tell."""
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, NETLINK_SOCK_DIAG) as kernel:
            request = struct.pack("<BBHIIIII", socket.AF_UNIX, 0, 0, 0xFFFFFFFF, 0, SHOW_NAME | SHOW_PEER, 0, 0)
            header = struct.pack("<IHHII", 16 + len(request), SOCK_DIAG_BY_FAMILY, REQUEST_DUMP, 1, 0)
            kernel.send(header + request)
            return _answers(kernel)
    except OSError:
        return None


def _answers(kernel: socket.socket) -> dict[int, UnixSocket] | None:
    found: dict[int, UnixSocket] = {}
    while True:
        data = kernel.recv(1 << 20)
        at = 0
        while at < len(data):
            length, kind = struct.unpack_from("<IH", data, at)
            if kind == DONE:
                return found
            if kind == ERROR:
                return None
            _, sort, state, _, inode = struct.unpack_from("<BBBBI", data, at + 16)
            attributes = _attributes(data[at + 32 : at + length])
            path = os.fsdecode(attributes.get(NAME, b"").rstrip(b"\0"))
            peer = struct.unpack("<I", attributes[PEER])[0] if PEER in attributes else 0
            found[inode] = UnixSocket(path, peer, state == LISTENING, not path and sort == socket.SOCK_SEQPACKET)
            at += length + 3 & ~3


def _attributes(data: bytes) -> dict[int, bytes]:
    found, at = {}, 0
    while at + 4 <= len(data):
        length, kind = struct.unpack_from("<HH", data, at)
        found[kind] = data[at + 4 : at + length]
        at += max(length, 4) + 3 & ~3
    return found


def descriptors(pid: int) -> dict[int, str]:
    """What each open descriptor of a process is."""
    found = {}
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # that of the listing itself, if it is our own
            found[int(entry.name)] = os.readlink(entry)
    return found


def socket_inodes(pid: int) -> set[int]:
    """The inodes of a process' sockets, of whatever family."""
    return {int(what[8:-1]) for what in descriptors(pid).values() if what.startswith("socket:")}


def shared_files(pid: int) -> list[str]:
    """Files that a process maps so that others see what it writes, or that live in shared memory."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return [line for line in lines if "/dev/shm" in line or {"w", "s"} <= set(line.split()[1])]
