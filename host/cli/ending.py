"""Runs a command and ends the process: errors become one line and an exit code, signals an exception.

Exit codes: 0 done, 1 failed, 2 usage, 128 + n ended by signal n (Ctrl-C: 130). An error is one line on standard error; with
--debug, or the variable RAYGRID_DEBUG, its traceback stands before it.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from types import FrameType

import click

from raygrid.host.cli.conventions import source_of
from raygrid.host.files.input_guard import noted

DEBUG = "RAYGRID_DEBUG"


class EndedBySignal(BaseException):
    """A signal asked the program to end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def _end(number: int, _frame: FrameType | None) -> None:
    raise EndedBySignal(number)


@contextlib.contextmanager
def _signals_as_exceptions() -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP end the program by way of everything that has to be cleaned up."""
    before = {}
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        with contextlib.suppress(ValueError):  # not in the main thread
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = signal.signal(number, _end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run(cli: click.Group, arguments: list[str]) -> int:
    """Run a command; returns the exit code. Known errors become one line."""
    try:
        with _signals_as_exceptions(), noted():
            code = cli.main(args=arguments, prog_name="raygrid", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return 2
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        command = "raygrid" if context is None else context.command_path
        return _say_misuse(command, _misused(error))
    except EndedBySignal as error:
        name = signal.Signals(error.number).name
        _say("raygrid: stopped" if error.number == signal.SIGINT else f"raygrid: ended by {name}")
        return 128 + error.number
    except Exception as error:
        return _say_failed(error, cli, arguments)


def _say_failed(error: Exception, cli: click.Group, arguments: list[str]) -> int:
    from raygrid.host.text.misuse import Misuse

    if isinstance(error, Misuse):
        return _say_misuse(_command(cli, arguments), _error_line(error).removeprefix("raygrid: "))
    if isinstance(error, OSError) and {"-h", "--help", "--version"} & set(arguments):  # click prints these by itself
        _say(f"raygrid: standard output cannot be written ({error.strerror})")
    else:
        _say(_error_line(error) + _programs_hint(error, cli, _command(cli, arguments)))
    return 1


def _programs_hint(error: Exception, cli: click.Group, words: str) -> str:
    """How the command that was called, or another, is given the program that a scene wants."""
    from raygrid.host.scene.load import WantsProgram

    if not isinstance(error, WantsProgram):
        return ""
    command = cli.commands.get(words.removeprefix("raygrid "))
    options = () if command is None else (option for parameter in command.params for option in parameter.opts)
    return " (--program)" if "--program" in options else f", which {words} does not run: raygrid render --program does"


def _command(cli: click.Group, arguments: list[str]) -> str:
    """The words of the command that was called."""
    return " ".join(["raygrid", *[word for word in arguments if word in cli.commands][:1]])


def _say_misuse(command: str, what: str) -> int:
    _say(f"{command}: {what} ({command} --help says more)")
    return 2


def _misused(error: click.ClickException) -> str:
    """What is wrong with the arguments, as one line."""
    message = " ".join(error.format_message().split())
    if isinstance(error, click.BadParameter) and error.message and error.param is not None:
        names = sorted((*error.param.opts, error.param.human_readable_name), key=lambda name: -name.count("-"))
        message = f"{names[0]}: {' '.join(error.message.split())}{source_of(error)}"
    return message


def _error_line(error: Exception) -> str:
    """An error as one line, behind its traceback if that is wanted."""
    from raygrid.node.errors import RaygridError

    debug = bool(os.environ.get(DEBUG))
    if debug:
        traceback.print_exception(error)
    if isinstance(error, RaygridError):
        return f"raygrid: {' '.join(str(error).split())}"
    if isinstance(error, MemoryError):
        return "raygrid: out of memory"
    if isinstance(error, FileNotFoundError) and not _stands_somewhere():
        return "raygrid: the working directory is gone, wanted one that is there"
    where = "" if debug else " (raygrid --debug shows where)"
    return f"raygrid: a bug: {type(error).__name__}: {' '.join(str(error).split())}{where}"


def _stands_somewhere() -> bool:
    """Whether the working directory is there; without it no relative path means anything."""
    try:
        return bool(os.getcwd())
    except FileNotFoundError:
        return False


def _say(line: str) -> None:
    from raygrid.host.text.clean_text import printable

    line = printable(line)
    with contextlib.suppress(OSError, ValueError):
        click.echo(line, err=True)


def leave(code: int) -> None:
    """End the process without taking every module apart, which takes numba and numpy a fifth of a second.

    What is to be done at the end is done, as Python does it and in its order; if anything of that is not plain, this
    returns, and Python ends as it always does.
    """
    if any(thread is not threading.main_thread() and not thread.daemon for thread in threading.enumerate()):
        return
    atexit._run_exitfuncs()  # each is run once, so that returning from here is safe
    try:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except BrokenPipeError:  # Python has its own words and exit code for it
        return
    except (OSError, ValueError) as error:
        if code == 0:
            _say(f"raygrid: standard output cannot be written ({getattr(error, 'strerror', None) or error})")
        os._exit(code or 1)
    os._exit(code)
