"""What became of a job, and what is passed on of it."""

import logging

import pytest

from raygrid.host.client.job_events import Result, end_of, result_of, tell
from raygrid.host.render.progress import RenderProgress
from raygrid.node.errors import ArrayError

FACTS = {"first": 1, "last": 2, "outputs": ["/a/f_%04d.png", "/a/all.gif"]}
END = {"state": "done", "frames": 2, "skipped": 1, "error": ""}


def test_a_result_names_the_files_in_the_order_of_frames():
    files = ("/a/f_0001.png", "/a/f_0002.png", "/a/all.gif")
    assert result_of(7, FACTS, END) == Result(7, files, 2, 1)
    alone = {"first": None, "last": None, "outputs": ["/a/b.png", "/a/b.npy"]}
    assert result_of(8, alone, END | {"frames": 1}).files == ("/a/b.png", "/a/b.npy")


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ("failed", "job 7 failed: no disk"),
        ("cancelled", "job 7 was cancelled"),
        ("queued", "job 7 is not done: no disk"),
    ],
)
def test_a_job_that_is_not_done_is_an_error(state, words):
    with pytest.raises(ArrayError, match=f"^{words}$"):
        result_of(7, FACTS, END | {"state": state, "error": "no disk"})


def test_the_end_of_a_job_is_made_of_what_is_said_of_it():
    facts = {"is": "following", "job": 7, **FACTS, **END}
    assert end_of(facts) == facts | {"is": "event", "what": "end"}
    assert result_of(7, facts, end_of(facts)) == result_of(7, facts, END)


def test_events_are_passed_on(caplog):
    told = []
    moved = {"what": "progress", "phase": "trace", "part": 0.5, "in_flight": 9, "frame": None}
    with caplog.at_level(logging.INFO, "raygrid"):
        for event in (moved, {"what": "note", "text": "no light"}, {"what": "fault", "text": "lost"}, {"what": "end"}):
            tell(event, "room.glb", told.append)
        tell(moved, "room.glb", None)
    assert told == [RenderProgress("trace", 0.5, 9, None)]
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("INFO", "room.glb: no light"),
        ("WARNING", "lost"),
    ]
