"""Programs as files: read and checked before any array hears of them."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from raygrid.host.files.input_guard import note
from raygrid.host.scene.file_access import read_bytes
from raygrid.host.scene.load import check_program_name
from raygrid.node.errors import ProtocolError, SceneError
from raygrid.node.programs import Compiled, Program, make_program, program_order


def read_program(path: str | Path) -> Program:
    """The program of a file. Raises SceneError for what is none."""
    file = Path(path)
    check_program_name(path)
    note(file, "the same file as the program")
    try:
        return make_program(file.stem, read_bytes(file).decode("utf-8"))
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: the program is no text ({error})") from None
    except ProtocolError as error:
        raise SceneError(f"{path}: {error}") from None


@lru_cache(maxsize=4)
def for_host(program: Program) -> Compiled:
    """The program compiled for what the host does itself: the rays that never enter the world box."""
    from raygrid.node.runtime import ready_program

    found = ready_program(program_order(program), allowed=True)
    assert found is not None
    return found
