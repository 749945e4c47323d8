"""A terminal for tests: a program on a pseudo-terminal, what it has shown, and what is left on the screen."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

COLUMNS, ROWS = 100, 24
TIMEOUT = 150.0  # seconds; only a failing test takes as long
PIECES = re.compile(r"\x1b\[(\??[\d;]*)([A-Za-z])|([\r\n])|([^\x1b\r\n]+)|(\x1b)")
HIDE, SHOW = "\x1b[?25l", "\x1b[?25h"


class Terminal:
    """A program with a terminal as its standard input, output and error. Use as a context manager; kills it at the end.

    text    all that it has written
    """

    def __init__(
        self,
        arguments: Sequence[str],
        folder: Path,
        environment: dict[str, str] | None = None,
        size: tuple[int, int] = (COLUMNS, ROWS),
    ) -> None:
        self.text = ""
        columns, rows = size
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        plain = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "COLUMNS", "LINES")}
        self.process = subprocess.Popen(
            arguments,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd=folder,
            env=plain | {"TERM": "xterm-256color"} | (environment or {}),
            start_new_session=True,
            preexec_fn=_take_terminal,
        )
        os.close(slave)

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Read until the text matches; fails the test if the program ends before or too much time passes."""
        deadline = time.monotonic() + TIMEOUT
        while (found := re.search(pattern, self.text)) is None:
            assert self._read(deadline), f"{pattern!r} did not come; the terminal shows:\n{self.screen}"
        return found

    def wait_end(self) -> int:
        """Read to the end; returns the exit code."""
        deadline = time.monotonic() + TIMEOUT
        while self._read(deadline):
            pass
        return self.process.wait(TIMEOUT)

    def press(self, keys: str) -> None:
        """Type; "\\x03" is Ctrl-C."""
        os.write(self._master, keys.encode())

    @property
    def screen(self) -> str:
        """What is to be seen now, without blank ends of lines."""
        return "\n".join(line.rstrip() for line in _drawn(self.text)).rstrip()

    def _read(self, deadline: float) -> bool:
        ready, _, _ = select.select([self._master], [], [], max(0.0, deadline - time.monotonic()))
        assert ready, f"nothing came within {TIMEOUT} seconds; the terminal shows:\n{self.screen}"
        try:
            piece = os.read(self._master, 65536)
        except OSError:  # EIO: nobody holds the other side any more
            return False
        self.text += piece.decode(errors="replace")
        return bool(piece)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self._master)


def _take_terminal() -> None:
    """In the child: standard input becomes the controlling terminal, so that Ctrl-C is a signal."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def _drawn(text: str) -> list[str]:
    """The screen after these characters: only what progress bars use, and no scrolling."""
    lines, row, column = [""], 0, 0
    for code, letter, end, plain, lone in PIECES.findall(text):
        assert not lone, "an escape sequence that this terminal does not know"
        if end == "\r":
            column = 0
        elif end == "\n":
            row += 1
        elif letter == "A":
            row -= int(code or 1)
        elif letter == "K":
            assert code == "2", "only whole lines are erased"
            lines[row] = ""
        elif plain:
            for character in plain:
                if column == COLUMNS:
                    row, column = row + 1, 0
                lines += [""] * (row + 1 - len(lines))
                lines[row] = lines[row].ljust(column)[:column] + character + lines[row][column + 1 :]
                column += 1
        else:
            assert letter in ("m", "h", "l"), f"an escape sequence that this terminal does not know: {code}{letter}"
        lines += [""] * (row + 1 - len(lines))
    return lines
