"""A client's connection, against a service that is played by the test: threads, late answers, crowds, a door that waits."""

import contextlib
import os
import socket
import threading
import time

import pytest
from support.processes import no_leftovers

from raygrid.emulator.topology.process_stat import process_mark
from raygrid.host.client import connection as module
from raygrid.host.client.connection import Connection
from raygrid.host.client.protocol import VERSION, message_splitter, pack
from raygrid.host.client.service_files import SOCKET, TOKEN, ServiceRecord, write_private
from raygrid.node.errors import ArrayError

__all__ = ["no_leftovers"]

WELCOME = {"is": "welcome", "version": VERSION}


class Played:
    """A service: what it says is what the test tells it to."""

    def __init__(self, folder, backlog=16):
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(os.path.join(folder, SOCKET))
        self._listener.listen(backlog)
        self._listener.settimeout(20.0)
        write_private(module.Path(folder, TOKEN), "secret")
        self.record = ServiceRecord("played", os.getpid(), process_mark(os.getpid()), str(folder), (1, 1, 1), 0.0)
        self.guests = []

    def accept(self):
        guest, _ = self._listener.accept()
        guest.settimeout(20.0)
        self.guests.append((guest, message_splitter()))
        return len(self.guests) - 1

    def hear(self, guest=0):
        peer, splitter = self.guests[guest]
        while (message := splitter.next()) is None:
            piece = peer.recv(1 << 16)
            assert piece, "the client has closed"
            splitter.feed(piece)
        return message

    def say(self, message, guest=0):
        self.guests[guest][0].sendall(pack(message))

    def welcome(self):
        guest = self.accept()
        assert self.hear(guest)["do"] == "hello"
        self.say(WELCOME, guest)
        return guest

    def close(self):
        for peer, _ in self.guests:
            peer.close()
        self._listener.close()


@pytest.fixture
def service(no_leftovers):
    played = Played(no_leftovers)
    yield played
    played.close()


