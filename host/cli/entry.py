"""Begins the program: Ctrl-C before anything is imported ends it as quietly as later."""

from __future__ import annotations

import signal


def main() -> None:
    """Import the command line and run it.

    While modules are imported there is nothing to clean up, and an exception out of the midst of one ends in a
    traceback, or as a failed import of something else. So until commands take it (`cli.main`) Ctrl-C ends the process as
    it does any other.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is ignored, as in a shell's background
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from raygrid.host.cli.main import main as run

    run()
