"""How far a render is: told to a function, drawn in a notebook, and told to nobody elsewhere."""

import sys
from types import ModuleType, SimpleNamespace

import pytest

from raygrid.host.render import progress
from raygrid.host.render.progress import RenderProgress, following, in_notebook, traced_part

TRACING = RenderProgress("trace", 0.25, 90, 3)


class Front:
    """A stand-in for IPython, with a kernel or without: what was displayed and updated, as HTML and as text."""

    def __init__(self, kernel):
        shell = SimpleNamespace(kernel=object()) if kernel else SimpleNamespace()
        self.package = ModuleType("IPython")
        self.package.get_ipython = lambda: shell
        self.module = ModuleType("IPython.display")
        self.module.display = self.display
        self.shown = []

    def display(self, drawn, display_id):
        assert display_id
        self.update(drawn)
        return self

    def update(self, drawn):
        self.shown.append((drawn._repr_html_(), repr(drawn)))


@pytest.fixture
def front(monkeypatch, request):
    made = Front(getattr(request, "param", True))
    monkeypatch.setitem(sys.modules, "IPython", made.package)
    monkeypatch.setitem(sys.modules, "IPython.display", made.module)
    return made


def test_a_notebook_shows_a_bar_that_goes_when_the_picture_is_there(front, monkeypatch):
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: clock.now))
    assert in_notebook()
    with following(True, "a<b>.glb") as hook:
        for clock.now, part in ((0.02, 0.25), (0.03, 0.26), (2.0, 0.9)):  # the second comes too soon to be drawn
            hook(TRACING._replace(part=part))
    bar = '<progress max="1"{} style="width:20em;vertical-align:middle"></progress> a&lt;b&gt;.glb, frame 3: tracing {}'
    assert [html.rpartition(",")[0] for html, _ in front.shown] == [
        bar.format(' value="0.250"', "25%"), bar.format(' value="0.900"', "90%"), ""]  # fmt: skip
    assert front.shown[0][1].startswith("a<b>.glb, frame 3: tracing 25%, ")
    assert front.shown[-1] == ("", "")


def test_a_phase_without_a_part_has_a_bar_without_a_value(front):
    with following(True, "room.glb") as hook:
        hook(RenderProgress("load"))
        hook(RenderProgress("collect", 1.0))
    assert ["value" in html for html, _ in front.shown] == [False] * 3
    assert "room.glb: collecting pixels, 0 s" in front.shown[1][0]


def test_the_bar_goes_when_a_render_fails(front):
    with pytest.raises(RuntimeError), following(True, "room.glb") as hook:
        hook(TRACING)
        raise RuntimeError
    assert front.shown[-1] == ("", "")


@pytest.mark.parametrize("front", [False], indirect=True)
def test_ipython_on_a_terminal_shows_none(front):
    assert not in_notebook()
    with following(True, "room.glb") as hook:
        assert hook is None
    assert front.shown == []


def test_nobody_is_told_elsewhere_or_where_it_is_not_wanted(front, monkeypatch):
    with following(False, "room.glb") as hook:
        assert hook is None
    told = []
    with following(told.append, "room.glb") as hook:
        hook(TRACING)
    assert told == [TRACING]
    assert front.shown == []
    monkeypatch.delitem(sys.modules, "IPython")
    with following(True, "room.glb") as hook:
        assert hook is None
    assert "IPython" not in sys.modules


def test_a_part_is_what_is_born_of_the_samples_and_what_has_died_of_that():
    now = SimpleNamespace(primaries=50, born=[60, 40], died=[30, 20])
    assert traced_part(now, 100) == pytest.approx(0.25)
    assert traced_part(now, 10) == pytest.approx(0.5)
    assert traced_part(SimpleNamespace(primaries=0, born=[0], died=[0]), 0) == 0.0
