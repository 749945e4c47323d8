"""Remarks reach the logger, and those of warnings who ask for them."""

import logging
import subprocess
import sys
import warnings

import pytest

import raygrid
from raygrid.host.text.remarks import RemarkWarning, remark


def test_a_remark_is_logged_and_its_level_kept(caplog):
    with caplog.at_level(logging.INFO, "raygrid"):
        remark("room.obj: 100 % grey")
        remark("a node was lost", logging.WARNING)
    assert [(record.name, record.levelname, record.getMessage()) for record in caplog.records] == [
        ("raygrid", "INFO", "room.obj: 100 % grey"),
        ("raygrid", "WARNING", "a node was lost"),
    ]


@pytest.mark.parametrize(("action", "count"), [("always", 1), ("ignore", 0)])
def test_who_asks_is_warned(action, count):
    assert raygrid.RemarkWarning is RemarkWarning
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter(action, RemarkWarning)
        remark("no light")
    assert [str(found.message) for found in caught] == ["no light"] * count
    assert all(found.filename == __file__ for found in caught)  # the line of the caller, not ours
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RemarkWarning, match=r"^no light$"):
            remark("no light")


def test_python_says_nothing_of_remarks_by_itself_but_of_what_nobody_should_miss():
    script = (
        "import logging, warnings\nfrom raygrid.host.text.remarks import remark\nremark('small')\n"
        "with warnings.catch_warnings():\n    warnings.resetwarnings()\n    remark('small')\n"
        "remark('large', logging.WARNING)"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "large\n")
    run = subprocess.run([sys.executable, "-W", "always", "-c", script], capture_output=True, text=True, timeout=60)
    assert run.stderr.count("RemarkWarning: small") == 1