@contextlib.contextmanager
def beside(*works):
    """Run these in threads for the block, and raise what they raised."""
    raised = []

    def run(work):
        try:
            work()
        except BaseException as error:
            raised.append(error)

    threads = [threading.Thread(target=run, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        for thread in threads:
            thread.join(60.0)
            assert not thread.is_alive()
    for error in raised:
        raise error


@contextlib.contextmanager
def connected(service, timeout=20.0):
    with beside(service.welcome):
        connection = Connection(service.record, timeout)
    with contextlib.closing(connection):
        yield connection


def test_each_of_many_threads_gets_its_own_answers_and_events(service):
    rounds, threads, heard = 20, 5, {}

    def serve():
        for _ in range(rounds * threads):
            asked = service.hear()
            service.say({"is": "event", "job": asked["job"], "what": "frame", "frame": asked["frame"]})
            service.say({"is": "following", "job": asked["job"], "frame": asked["frame"]})
        for job in range(threads):
            service.say({"is": "event", "job": job, "what": "end", "state": "done"})

    def client(connection, job):
        def work():
            with connection.listen(job) as listener:
                for frame in range(rounds):
                    answer = connection.ask({"do": "follow", "job": job, "frame": frame})
                    assert (answer["job"], answer["frame"]) == (job, frame)
                heard[job] = list(listener.follow())

        return work

    with connected(service) as connection, beside(serve, *(client(connection, job) for job in range(threads))):
        pass
    for job in range(threads):
        assert [event.get("frame") for event in heard[job]] == [*range(rounds), None]


def test_two_threads_hear_the_same_job(service):
    with connected(service) as connection:
        listeners = [connection.listen(3), connection.listen(3)]
        ends = []
        works = [lambda listener=listener: ends.extend(listener.follow()) for listener in listeners]
        with beside(*works):
            service.say({"is": "event", "job": 3, "what": "end"})
        assert [event["what"] for event in ends] == ["end", "end"]


def test_an_answer_that_comes_too_late_is_nobody_else_s(service):
    with connected(service, 0.2) as connection:
        with pytest.raises(
            ArrayError, match=r"the array 'played' \(process \d+\) does not answer: .* its jobs are kept"
        ):
            connection.ask({"do": "status"})
        assert service.hear() == {"do": "status"}
        service.say({"is": "status", "late": True})

        def serve():
            assert service.hear() == {"do": "jobs"}
            service.say({"is": "jobs"})

        with beside(serve):
            assert connection.ask({"do": "jobs"}, 20.0) == {"is": "jobs"}


def test_who_waits_behind_a_long_request_is_not_told_that_nobody_answers(service):
    with connected(service, 0.3) as connection:
        asked, told = threading.Event(), []

        def long():
            told.append(connection.ask({"do": "reset"}, 20.0)["is"])

        def short():
            asked.wait(20.0)
            begun = time.monotonic()
            told.append(connection.ask({"do": "status"})["is"])
            assert time.monotonic() - begun > 0.6  # longer than it would wait for its own answer

        def serve():
            assert service.hear() == {"do": "reset"}
            asked.set()
            assert service.hear() == {"do": "status"}
            end = time.monotonic() + 0.8
            while time.monotonic() < end:  # busy with the reset
                with contextlib.suppress(TimeoutError):
                    service.guests[0][0].settimeout(max(0.01, end - time.monotonic()))
                    service.guests[0][0].recv(1)
            service.say({"is": "reset"})
            service.say({"is": "status"})

        with beside(long, short, serve):
            pass
    assert told == ["reset", "status"]


VALUES = {
    "huge": (1 << 70, "a whole number of at most 64 bits"),
    "digits": (1 << 70_000, "a whole number of at most 64 bits"),
    "bytes": (b"x", "text, a number, true or false, or a list of these"),
    "object": (object(), "text, a number, true or false, or a list of these"),
    "surrogate": ("a\udcff.png", "a name in UTF-8"),
    "deep": ([[[[[[[1]]]]]]], "at most 131072 items, and at most 6 lists and maps within each other"),
}


@pytest.mark.parametrize("kind", VALUES)
def test_what_cannot_be_sent_is_named_and_the_connection_lives(service, kind):
    value, wanted = VALUES[kind]

    def serve():
        assert service.hear() == {"do": "jobs"}
        service.say({"is": "jobs"})

    with connected(service) as connection, beside(serve):
        for request, name in (({"do": "submit", "settings": {"size": value}}, "size"), ({"scene": value}, "scene")):
            with pytest.raises(ArrayError) as caught:
                connection.ask(request)
            assert str(caught.value).startswith(f"{name} came as ")
            assert str(caught.value).endswith(f", wanted {wanted}")
            assert str(caught.value).isprintable()
            assert len(str(caught.value)) < 300
        assert connection.ask({"do": "jobs"}) == {"is": "jobs"}


def test_a_door_that_is_full_for_a_moment_is_tried_again(no_leftovers):
    service = Played(no_leftovers, backlog=0)
    first = socket.socket(socket.AF_UNIX)
    first.connect(os.path.join(no_leftovers, SOCKET))  # waits at the door, and so fills it
    try:
        probe = socket.socket(socket.AF_UNIX)
        probe.setblocking(False)
        with pytest.raises(BlockingIOError):
            probe.connect(os.path.join(no_leftovers, SOCKET))
        probe.close()

        def serve():
            service.accept()
            service.welcome()

        with beside(serve):
            Connection(service.record).close()
        with pytest.raises(ArrayError, match=r"does not answer: nothing came for 0\.1 seconds"):
            Connection(service.record, 0.1)  # connects, and nobody greets it
    finally:
        first.close()
        service.close()


def test_who_is_sent_away_from_a_crowd_comes_again_and_at_last_is_told_why(service):
    crowd = {"is": "error", "why": "crowd", "error": "the array refused this client: 9 clients are connected, wanted 8"}

    def serve():
        service.say(crowd, service.accept())
        service.welcome()

    with beside(serve):
        Connection(service.record).close()

    def refuse():
        with contextlib.suppress(TimeoutError):
            while True:
                service.say(crowd, service.accept())
                service._listener.settimeout(0.5)

    with beside(refuse), pytest.raises(ArrayError, match="refused this client: 9 clients are connected, wanted 8"):
        Connection(service.record, 0.1)


def test_later_calls_say_what_the_service_said_when_it_closed(service):
    with connected(service) as connection:
        service.say({"is": "error", "why": "slow", "error": "the array refused this client: it was slow"})
        service.guests[0][0].close()
        with pytest.raises(ArrayError, match=r"^the array refused this client: it was slow$"):
            connection.ask({"do": "status"})
        for _ in range(2):
            with pytest.raises(ArrayError, match=r"^the array 'played' has closed the connection: .* it was slow$"):
                connection.ask({"do": "status"})


def test_a_connection_that_is_closed_meanwhile_ends_the_waiting(service):
    with connected(service) as connection:
        listener, told = connection.listen(1), []

        def wait():
            with pytest.raises(ArrayError, match=r"this connection to the array 'played' was closed") as caught:
                listener.next(None)
            told.append(caught.value)

        with beside(wait):
            connection.close()
        assert told


def test_progress_is_dropped_before_it_fills_the_memory(service, monkeypatch):
    monkeypatch.setattr(module, "MOST_KEPT", 10)

    def serve():
        for _ in range(50):
            service.say({"is": "event", "job": 1, "what": "progress"})
        service.say({"is": "event", "job": 1, "what": "end"})
        service.hear()
        service.say({"is": "jobs"})

    with connected(service) as connection, connection.listen(1) as listener, beside(serve):
        connection.ask({"do": "jobs"})
        assert [event["what"] for event in listener.follow()] == ["progress"] * 10 + ["end"]
