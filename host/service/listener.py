"""Lets clients in, and carries the bytes that go to and fro. What is asked is answered elsewhere.

A client must be of the same user (the kernel says so), and must present the secret of the token file in its first
message, within GREETING_SECONDS. Others are refused and counted.

MOST_CLIENTS may stay. Some more places are kept for those who only look after the array: who comes when it is full may ask
what BRIEF names, and must not idle. So whoever crowds the listener, the array can be asked how it is, and taken down.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import os
import secrets
import socket
import struct
import traceback
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path

from raygrid.host.client.protocol import LONGEST, LONGEST_GREETING, VERSION, Message, message_splitter, pack
from raygrid.host.client.requests import Request, read_request
from raygrid.host.client.service_files import SOCKET, TOKEN, write_private
from raygrid.host.text.clean_text import printable
from raygrid.host.text.error_text import told
from raygrid.host.text.log import log
from raygrid.node.errors import ProtocolError, RaygridError
from raygrid.node.protocol import Splitter

GREETING_SECONDS = 5.0
MOST_CLIENTS = 200
MOST_BRIEF = 32  # clients besides, for as long as their requests take
BRIEF = ("status", "jobs", "cancel", "reset", "down")
BRIEF_SECONDS = 5.0  # without a request, after which such a client has to go
WAITING = 512  # that may wait to be accepted until the service comes to them
PIECE = 1 << 16  # bytes read at a time
MOST_UNSENT = LONGEST + (1 << 20)  # bytes that may wait for a client that does not read; then it is cut off
CROWDED = 1 << 16  # bytes waiting for a client above which it is not told of progress
CREDENTIALS = struct.Struct("3i")

REFUSALS = ("user", "token", "greeting", "request", "crowd", "slow")


class ClientConnection:
    """A client that was let in.

    follows  jobs that it follows
    brief    whether it came when all places were taken
    rate     how often a second it wants to be told how each node stands; 0: not at all
    """

    def __init__(self, writer: asyncio.StreamWriter, on_slow: Callable[[], None]) -> None:
        self._writer, self._on_slow = writer, on_slow
        self.follows: set[int] = set()
        self.brief = False
        self.rate = 0.0

    def send(self, message: Message, droppable: bool = False) -> None:
        """Send without waiting; `droppable` messages only if the client keeps up. Raises ProtocolError for what cannot be."""
        transport = self._writer.transport
        unsent = transport.get_write_buffer_size()
        if self._writer.is_closing() or (droppable and unsent > CROWDED):
            return
        self._writer.write(_packed(message))
        if transport.get_write_buffer_size() > MOST_UNSENT:
            self._on_slow()
            transport.abort()

    def close(self) -> None:
        """Send what waits, and close."""
        self._writer.close()


Answer = Callable[[ClientConnection, Request], Awaitable[Message]]


class Listener:
    """Listens in a private directory.

    refused  how often, by why: another user, a wrong token, no proper greeting, a request that is none, too many
             clients, a client that does not read
    clients  those that are in
    """

    def __init__(self, directory: str, answer: Answer) -> None:
        self._path = str(Path(directory) / SOCKET)
        self._token = secrets.token_hex(32)
        self._directory, self._answer = Path(directory), answer
        self.refused: Counter[str] = Counter(dict.fromkeys(REFUSALS, 0))
        self.clients: set[ClientConnection] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None
        self._look: tuple[int, int] | None = None  # at socket and secret when they were made

    async def open(self, directory: str | None = None) -> None:
        """Let clients come, from now on in another directory if one is given; those that are in stay. Raises OSError."""
        if directory is not None:
            self._directory, self._path = Path(directory), str(Path(directory) / SOCKET)
        if self._server is not None:
            self._server.close()
            self._server = None
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)
        write_private(self._directory / TOKEN, self._token)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            listener.bind(self._path)
            os.chmod(self._path, 0o600)
            self._server = await asyncio.start_unix_server(self._come, sock=listener, backlog=WAITING)
        except BaseException:
            listener.close()
            raise
        self._look = self._seen()

    def is_sound(self) -> bool:
        """Whether socket and secret are still where a client looks for them."""
        return self._look is not None and self._seen() == self._look

    def _seen(self) -> tuple[int, int] | None:
        try:
            return os.lstat(self._path).st_ino, os.lstat(self._directory / TOKEN).st_ino
        except OSError:
            return None

    async def close(self) -> None:
        """Let nobody in any more, send what waits for those inside, and let them go."""
        if self._server is not None:
            self._server.close()
        for client in list(self.clients):
            client.close()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=1.0)
        for task in list(self._tasks):
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=1.0)

    async def _come(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        client = ClientConnection(writer, lambda: self.refused.update(slow=1))
        try:
            await self._meet(client, reader, writer)
        except (OSError, asyncio.CancelledError):
            pass
        finally:
            self.clients.discard(client)
            self._tasks.discard(task)
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError):
                await writer.wait_closed()

    async def _meet(self, client: ClientConnection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not _is_ours(writer):
            self.refused["user"] += 1
            return
        if len(self._tasks) > MOST_CLIENTS + MOST_BRIEF:
            self._refuse(client, "crowd", self._crowded())
            return
        splitter = message_splitter(LONGEST_GREETING)
        try:
            async with asyncio.timeout(GREETING_SECONDS):
                greeting = await _next(splitter, reader)
        except (TimeoutError, ProtocolError):
            self._refuse(client, "greeting", "it did not greet as a client does")
            return
        if greeting is None:
            self.refused["greeting"] += 1
            return
        if not self._knows(greeting):
            self._refuse(client, "token", "it did not present the secret of this array")
            return
        splitter.longest = LONGEST
        client.brief = not self._has_place()
        self.clients.add(client)
        client.send({"is": "welcome", "version": VERSION})
        await self._serve(client, splitter, reader)

    def _has_place(self) -> bool:
        return sum(not client.brief for client in self.clients) < MOST_CLIENTS

    def _crowded(self) -> str:
        last = f"{', '.join(BRIEF[:-1])} and {BRIEF[-1]}"
        return f"{len(self.clients)} clients are connected, wanted at most {MOST_CLIENTS}; it still answers {last}"

    def _knows(self, greeting: Message) -> bool:
        token = greeting.get("token")
        known = isinstance(token, str) and hmac.compare_digest(token.encode(), self._token.encode())
        return known and greeting.get("do") == "hello" and greeting.get("version") == VERSION

    def _refuse(self, client: ClientConnection, why: str, reason: str) -> None:
        self.refused[why] += 1
        client.send({"is": "error", "why": why, "error": f"the array refused this client: {reason}"})

    async def _serve(self, client: ClientConnection, splitter: Splitter[Message], reader: asyncio.StreamReader) -> None:
        """Answer requests until the client is gone, or sends what is no message: then nobody knows where the next begins."""
        try:
            while (message := await self._hear(client, splitter, reader)) is not None:
                answer = await self._reply(client, message)
                try:
                    client.send(answer)
                except ProtocolError as error:
                    client.send({"is": "error", "error": f"the answer cannot be sent: {error}"})
        except ProtocolError as error:
            self._refuse(client, "request", str(error))

    async def _hear(
        self, client: ClientConnection, splitter: Splitter[Message], reader: asyncio.StreamReader
    ) -> Message | None:
        """The next message of a client, None if it is gone or has to go. Raises ProtocolError."""
        while True:
            try:
                async with asyncio.timeout(BRIEF_SECONDS if client.brief else None):
                    return await _next(splitter, reader)
            except TimeoutError:
                client.brief = not self._has_place()
                if client.brief:
                    self._refuse(client, "crowd", self._crowded())
                    return None

    async def _reply(self, client: ClientConnection, message: Message) -> Message:
        try:
            try:
                request = read_request(message)
            except ProtocolError:
                self.refused["request"] += 1
                raise
            client.brief = client.brief and not self._has_place()
            if client.brief and request.do not in BRIEF:
                self.refused["crowd"] += 1
                return {"is": "error", "error": f"the array is crowded: {self._crowded()}"}
            return await self._answer(client, request)
        except RaygridError as error:
            return {"is": "error", "error": printable(str(error))}
        except Exception as error:
            return {"is": "error", "error": told(error)}


def _packed(message: Message) -> bytes:
    """A message as bytes. One that cannot be sent is nobody's end: an error goes instead of an answer, nothing instead
    of an event."""
    try:
        return pack(message, escape=True)
    except (ProtocolError, ArithmeticError, TypeError, ValueError) as error:
        log("".join(traceback.format_exception(error)))
        if message["is"] == "event":
            return b""
        return pack({"is": "error", "error": f"the answer cannot be sent: {printable(str(error), 300)}"})


def _is_ours(writer: asyncio.StreamWriter) -> bool:
    """Whether the peer is of the same user."""
    found = writer.get_extra_info("socket").getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
    _, user, _ = CREDENTIALS.unpack(found)
    return bool(user == os.geteuid())


async def _next(splitter: Splitter[Message], reader: asyncio.StreamReader) -> Message | None:
    """The next message; None when the peer has closed. Raises ProtocolError."""
    while (message := splitter.next()) is None:
        piece = await reader.read(PIECE)
        if not piece:
            return None
        splitter.feed(piece)
    return message
