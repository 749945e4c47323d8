"""Requests of clients: what is right comes through as it was meant, anything else is one clear error."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support_cases import steady
from support_render import SCENES

from raygrid.host.frames import Turntable
from raygrid.host.job import Settings
from raygrid.host.program_file import read_program
from raygrid.host.requests import Submit, read_job, read_request
from raygrid.host.scene_store import Wanted
from raygrid.host.wire import pack, unpack
from raygrid.node.errors import ProtocolError

JOB = {"do": "submit", "scene": "/s.nff", "outputs": ["/out/a.png"]}


def test_a_job_has_the_settings_that_were_sent():
    settings = {"size": [64, 48], "samples": 4, "depth": 3, "min_weight": 0.5, "highlights": True, "split": "uniform"}
    request = read_request(unpack(pack(JOB | {"settings": settings})[4:]))
    assert isinstance(request, Submit)
    assert request.wanted() == Wanted("/s.nff", Settings((64, 48), 4, 3, 0.5, True, "uniform"))


def test_a_job_has_the_turntable_and_the_program_that_were_sent():
    marble = str(SCENES / "programs" / "marble.py")
    more = {"turntable": {"frames": 9, "scene": True}, "program": marble, "frames": [2, 2]}
    wanted = read_job(read_request(unpack(pack(JOB | more)[4:])).model_dump(mode="json")).wanted()
    assert wanted == Wanted("/s.nff", Settings(program=read_program(marble)), Turntable(9, True), (2, 2))


def test_a_job_comes_back_from_the_journal_as_it_was():
    request = read_request(JOB | {"frames": [1, 5], "outputs": ["/o/f_%03d.png"], "resume": True, "follow": True})
    kept = read_job(request.model_dump(mode="json"))
    assert kept == request.model_copy(update={"follow": False})


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"do": "fly"}, "fly"),
        ({"scene": "s.nff"}, "scene: .*absolute path"),
        ({"scene": "/s\0.nff"}, "scene: .*absolute path"),
        ({"scene": "/" + "x" * 5000}, "scene: .*4096"),
        ({"scene": 7}, "scene: .*string"),
        ({"program": "torus.py"}, "program: .*absolute path"),
        ({"turntable": {"frames": 0}}, "turntable.frames: .*greater"),
        ({"turntable": {"frames": 3, "speed": 1}}, "turntable.speed: .*not permitted"),
        ({"outputs": []}, "outputs: .*at least 1"),
        ({"outputs": ["/o.png"] * 17}, "outputs: .*at most 16"),
        ({"outputs": "/o.png"}, "outputs: .*list"),
        ({"frames": [1, 2]}, "several frames would go to this one file"),
        ({"frames": [1, 2], "outputs": ["/%d/%d.png"]}, "2 places"),
        ({"frames": [2, 1], "outputs": ["/%d.png"]}, "frames 2 to 1"),
        ({"frames": [1, 100_001], "outputs": ["/%d.png"]}, "frames 1 to 100001"),
        ({"frames": [0, 1], "outputs": ["/%d.png"]}, "frames.0: "),
        ({"frames": [1, 2, 3], "outputs": ["/%d.png"]}, "frames: "),
        ({"settings": {"size": [0, 5]}}, "settings.size.0: "),
        ({"settings": {"size": [5.5, 5]}}, "settings.size.0: "),
        ({"settings": {"samples": True}}, "settings.samples: "),
        ({"settings": {"samples": "4"}}, "settings.samples: "),
        ({"settings": {"min_weight": float("nan")}}, "settings.min_weight: "),
        ({"settings": {"split": "clever"}}, "settings.split: "),
        ({"settings": {"speed": 9}}, "settings.speed: "),
        ({"budget": 0}, "budget: "),
        ({"transfer": "gamma"}, "transfer: "),
        ({"client": "x" * 65}, "client: "),
        ({"password": "x"}, "password: "),
    ],
)
def test_what_is_wrong_is_named(change, pattern):
    with pytest.raises(ProtocolError, match=f"a request came that is none: .*{pattern}") as caught:
        read_request(JOB | change)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


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
