"""The program's beginning: Ctrl-C before there is anything to clean up ends it without a word."""

from __future__ import annotations

import signal
import subprocess
import sys
import tomllib

import pytest
from support import paths

# Ctrl-C comes while this module is imported, wherever that is in what the program imports.
INTERRUPT = """
import os, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
sys.argv = ["raygrid", "--help"]
from {place} import main
main()
"""
PROJECT = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
PLACE, _, MAIN = PROJECT["scripts"]["raygrid"].partition(":")  # what the command calls


@pytest.mark.parametrize("module", ["raygrid.host.cli.main", "click", "raygrid.host.cli.group_service"])
def test_control_c_while_modules_are_imported_is_quiet(module):
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPT.format(module=module, place=PLACE)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")  # which a shell shows as 130


def test_the_program_begins_there():
    assert (PLACE, MAIN) == ("raygrid.host.cli.entry", "main")


def test_what_is_imported_is_declared():
    assert any(wanted.startswith("llvmlite>=") for wanted in PROJECT["dependencies"])
