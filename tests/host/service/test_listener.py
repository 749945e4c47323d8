"""The door of a service without a service: limits that a whole array would take long to reach."""

import asyncio
import os
import socket
from pathlib import Path

import pytest

from raygrid.host.client.protocol import VERSION, message_splitter, pack
from raygrid.host.client.service_files import SOCKET, TOKEN
from raygrid.host.service import listener
from raygrid.host.service.listener import Listener


@pytest.fixture
def folder(no_leftovers):
    """A short private directory."""
    return no_leftovers


async def answer(client, request):
    """Each client follows everything; each request is answered by its name."""
    return {"is": request.do}


def connected(folder):
    peer = socket.socket(socket.AF_UNIX)
    peer.settimeout(20.0)
    peer.connect(os.path.join(folder, SOCKET))
    return peer


def greeting(folder):
    return pack({"do": "hello", "version": VERSION, "token": Path(folder, TOKEN).read_text()})


def received(peer):
    """All messages until the door closes."""
    splitter, found = message_splitter(), []
    while True:
        try:
            piece = peer.recv(1 << 16)
        except ConnectionResetError:
            return found
        if not piece:
            return found
        splitter.feed(piece)
        while (message := splitter.next()) is not None:
            found.append(message)


def with_door(folder, work):
    """Open a door and let `work(door)` run in a thread beside it."""

    async def run():
        door = Listener(folder, answer)
        await door.open()
        try:
            return await asyncio.to_thread(work, door, asyncio.get_running_loop())
        finally:
            await door.close()

    return asyncio.run(run())


def test_who_says_nothing_is_sent_away(folder, monkeypatch):
    monkeypatch.setattr(listener, "GREETING_SECONDS", 0.1)

    def work(door, _):
        with connected(folder) as peer:
            (said,) = received(peer)
            assert said["is"] == "error"
        with connected(folder) as peer:
            peer.sendall(greeting(folder)[:20])  # and not the rest
            assert [said["is"] for said in received(peer)] == ["error"]
        assert door.refused["greeting"] == 2

    with_door(folder, work)


def asked(peer, folder, *requests):
    """Greet, send requests, and wait for as many answers, that to the greeting first."""
    peer.sendall(greeting(folder) + b"".join(map(pack, requests)))
    return answers(peer, 1 + len(requests))


def answers(peer, count):
    splitter, found = message_splitter(), []
    while len(found) < count:
        piece = peer.recv(1)  # no byte of the next one
        assert piece, f"the door closed after {found}"
        splitter.feed(piece)
        while (message := splitter.next()) is not None:
            found.append(message)
    return found


def test_who_comes_when_it_is_full_may_look_after_the_array_and_must_not_stay(folder, monkeypatch):
    monkeypatch.setattr(listener, "MOST_CLIENTS", 2)
    monkeypatch.setattr(listener, "BRIEF_SECONDS", 0.3)

    def work(door, _):
        inside = [connected(folder) for _ in range(2)]
        for peer in inside:
            assert [said["is"] for said in asked(peer, folder, {"do": "status"})] == ["welcome", "status"]
        with connected(folder) as late:
            said = asked(late, folder, {"do": "status"}, {"do": "follow", "job": 1}, {"do": "down"})
            assert [answer["is"] for answer in said] == ["welcome", "status", "error", "down"]
            assert "3 clients are connected, wanted at most 2; it still answers status, jobs, " in said[2]["error"]
            (last,) = received(late)  # it has idled, and has to go
            assert "wanted at most 2" in last["error"]
        assert door.refused["crowd"] == 2
        for peer in inside:  # who was there before is not troubled
            peer.sendall(pack({"do": "follow", "job": 1}))
            assert answers(peer, 1)[0]["is"] == "follow"
            peer.close()

    with_door(folder, work)


def test_who_came_when_it_was_full_gets_the_place_of_one_that_leaves(folder, monkeypatch):
    monkeypatch.setattr(listener, "MOST_CLIENTS", 1)
    monkeypatch.setattr(listener, "BRIEF_SECONDS", 20.0)

    def work(door, _):
        with connected(folder) as late:
            with connected(folder) as first:
                asked(first, folder)
                asked(late, folder)
            while len(door.clients) > 1:  # until the door has noticed that the first has gone
                late.sendall(pack({"do": "status"}))
                answers(late, 1)
            late.sendall(pack({"do": "follow", "job": 1}))
            assert answers(late, 1)[0]["is"] == "follow"

    with_door(folder, work)


