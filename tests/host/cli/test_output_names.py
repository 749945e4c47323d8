"""Names of outputs: `raygrid render` and `raygrid submit` read them by one grammar, and say the same of each."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.cli import here
from support.render import SCENES

from raygrid.host.cli.commands import submit
from raygrid.host.cli.commands.render_request import RenderRequest
from raygrid.host.image.frames import FrameNames
from raygrid.node.errors import ArrayError

TINY = str(SCENES / "tiny.nff")


@pytest.fixture(scope="module", autouse=True)
def nothing_begins(tmp_path_factory):
    """Commands end where the array would be launched or asked, and say what they would write."""

    def stop(request):
        names = FrameNames.checked(request.outputs, request.stats, request.frames, request.of_shot)
        raise ArrayError(f"of frame 7: {list(names.every([7 if request.of_shot else None]))}")

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("here"))
        patch.setattr(RenderRequest, "launching", lambda request, _reporter: stop(request))
        patch.setattr(submit, "_frames", stop)
        yield


def said(command: str, *arguments: str) -> tuple[int, str]:
    """The exit code and the one line of a command, without its own name."""
    outcome = here(command, TINY, *arguments)
    assert outcome.out == ""
    (line,) = outcome.err.splitlines()
    return outcome.code, line.replace(f"raygrid {command}", "raygrid")


@pytest.mark.parametrize("frames", [(), ("--frames", "7"), ("--frames", "1-7")], ids=" ".join)
@given(st.text("%d04s_1", max_size=9), st.sampled_from([".png", ".gif", ".npy", ".json", ""]))
@example("100%_%04d", ".png")
@example("100%%_%04d", ".png")
@example("%d_%d", ".png")
@example("100%%", ".gif")
def test_render_and_submit_say_the_same_of_a_name(frames, stem, suffix):
    name = f"f{stem}{suffix}"
    assert said("render", *frames, "-o", name) == said("submit", *frames, "-o", name)
    outputs = ("-o", "p%d.png", "--stats", name)
    assert said("render", *frames, *outputs) == said("submit", *frames, *outputs)


def test_what_is_said_of_a_percent_sign():
    code, line = said("render", "-o", "100%_%04d.png")
    assert code == 2
    assert "a % in its name that is no number, wanted one such as %04d, or %% for a %" in line
    assert said("submit", "-o", "100%%_%04d.png") == (1, "raygrid: of frame 7: ['100%_0007.png']")
