"""Requests of clients: what is right comes through as it was meant, anything else is one clear error."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cases import steady
from support.render import SCENES

from raygrid.host.client.protocol import pack, unpack
from raygrid.host.client.requests import SubmitMessage, read_job, read_request
from raygrid.host.image.frames import Turntable
from raygrid.host.render.job import Settings
from raygrid.host.render.program_file import read_program
from raygrid.host.scene.view import View
from raygrid.host.service.scene_store import FrameRequest, wanted_by
from raygrid.node.errors import ProtocolError

JOB = {"do": "submit", "scene": "/s.nff", "outputs": ["/out/a.png"]}


def test_a_job_has_the_settings_that_were_sent():
    settings = {"size": [64, 48], "samples": 4, "depth": 3, "min_weight": 0.5, "highlights": True, "split": "uniform"}
    request = read_request(unpack(pack(JOB | {"settings": settings})[4:]))
    assert isinstance(request, SubmitMessage)
    assert wanted_by(request) == FrameRequest("/s.nff", Settings((64, 48), 4, 3, 0.5, True, "uniform"))


def test_a_job_has_the_view_that_was_sent():
    view = {"eye": [0, 2, 8], "up": [0.0, 1.0, 0.0], "fov": 30, "crease": 0, "lights": [[1, 2, 3], [1, 2, 3, 0, 0, 1]]}
    request = read_request(unpack(pack(JOB | {"settings": view | {"samples": 2}})[4:]))
    assert isinstance(request, SubmitMessage)
    wanted = wanted_by(read_job(request.model_dump(mode="json")))
    lights = ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0, 0.0, 0.0, 1.0))
    seen = View((0.0, 2.0, 8.0), up=(0.0, 1.0, 0.0), fov=30.0, lights=lights, crease=0.0)
    assert wanted == FrameRequest("/s.nff", Settings(samples=2), view=seen)
    for camera in ("top", 2):
        assert wanted_by(read_request(JOB | {"settings": {"camera": camera}})).view == View(camera=camera)


def test_a_job_has_the_turntable_and_the_program_that_were_sent():
    marble = str(SCENES / "programs" / "marble.py")
    more = {"turntable": {"frames": 9, "scene": True}, "program": marble, "frames": [2, 2]}
    wanted = wanted_by(read_job(read_request(unpack(pack(JOB | more)[4:])).model_dump(mode="json")))
    assert wanted == FrameRequest("/s.nff", Settings(program=read_program(marble)), Turntable(9, True), (2, 2))


def test_a_job_comes_back_from_the_journal_as_it_was():
    request = read_request(JOB | {"frames": [1, 5], "outputs": ["/o/f_%03d.png"], "resume": True, "follow": True})
    kept = read_job(request.model_dump(mode="json"))
    assert kept == request.model_copy(update={"follow": False})


A_PATH = "wanted an absolute path of at most 4096 characters"
A_SIZE = "wanted sides of 1 to 65536 and at most 268,435,456 pixels, such as 640x480"
FRAMES = "wanted the first and the last of at most 100,000 frames, from 1 to 999999999"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"do": "fly"}, "do came as 'fly', wanted submit, follow, cancel, jobs, status, probe, reset or down"),
        ({"do": ["submit"]}, "do came as ['submit'], wanted submit, follow, cancel, .*"),
        ({"scene": "s.nff"}, f"scene came as 's.nff', {A_PATH}"),
        ({"scene": "/s\0.nff"}, f"scene came as '/s\\x00.nff', {A_PATH}"),
        ({"scene": "/" + "x" * 5000}, f"scene came as '/xxx.*xxx', {A_PATH}"),
        ({"scene": 7}, f"scene came as 7, {A_PATH}"),
        ({"program": "torus.py"}, f"program came as 'torus.py', {A_PATH}"),
        ({"turntable": {"frames": 0}}, "turntable.frames came as 0, wanted a whole number from 1 to 1,000,000"),
        ({"turntable": 5}, "turntable came as 5, wanted a number of frames"),
        ({"turntable": {"frames": 3, "speed": 1}}, "the key 'turntable.speed' came, wanted only what submit knows"),
        ({"outputs": []}, "outputs came as [], wanted 1 to 16 absolute paths of at most 4096 characters"),
        ({"outputs": ["/o.png"] * 17}, "outputs came as ['/o.png', .*'/o.png'], wanted 1 to 16 absolute paths .*"),
        ({"outputs": "/o.png"}, "outputs came as '/o.png', wanted 1 to 16 absolute paths .*"),
        (
            {"frames": [1, 2]},
            "/out/a.png: several frames would go to this one file, wanted a number such as %04d .*",
        ),
        (
            {"frames": [1, 2], "outputs": ["/%d/%d.png"]},
            "/%d/%d.png: the output has 2 places for the frame's number, .*",
        ),
        ({"frames": [2, 1], "outputs": ["/%d.png"]}, "frames 2 to 1 came, wanted 1 to 100000 of them"),
        ({"frames": [1, 100_001], "outputs": ["/%d.png"]}, "frames 1 to 100001 came, wanted 1 to 100000 of them"),
        ({"frames": [-1, 1], "outputs": ["/%d.png"]}, f"frames came as [-1, 1], {FRAMES}"),
        ({"frames": [1, 2, 3], "outputs": ["/%d.png"]}, f"frames came as [1, 2, 3], {FRAMES}"),
        ({"frames": 5}, f"frames came as 5, {FRAMES}"),
        ({"settings": {"size": [0, 5]}}, f"size came as 0x5, {A_SIZE}"),
        ({"settings": {"size": [99999, 99999]}}, f"size came as 99999x99999, {A_SIZE}"),
        ({"settings": {"size": [60000, 60000]}}, f"size came as 60000x60000, {A_SIZE}"),
        ({"settings": {"size": [5.5, 5]}}, f"size came as [5.5, 5], {A_SIZE}"),
        ({"settings": {"size": "5x5"}}, f"size came as '5x5', {A_SIZE}"),
        ({"settings": {"samples": True}}, "samples came as True, wanted a whole number from 1 to 4294967296"),
        ({"settings": {"samples": "4"}}, "samples came as '4', wanted a whole number from 1 to 4294967296"),
        ({"settings": {"min_weight": float("nan")}}, "min_weight came as nan, wanted a number from 0 to 1e[+]30"),
        ({"settings": {"split": "clever"}}, "split came as 'clever', wanted balanced or uniform"),
        ({"settings": {"speed": 9}}, "the key 'settings.speed' came, wanted only what submit knows"),
        ({"settings": {"eye": [0, 1]}}, "eye came as [0, 1], wanted three finite numbers of at most 1e30 in size .*"),
        ({"settings": {"eye": [0, 1, float("nan")]}}, "eye came as [0, 1, nan], wanted three finite numbers .*"),
        ({"settings": {"at": [0, 1, 1e31]}}, "at came as .*, wanted three finite numbers of at most 1e30 in size .*"),
        ({"settings": {"fov": 0}}, "fov came as 0.*, wanted an angle above 0 and at most 179.99 degrees"),
        ({"settings": {"fit": "behind"}}, "fit came as 'behind', wanted one of: front, back, .*"),
        (
            {"settings": {"lights": [[1, 2]]}},
            "lights came as [[1, 2]], wanted a list of at most 256, each a position x, y, z, .*",
        ),
        ({"settings": {"fit": "top", "eye": [0, 1, 2]}}, "--fit .* and --from .* came, wanted one of them"),
        ({"settings": {"camera": 1.5}}, "camera came as 1.5, wanted the name of a camera, or its number from 1"),
        ({"settings": []}, "settings came as [], wanted a map"),
        ({"budget": 0}, "budget came as 0, wanted a whole number from 1 to 4294967295"),
        ({"transfer": "gamma"}, "transfer came as 'gamma', wanted srgb or linear"),
        ({"client": "x" * 65}, "client came as 'xxx.*xxx', wanted text of at most 64 characters"),
        ({"password": "x"}, "the key 'password' came, wanted only what submit knows"),
    ],
)
def test_what_is_wrong_is_named_with_what_came_and_what_was_wanted(change, words):
    with pytest.raises(ProtocolError) as caught:
        read_request(JOB | change)
    assert fullmatch(words, str(caught.value)), str(caught.value)
    assert len(str(caught.value)) < 400


def fullmatch(words, said):
    """Whether a text is these words, in which .* stands for any others and [+] for a plus."""
    return re.fullmatch(re.escape(words).replace(r"\.\*", ".*").replace(r"\[\+\]", "[+]"), said)


def test_a_request_without_what_is_needed_names_it():
    for message, words in (
        ({}, "do is missing, wanted submit, .*"),
        ({"do": "follow"}, "job is missing, wanted the .*"),
    ):
        with pytest.raises(ProtocolError, match=words):
            read_request(message)


values = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.lists(st.integers(), max_size=3)
)
names = st.sampled_from(["do", "job", "jobs", "scene", "frames", "outputs", "settings", "finish", "ended", "x"])
whats = st.sampled_from(["submit", "follow", "cancel", "jobs", "status", "reset", "down", "hello"])


@steady(300)
@given(st.dictionaries(names, values, max_size=5), whats)
def test_any_map_is_a_request_or_a_protocol_error(message, what):
    try:
        request = read_request(message | {"do": what})
    except ProtocolError:
        return
    assert request.do == what
