"""The fault campaign (`benchmarks/faults.py`), a small seeded share of it; the table itself is checked, too."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from support import paths
from support.cli import warm_kernels
from support.processes import no_leftovers

ROOT = paths.ROOT
CAMPAIGN = ROOT / "benchmarks" / "faults.py"
__all__ = ["no_leftovers", "warm_kernels"]
pytestmark = pytest.mark.usefixtures("warm_kernels", "no_leftovers")

QUICK = (  # of the service, one case each
    *("texts of scenes", "files that are none", "numbers at their ends", "clients without manners"),
    *("service killed", "service stopped and continued", "rows of a journal", "file of a journal"),
)
SLOW = {
    "arrays": ["--on", "2x2x2", "--only", "struck", "--only", "fork server stopped"],
    "service": ["--on", "service"],
    "commands": ["--on", "commands"],
}


def run(*arguments: str) -> tuple[int, str]:
    command = [sys.executable, str(CAMPAIGN), "--rounds", "1", "--share", "1", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=800)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.timeout(240)
def test_a_share_of_the_campaign_has_nothing_wrong_no_hang_and_nothing_left():
    # "service killed" is the beginning of two kinds
    code, said = run("--seed", "5", "--on", "service", *(word for kind in QUICK for word in ("--only", kind)))
    assert code == 0, said
    assert re.search(rf"\| all \| \| {len(QUICK) + 1} \| \d+ \| \d+ \| \d+ \| 0 \| 0 \| 0 \|", said), said


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("stage", sorted(SLOW))
def test_one_case_of_every_kind(stage):
    code, said = run("--seed", "6", *SLOW[stage])
    assert code == 0, said
    assert " 0 same, 0 refused, 0 wrong" not in said
