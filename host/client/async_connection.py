"""Connects coroutines of one event loop to an array that stays: requests, answers in order, and events.

It is let in as `Connection` is, in a thread, and takes its socket over then. A coroutine may be cancelled while it waits: what it
waited for comes all the same, and is nobody else's.
"""

from __future__ import annotations

import asyncio
import itertools
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Self

from raygrid.host.client.connection import (
    ANSWER_SECONDS,
    MOST_KEPT,
    NO_JOB,
    PASSING,
    QUIET_SECONDS,
    Connection,
    packed,
    silence,
    why_broken,
)
from raygrid.host.client.facts import ENDED
from raygrid.host.client.job_events import end_of
from raygrid.host.client.protocol import Message
from raygrid.host.client.service_files import ServiceRecord, find
from raygrid.node.errors import ArrayError, ProtocolError

LONGEST_PIECE = 1 << 16  # bytes that are taken in at once


@dataclass
class _AwaitedSlot:
    """An answer that is to come, None if the connection breaks before; cancelled: nobody waits for it any more."""

    answer: asyncio.Future[Message | None]
    listener: AsyncEventListener | None


class AsyncEventListener:
    """Hears the events of a job. Use as a context manager.

    job  its number
    """

    def __init__(self, connection: AsyncConnection, job: int) -> None:
        self._connection, self.job = connection, job
        self._events: asyncio.Queue[Message | None] = asyncio.Queue()

    def take(self, event: Message | None) -> None:
        """Keep an event if it is for this listener; None: there will be none any more."""
        if event is None or (
            event.get("job") == self.job and (self._events.qsize() < MOST_KEPT or event["what"] not in PASSING)
        ):
            self._events.put_nowait(event)

    async def follow(self) -> AsyncIterator[Message]:
        """All events of the job, the last of which is its end. Raises ArrayError if the array ends or hangs."""
        what = ""
        while what != "end":
            try:
                event = await asyncio.wait_for(self._events.get(), QUIET_SECONDS)
            except TimeoutError:
                facts = await self._connection.ask({"do": "follow", "job": self.job})
                if facts["state"] not in ENDED:
                    continue
                event = end_of(facts)
            if event is None:
                raise ArrayError(self._connection.why_broken)
            what = event["what"]
            yield event

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.forget(self)


class AsyncConnection:
    """One connection to a service, for the coroutines of the event loop that runs when it is made."""

    def __init__(self, connection: Connection, timeout: float = ANSWER_SECONDS) -> None:
        """Take the socket of a connection that was let in."""
        self.record, self._timeout = connection.record, timeout
        self._socket, self._splitter = connection.hand_over()
        self._slots: deque[_AwaitedSlot] = deque()
        self._listeners: list[AsyncEventListener] = []
        self._sending = asyncio.Lock()
        self._closed = False
        self._broken = self._parting = ""
        self._reader = asyncio.get_running_loop().create_task(self._read())

    @property
    def why_broken(self) -> str:
        """Why nothing more can be said and heard."""
        return why_broken(self.record, self._closed, self._broken, self._parting)

    async def ask(
        self, request: Message, timeout: float | None = None, listener: AsyncEventListener | None = None
    ) -> Message:
        """Send a request and wait for its answer; arguments and errors as of `Connection.ask`."""
        seconds = timeout or self._timeout
        slot = _AwaitedSlot(asyncio.get_running_loop().create_future(), listener)
        try:
            await self._send(packed(request), slot, seconds)
            while not (await asyncio.wait([slot.answer], timeout=seconds))[0]:
                before = itertools.takewhile(lambda other: other is not slot, self._slots)
                # One after the other is answered, so who waits behind a reset gets the same time after it.
                if all(other.answer.cancelled() for other in before):
                    raise silence(self.record, seconds)
            answer = slot.answer.result()
        finally:
            slot.answer.cancel()
        if answer is None:
            raise ArrayError(self.why_broken)
        if answer["is"] == "error":
            raise ArrayError(str(answer["error"]))
        return answer

    async def _send(self, data: bytes, slot: _AwaitedSlot, seconds: float) -> None:
        """Put a request behind those of others. One of which only a part could be sent ends the connection."""
        try:
            async with asyncio.timeout(seconds), self._sending:
                if self._broken:
                    raise ArrayError(self.why_broken)
                self._slots.append(slot)
                try:
                    await asyncio.get_running_loop().sock_sendall(self._socket, data)
                except OSError:
                    pass  # it has closed its end, and may have said why: reading tells
                except BaseException:
                    self._break("a request was sent in part")
                    raise
        except TimeoutError:
            raise silence(self.record, seconds) from None

    def listen(self, job: int = NO_JOB) -> AsyncEventListener:
        """A listener, which hears what comes from now on."""
        listener = AsyncEventListener(self, job)
        self._listeners.append(listener)
        return listener

    def forget(self, listener: AsyncEventListener) -> None:
        """Tell a listener nothing more."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    async def _read(self) -> None:
        """Take in what comes, until nothing more can."""
        loop, why = asyncio.get_running_loop(), "closed"
        try:
            while piece := await loop.sock_recv(self._socket, LONGEST_PIECE):
                self._splitter.feed(piece)
                while (message := self._splitter.next()) is not None:
                    self._take(message)
        except OSError:
            pass
        except ProtocolError as error:
            why = f"it sent what is no message: {error}"
        finally:
            self._break(why)

    def _take(self, message: Message) -> None:
        """Hand a message to whom it is for. Raises ProtocolError for one that says not what it is."""
        if "why" in message:  # and so the last that is said
            self._parting = str(message.get("error", ""))
        if message.get("is") == "event" and isinstance(message.get("what"), str):
            for listener in self._listeners:
                listener.take(message)
        elif not isinstance(message.get("is"), str):
            raise ProtocolError("a message that says not what it is")
        elif self._slots:
            slot = self._slots.popleft()
            if slot.listener is not None and "job" in message:
                slot.listener.job = message["job"]
            if not slot.answer.done():
                slot.answer.set_result(message)

    def _break(self, why: str) -> None:
        """Nothing more can be said and heard: whoever waits is told."""
        self._broken = self._broken or why
        for slot in self._slots:
            if not slot.answer.done():
                slot.answer.set_result(None)
        for listener in self._listeners:
            listener.take(None)

    async def close(self) -> None:
        """Close, whoever waits; jobs go on. May be called twice."""
        self._closed = True
        self._break("closed")
        self._reader.cancel()
        await asyncio.wait([self._reader])
        self._socket.close()


async def open_connection(name: str, timeout: float) -> AsyncConnection:
    """Connect to the array of that name and be let in. Raises ArrayError."""
    record: ServiceRecord = await asyncio.to_thread(find, name)
    opening = asyncio.ensure_future(asyncio.to_thread(Connection, record, timeout))
    try:
        return AsyncConnection(await asyncio.shield(opening), timeout)
    except asyncio.CancelledError:
        opening.add_done_callback(_close_late)
        raise


def _close_late(opening: asyncio.Future[Connection]) -> None:
    """A connection that came when nobody waited for it any more."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()
