"""What all commands have in common: defaults from the environment, exit codes in the help, completion."""

import os
import shutil
import subprocess

import click
import pytest
from support.cli import TINY, as_process, here, misused
from support.paths import ROOT

from raygrid.host.cli.conventions import EXIT_CODES, VARIABLES, WITHOUT
from raygrid.host.cli.main import cli

COMMANDS = list(cli.commands.items())


def option_of(command: str, spelling: str) -> click.Option:
    return next(option for option in cli.commands[command].params if spelling in option.opts)  # type: ignore[return-value]


def test_options_of_a_name_take_the_same_variable():
    taken = {
        (name, spelling): option.envvar
        for name, command in COMMANDS
        for option in command.params
        for spelling in option.opts
        if isinstance(option, click.Option) and option.envvar is not None
    }
    assert set(taken.values()) == set(VARIABLES.values())
    assert all(VARIABLES[spelling] == variable for (_, spelling), variable in taken.items() if spelling in VARIABLES)
    assert not set(taken) & WITHOUT
    for name, spelling in WITHOUT:
        assert option_of(name, spelling).envvar is None


def test_help_and_document_name_every_variable():
    page = (ROOT / "docs" / "commands.md").read_text()
    for spelling, variable in VARIABLES.items():
        assert f"| `{variable}` | `{spelling}` |" in page
        named = [name for name, command in COMMANDS if any(spelling in option.opts for option in command.params)]
        helped = " ".join(here(named[-1], "--help").out.split())
        assert variable in helped or (named[-1], spelling) in WITHOUT


def test_a_variable_is_a_default_and_an_option_overrules_it(monkeypatch):
    monkeypatch.setenv("RAYGRID_ARRAY", "1x2x3")
    monkeypatch.setenv("RAYGRID_SIZE", "32x24")
    monkeypatch.setenv("RAYGRID_SAMPLES", "")  # as if it were not there
    made = cli.commands["render"].make_context("render", [TINY, "--size", "16x12"])
    assert (made.params["shape"], made.params["size"], made.params["samples"]) == ((1, 2, 3), (16, 12), None)
    assert cli.commands["jam"].make_context("jam", [TINY]).params["size"] is None


def test_a_bad_variable_is_named(monkeypatch):
    monkeypatch.setenv("RAYGRID_SIZE", "big")
    wanted = r"--size: 'big' came, wanted two whole numbers such as 512x384"
    misused(here("render", TINY), "render", rf"{wanted} \(from the variable RAYGRID_SIZE\)")
    misused(here("render", TINY, "--size", "big"), "render", wanted)


def test_a_name_of_the_environment_does_not_keep_probe_from_a_recording(monkeypatch, tmp_path):
    monkeypatch.setenv("RAYGRID_NAME", "film")
    outcome = here("probe", "--replay", str(tmp_path / "gone.jsonl"))
    assert outcome.code == 1
    assert "gone.jsonl" in outcome.err


@pytest.mark.parametrize(("name", "command"), [*COMMANDS, ("", cli)], ids=lambda value: str(value)[:12])
def test_every_help_says_what_it_does_shows_examples_and_ends_with_exit_codes(name, command):
    text = here(*([name] if name else []), "--help").out
    assert text.startswith("Usage: raygrid")
    assert f"raygrid {name}".rstrip() in text.partition("Examples:")[2]
    assert "Exit codes: " + ", ".join(f"{code} {what}" for what, code in EXIT_CODES.items()) in text
    for option in command.params:
        assert not isinstance(option, click.Option) or option.help


# ---- completion ----


def completed(*words: str) -> list[str]:
    """What a shell is told of the last word: `kind,value`."""
    environment = {"_RAYGRID_COMPLETE": "bash_complete", "COMP_WORDS": " ".join(["raygrid", *words])}
    outcome = as_process(environment=environment | {"COMP_CWORD": str(len(words))})
    assert outcome.err == ""
    return outcome.out.split()


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["re"], {"plain,render", "plain,reset"}),
        (["render", "--spl"], {"plain,--split"}),
        (["render", "x.nff", "--split", ""], {"plain,balanced", "plain,uniform"}),
        (["render", "sc"], {"file,sc"}),
        (["render", "x.nff", "-o", "o"], {"file,o"}),
        (["law", "a.nff", "b"], {"file,b"}),
        (["simulate", "x.nff", "--cost", "80"], {"file,80", "plain,8086", "plain,8086-soft"}),
        (["predict", "sc"], {"file,sc"}),
        (["predict", "x.nff", "--cost", "t"], {"file,t", "plain,t800"}),
        (["schema", "s"], {"plain,scene", "plain,sample"}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_commands_options_choices_and_files_are_completed(words, wanted):
    assert set(completed(*words)) == wanted


def test_names_of_arrays_that_are_up_are_completed(monkeypatch):
    class Up:
        name = "film"

    monkeypatch.setattr("raygrid.host.client.service_files.running", lambda: [Up])
    option = option_of("status", "--name")
    context = click.Context(cli.commands["status"])
    assert [item.value for item in option.type.shell_complete(context, option, "fi")] == ["film"]
    assert option.type.shell_complete(context, option, "x") == []


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_what_is_printed_for_bash_defines_the_completion():
    script = here("completion", "bash")
    assert (script.code, script.err) == (0, "")
    check = f"{script.out}\ncomplete -p raygrid"
    said = subprocess.run(["bash", "-c", check], capture_output=True, text=True, env=os.environ, timeout=60)
    assert said.stdout == "complete -o nosort -F _raygrid_completion raygrid\n"
    for shell in ("zsh", "fish"):
        assert "_RAYGRID_COMPLETE" in here("completion", shell).out


@pytest.mark.parametrize(
    ("begun", "wanted"),
    [
        ("", ["depth", "normal", "surface", "material"]),
        ("depth,", ["depth,normal", "depth,surface", "depth,material"]),
        ("depth,ma", ["depth,material"]),
    ],
)
def test_layers_are_completed_one_after_the_other(begun, wanted):
    assert completed("render", "--layers", begun) == [f"plain,{value}" for value in wanted]
