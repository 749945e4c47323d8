"""The options of a view: all commands that render have them, they mean the same everywhere, and errors are usage errors."""

import re

import pytest
from click.testing import CliRunner
from support.cli import TINY, here, misused

from raygrid.host.cli.main import cli
from raygrid.host.render.given_settings import SETTINGS, parted
from raygrid.host.scene.view import VIEW

COMMANDS = ("render", "submit", "simulate", "trace", "jam", "export")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_renders_has_them(command):
    names = {parameter.name for parameter in cli.commands[command].params}
    assert set(VIEW) <= names


def test_they_are_settings_and_told_from_those_of_the_frame():
    frame, view = parted({"size": (1, 2), "eye": (0, 0, 1), "crease": None})
    assert (frame, view) == ({"size": (1, 2)}, {"eye": (0, 0, 1), "crease": None})
    assert set(VIEW) < set(SETTINGS)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--from", "0,nan,0"], "'0,nan,0' came, wanted three finite numbers such as 0,2,8"),
        (["--from", "0,0"], "'0,0' came, wanted three finite numbers"),
        (["--at", "1,2,1e31"], "'1,2,1e31' came, wanted three finite numbers"),
        (["--up", "x"], "'x' came, wanted three finite numbers"),
        (["--fov", "0"], "0 came, wanted an angle above 0 and at most 179.99"),
        (["--fov", "180"], "'180' came, wanted a number from 0.0 to 179.99"),
        (["--fov", "nan"], "'nan' came, wanted a number"),
        (["--light", "1,2,3,4"], "'1,2,3,4' came, wanted three finite numbers such as 5,8,5, or six"),
        (["--light", "1,2,3,1,-1,1"], "came, wanted three finite numbers"),
        (["--background", "0,0,-1"], "'0,0,-1' came, wanted three finite numbers of 0 or more"),
        (["--crease", "181"], "'181' came, wanted a number from 0.0 to 180.0"),
        (["--fit", "behind"], "'behind' is not one of"),
        (["--fit", "top", "--from", "1,2,3"], "--fit (in Python fit=) and --from (in Python eye=) came"),
        (["--from", "1,2,3", "--at", "1,2,3"], "tiny.nff: the camera looks from (1, 2, 3) at that same point"),
        (["--camera", "top"], "tiny.nff: camera came as 'top', wanted one of: 1"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_wrong_usage(options, words, tmp_path):
    misused(here("export", TINY, "-o", str(tmp_path / "x.pov"), *options), "export", f".*{re.escape(words)}.*")
    assert not (tmp_path / "x.pov").exists()


def test_a_view_is_in_what_is_written(tmp_path):
    path = tmp_path / "x.pov"
    options = [
        "--from",
        "1,2,9",
        "--fov",
        "30",
        "--light",
        "5,8,5,1,0.5,0.25",
        "--light",
        "0,9,0",
        "--background",
        "0,0,1",
    ]
    ran = CliRunner().invoke(cli, ["export", TINY, "-o", str(path), *options], catch_exceptions=False)
    assert ran.exit_code == 0, ran.output
    text = path.read_text()
    assert text.count("light_source") == 2
    assert "background { rgb <0,0,1> }" in text
