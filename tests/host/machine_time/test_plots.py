"""Plots are drawn into files, and whoever plots in the same process does not notice."""

import sys

import pytest

from raygrid.host.machine_time.plots import new_figure, save_figure
from raygrid.node.errors import OutputError


def test_the_backend_of_the_caller_stays_and_no_figure_is_kept(tmp_path):
    import matplotlib

    before = matplotlib.get_backend()
    matplotlib.use("svg")  # any other than what would be chosen
    try:
        import matplotlib.pyplot

        kept = matplotlib.pyplot.get_fignums()
        figure = new_figure(3, 2)
        figure.subplots().plot([0, 1], [1, 0])
        save_figure(figure, tmp_path / "plot.png")
        assert matplotlib.get_backend() == "svg"
        assert matplotlib.pyplot.get_fignums() == kept
    finally:
        matplotlib.use(before)
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_without_matplotlib_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(OutputError, match=r"^plots need matplotlib: pip install matplotlib$"):
        new_figure(3, 2)
