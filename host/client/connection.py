"""Connects any number of threads to an array that stays: requests, answers in order, and events.

No thread is started for it. Of those that wait, one reads and hands to each what is for it; when it has its own, another
of those that wait takes its place.

What a thread does not wait for any longer comes all the same: each answer belongs to a request by its place in the row, so
that an answer that came too late is nobody else's.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from raygrid.emulator.topology import LONGEST_PATH, STATES, process_state
from raygrid.host.client.facts import ENDED
from raygrid.host.client.job_events import end_of
from raygrid.host.client.protocol import VERSION, Message, message_splitter, pack, unsendable
from raygrid.host.client.service_files import SOCKET, TOKEN, ServiceRecord, check_private, read_private
from raygrid.node.errors import ArrayError, ProtocolError
from raygrid.node.protocol import Splitter

ANSWER_SECONDS = 20.0  # a service that lives answers at once
QUIET_SECONDS = 30.0  # without any news of a job, after which the service is asked how it is
FIRST_WAIT, LONGEST_WAIT = 0.01, 0.25  # seconds between two attempts to connect where others wait
MOST_KEPT = 1000  # events that wait for a listener, above which it is not told of progress and samples
NO_JOB = 0  # for a listener whose job has no number yet: a job never has this one
PASSING = ("progress", "sample")  # events that are outdated by the next

T = TypeVar("T")


class _Slot:
    """An answer that is to come. `abandoned`: nobody waits for it any more."""

    def __init__(self, listener: EventListener | None) -> None:
        self.listener = listener
        self.answer: Message | None = None
        self.abandoned = False


class EventListener:
    """Hears the events of a job, or samples of probes. For use by one thread, and to be closed by it.

    job  its number; None: samples
    """

    def __init__(self, connection: Connection, job: int | None) -> None:
        self._connection, self.job = connection, job
        self.events: deque[Message] = deque()

    def next(self, seconds: float | None) -> Message | None:
        """The next event; None if none comes within that time. Raises ArrayError if the connection is no more."""
        return self._connection.wait_for(lambda: self.events.popleft() if self.events else None, seconds)

    def follow(self) -> Iterator[Message]:
        """All events of the job, the last of which is its end. Raises ArrayError if the array ends or hangs."""
        what = ""
        while what != "end":
            event = self.next(QUIET_SECONDS)
            if event is None:
                facts = self._connection.ask({"do": "follow", "job": self.job})
                if facts["state"] not in ENDED:
                    continue
                event = end_of(facts)
            what = event["what"]
            yield event

    def take(self, event: Message) -> None:
        """Keep an event if it is for this listener."""
        if event.get("job") != self.job or (self.job is None and event["what"] != "sample"):
            return
        if len(self.events) < MOST_KEPT or event["what"] not in PASSING:
            self.events.append(event)

    def close(self) -> None:
        """Hear no more."""
        self._connection.forget(self)

    def __enter__(self) -> EventListener:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Connection:
    """One connection to a service: requests, answers and events. Any thread may use it at any time."""

    def __init__(self, record: ServiceRecord, timeout: float = ANSWER_SECONDS) -> None:
        """Connect and be let in. Raises ArrayError if there is no service, or if it does not answer."""
        self.record, self._timeout = record, timeout
        self._splitter = message_splitter()
        self._changed = threading.Condition()  # holds all that follows, but for the bytes of the socket
        self._sending = threading.Lock()
        self._reading = self._closed = False
        self._slots: deque[_Slot] = deque()
        self._listeners: list[EventListener] = []
        self._broken = ""  # why nothing more can be said and heard
        self._parting = ""  # what the service said before it closed the connection
        deadline = time.monotonic() + timeout
        wait = FIRST_WAIT
        while True:
            self._socket = _reach(record, deadline, timeout)
            try:
                answer = self._exchange({"do": "hello", "version": VERSION, "token": _token(record)}, timeout)
            except BaseException:
                self._socket.close()
                raise
            if answer["is"] != "error":
                return
            self._socket.close()
            if answer.get("why") != "crowd" or time.monotonic() + wait > deadline:
                raise ArrayError(str(answer["error"]))
            time.sleep(wait)
            wait = min(2.0 * wait, LONGEST_WAIT)
            self._splitter, self._broken, self._parting = message_splitter(), "", ""

    # --- asking ---------------------------------------------------------------------------------------

    def ask(self, request: Message, timeout: float | None = None, listener: EventListener | None = None) -> Message:
        """Send a request and wait for its answer.

        listener  of no job yet: hears of the job that the answer names, from that on
        Raises ArrayError for what cannot be sent, for what the service refuses, and if it is gone or does not answer.
        """
        answer = self._exchange(request, timeout or self._timeout, listener)
        if answer["is"] == "error":
            raise ArrayError(str(answer["error"]))
        return answer

    def listen(self, job: int | None) -> EventListener:
        """A listener, which hears what comes from now on."""
        listener = EventListener(self, job)
        with self._changed:
            self._listeners.append(listener)
        return listener

    def forget(self, listener: EventListener) -> None:
        """Tell a listener nothing more."""
        with self._changed, contextlib.suppress(ValueError):
            self._listeners.remove(listener)

    def _exchange(self, request: Message, seconds: float, listener: EventListener | None = None) -> Message:
        slot = _Slot(listener)
        self._send(packed(request), slot, seconds)
        try:
            while True:
                answer = self.wait_for(lambda: slot.answer, seconds)
                if answer is not None:
                    return answer
                with self._changed:
                    before = list(self._slots)
                # One after the other is answered, so who waits behind a reset gets the same time after it.
                if not any(not other.abandoned for other in before[: before.index(slot)] if slot in before):
                    raise silence(self.record, seconds)
        finally:
            slot.abandoned = True

    def _send(self, data: bytes, slot: _Slot, seconds: float) -> None:
        """Put a request behind those of other threads. One of which only a part could be sent ends the connection."""
        deadline = time.monotonic() + seconds
        if not self._sending.acquire(timeout=seconds):
            raise silence(self.record, seconds)
        try:
            with self._changed:
                if self._broken:
                    raise ArrayError(self._why_broken())
                self._slots.append(slot)
            left = memoryview(data)
            try:
                while left:
                    left = left[self._put(left, deadline) :]
            except TimeoutError:
                raise silence(self.record, seconds) from None
            finally:
                if left:
                    self._give_up(slot, untouched=len(left) == len(data))
        finally:
            self._sending.release()

    def _give_up(self, slot: _Slot, untouched: bool) -> None:
        """A request was not sent; nothing of it was if `untouched`."""
        with self._changed:
            if untouched:
                self._slots.remove(slot)
            else:
                self._broken = self._broken or "a request was sent in part"
                self._changed.notify_all()

    def _put(self, data: memoryview, deadline: float) -> int:
        """Send some bytes; returns how many. A service that has closed its end may have said why: reading tells."""
        try:
            return self._socket.send(data, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except BlockingIOError:
            if not _poll(self._socket, select.POLLOUT, deadline - time.monotonic()):
                raise TimeoutError from None
            return 0
        except OSError:
            return len(data)

    # --- hearing --------------------------------------------------------------------------------------

    def wait_for(self, ready: Callable[[], T | None], seconds: float | None) -> T | None:
        """Wait until `ready`, asked whenever something has come, has something; None after that time.

        Raises ArrayError if the connection is no more.
        """
        deadline = None if seconds is None else time.monotonic() + seconds
        while True:
            with self._changed:
                while True:
                    found = ready()
                    if found is not None:
                        return found
                    if self._broken:
                        raise ArrayError(self._why_broken())
                    left = None if deadline is None else deadline - time.monotonic()
                    if left is not None and left <= 0.0:
                        return None
                    if not self._reading:
                        self._reading = True
                        break
                    self._changed.wait(left)
            self._read(left)

    def _read(self, seconds: float | None) -> None:
        """Take in what comes next within that time, for all threads."""
        why, pieces = "", []
        try:
            if _poll(self._socket, select.POLLIN, seconds):
                piece = self._socket.recv(1 << 16, socket.MSG_DONTWAIT)
                self._splitter.feed(piece)
                while (message := self._splitter.next()) is not None:
                    pieces.append(message)
                if not piece:
                    why = "closed"
        except BlockingIOError:
            pass
        except OSError:
            why = "closed"
        except ProtocolError as error:
            why = f"it sent what is no message: {error}"
        finally:
            with self._changed:
                for message in pieces:
                    self._take(message)
                self._broken = self._broken or why
                self._reading = False
                self._changed.notify_all()
                if self._closed:
                    self._socket.close()

    def _take(self, message: Message) -> None:
        """Hand a message to whom it is for."""
        if "why" in message:  # and so the last that is said
            self._parting = str(message.get("error", ""))
        if message.get("is") == "event" and isinstance(message.get("what"), str):
            for listener in self._listeners:
                listener.take(message)
        elif not isinstance(message.get("is"), str):
            self._broken = "it sent a message that says not what it is"
        elif self._slots:
            slot = self._slots.popleft()
            slot.answer = message
            if slot.listener is not None and "job" in message:
                slot.listener.job = message["job"]

    # --- words ----------------------------------------------------------------------------------------

    def _why_broken(self) -> str:
        return why_broken(self.record, self._closed, self._broken, self._parting)

    def hand_over(self) -> tuple[socket.socket, Splitter[Message]]:
        """The socket and what cuts its bytes into messages, for another owner; this connection is not to be used any more."""
        return self._socket, self._splitter

    def close(self) -> None:
        """Close, whoever waits; jobs go on. May be called twice."""
        with self._changed:
            self._closed, self._broken = True, self._broken or "closed"
            self._changed.notify_all()
            if self._reading:  # who reads closes the socket, or its number might be another file's by then
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_RDWR)
            else:
                self._socket.close()


def _token(record: ServiceRecord) -> str:
    return read_private(Path(record.directory, TOKEN))


def _reach(record: ServiceRecord, deadline: float, timeout: float) -> socket.socket:
    """A socket that is connected to a service. Raises ArrayError.

    A service that is busy, or stopped for a moment, lets a few wait and turns the others away (EAGAIN): who
    comes again is let in as soon as it goes on.
    """
    path = os.path.join(record.directory, SOCKET)
    if record.alive and not os.path.lexists(path):
        raise ArrayError(
            f"the array {record.name!r} (process {record.pid}) runs, but its door is gone: {path} was removed"
        )
    check_private(record.directory, directory=True)
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise ArrayError(f"{path}: a socket's path is that long, wanted at most {LONGEST_PATH} bytes")
    wait = FIRST_WAIT
    while True:
        fresh = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            fresh.connect(path)
            return fresh
        except BlockingIOError:
            fresh.close()
        except OSError as error:
            fresh.close()
            if not record.alive:
                raise ArrayError(f"the array {record.name!r} (process {record.pid}) is gone") from None
            why = error.strerror or str(error)
            raise ArrayError(f"the door of the array {record.name!r} (process {record.pid}) is shut ({why})") from None
        if time.monotonic() + wait > deadline:
            raise silence(record, timeout)
        time.sleep(wait)
        wait = min(2.0 * wait, LONGEST_WAIT)


def why_broken(record: ServiceRecord, closed: bool, broken: str, parting: str) -> str:
    """Why nothing more can be said and heard on a connection, as things are now.

    closed   whether this side closed it
    broken   what happened, "closed" if the other side closed it
    parting  what the service said before that
    """
    name, pid = record.name, record.pid
    if closed:
        return f"this connection to the array {name!r} was closed, wanted one that is open: raygrid.connect({name!r})"
    if not record.alive:
        return f"the array {name!r} (process {pid}) is gone"
    if broken != "closed":
        return f"the connection to the array {name!r} (process {pid}) is of no use: {broken}"
    return f"the array {name!r} has closed the connection" + (f": {parting}" if parting else "")


def silence(record: ServiceRecord, seconds: float) -> ArrayError:
    """The error for a service that does not answer.

    Nothing is said of what to do about it: the reasons are many, and to end an array costs others their frames."""
    letter = process_state(record.pid)
    state = f", {STATES[letter]}" if letter in ("T", "t", "D") else ""
    return ArrayError(
        f"the array {record.name!r} (process {record.pid}{state}) does not answer: "
        f"nothing came for {seconds:g} seconds, wanted an answer at once; its jobs are kept"
    )


def _poll(stream: socket.socket, event: int, seconds: float | None) -> bool:
    """Whether a socket is ready within that time."""
    poller = select.poll()
    poller.register(stream, event)
    return bool(poller.poll(None if seconds is None else max(0.0, seconds) * 1000.0))


def packed(request: Message) -> bytes:
    """A request as bytes. Raises ArrayError that names what cannot be sent; nothing was then."""
    wrong = unsendable(request)
    if wrong:
        raise ArrayError(wrong)
    try:
        return pack(request)
    except ProtocolError as error:
        raise ArrayError(str(error)) from None