def test_who_comes_when_no_place_is_kept_is_told_so(folder, monkeypatch):
    monkeypatch.setattr(listener, "MOST_CLIENTS", 1)
    monkeypatch.setattr(listener, "MOST_BRIEF", 1)

    def work(door, _):
        inside = [connected(folder) for _ in range(2)]
        for peer in inside:
            asked(peer, folder)
        with connected(folder) as late:
            (said,) = received(late)
            assert (said["is"], said["why"]) == ("error", "crowd")
        for peer in inside:
            peer.close()

    with_door(folder, work)


def test_a_request_that_is_none_is_answered_and_the_next_one_too(folder):
    def work(door, _):
        with connected(folder) as peer:
            bad = {"do": "submit", "scene": "/a.nff", "outputs": ["/a.png"], "settings": {"size": [0, 1]}}
            said = asked(peer, folder, bad, {"do": "status"}, {"do": "fly"}, {"do": "status"})
            assert [answer["is"] for answer in said] == ["welcome", "error", "status", "error", "status"]
            assert said[1]["error"].startswith("size came as 0x1, wanted sides of 1 to ")
        assert door.refused["request"] == 2

    with_door(folder, work)


def test_another_user_is_not_listened_to(folder, monkeypatch):
    monkeypatch.setattr(listener.os, "geteuid", lambda: os.getuid() + 1)

    def work(door, _):
        with connected(folder) as peer:
            assert received(peer) == []
        assert door.refused["user"] == 1

    with_door(folder, work)


def test_who_does_not_read_is_cut_off_and_progress_is_dropped_first(folder, monkeypatch):
    monkeypatch.setattr(listener, "MOST_UNSENT", 1 << 20)

    def work(door, loop):
        with connected(folder) as peer:
            peer.sendall(greeting(folder) + pack({"do": "status"}))
            while len(door.clients) == 0:
                peer.recv(1, socket.MSG_PEEK)
            (client,) = door.clients
            done = asyncio.run_coroutine_threadsafe(flood(client, droppable=True), loop)
            done.result(20.0)
            assert door.refused["slow"] == 0
            asyncio.run_coroutine_threadsafe(flood(client, droppable=False), loop).result(20.0)
            assert door.refused["slow"] == 1
            received(peer)

    async def flood(client, droppable):
        for _ in range(400):
            client.send({"is": "event", "text": "x" * 10_000}, droppable)

    with_door(folder, work)


def test_an_answer_with_a_path_that_is_no_utf_8_can_be_read(folder, monkeypatch):
    async def told(self, client, message):
        return {"is": "status", "journal": "/tmp/\udcff"}

    monkeypatch.setattr(Listener, "_reply", told)

    def work(door, _):
        with connected(folder) as peer:
            assert asked(peer, folder, {"do": "status"})[1]["journal"] == "/tmp/\\udcff"

    with_door(folder, work)


def test_an_answer_that_is_too_long_is_told_and_the_next_one_comes(folder, monkeypatch):
    async def told(self, client, message):
        return {"is": "jobs", "text": "x" * (9 << 20 if message["do"] == "jobs" else 1)}

    monkeypatch.setattr(Listener, "_reply", told)

    def work(door, _):
        with connected(folder) as peer:
            said = asked(peer, folder, {"do": "jobs"}, {"do": "status"})
            assert [answer["is"] for answer in said] == ["welcome", "error", "jobs"]
            assert "the answer cannot be sent: a message of 9437" in said[1]["error"]

    with_door(folder, work)


def test_the_socket_and_the_secret_are_for_us_alone(folder):
    def work(door, _):
        for name in (SOCKET, TOKEN):
            assert os.stat(os.path.join(folder, name)).st_mode & 0o777 == 0o600
        assert len(Path(folder, TOKEN).read_text()) == 64

    with_door(folder, work)
