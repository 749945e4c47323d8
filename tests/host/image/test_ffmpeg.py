"""Which ffmpeg encodes films: the computer's, that of the extra `mp4`, or none."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

from raygrid.host.image.ffmpeg import SHIPS, find_ffmpeg, need_ffmpeg
from raygrid.host.image.moving_pictures import check_played, waiting
from raygrid.node.errors import OutputError


@pytest.fixture
def no_path(tmp_path, monkeypatch):
    """No program is on the PATH."""
    monkeypatch.setenv("PATH", str(tmp_path))


def shipping(monkeypatch, gives):
    """An extra that ships ffmpeg. `gives`: what it says where that is."""
    extra = ModuleType(SHIPS)
    extra.__spec__ = importlib.util.spec_from_loader(SHIPS, None)
    extra.get_ffmpeg_exe = gives
    monkeypatch.setitem(sys.modules, SHIPS, extra)


def test_the_computers_own_comes_first(tmp_path, monkeypatch):
    (tmp_path / "ffmpeg").write_text("#!/bin/sh\n")
    (tmp_path / "ffmpeg").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    shipping(monkeypatch, lambda: "/extra/ffmpeg")
    assert find_ffmpeg() == str(tmp_path / "ffmpeg")


@pytest.mark.usefixtures("no_path")
def test_then_comes_that_of_the_extra(monkeypatch):
    shipping(monkeypatch, lambda: "/extra/ffmpeg")
    assert find_ffmpeg() == need_ffmpeg("a.mp4") == "/extra/ffmpeg"


@pytest.mark.usefixtures("no_path")
def test_without_either_a_film_is_refused_in_one_sentence(tmp_path, monkeypatch):
    def none():
        raise RuntimeError("No ffmpeg exe could be found.")

    words = "there is no ffmpeg on this computer, wanted it for .mp4 (or the extra: pip install 'raygrid[mp4]'), or .gif or .webp instead"
    monkeypatch.setitem(sys.modules, SHIPS, None)
    for _ in range(2):
        assert find_ffmpeg() is None
        with pytest.raises(OutputError, match=f"^{re.escape(f'{tmp_path}/a.mp4: {words}')}$"):
            check_played(f"{tmp_path}/a.mp4")
        shipping(monkeypatch, none)
    check_played(f"{tmp_path}/a.gif")


@pytest.mark.parametrize("whose", ["of the computer", "of the extra"])
def test_a_real_one_makes_a_film(whose, tmp_path, monkeypatch):
    """Frames of four greys, which come out of the film again; odd sides get black."""
    if whose == "of the extra":
        pytest.importorskip(SHIPS, reason="the extra mp4 is not installed: pip install 'raygrid[mp4]'")
        monkeypatch.setenv("PATH", str(tmp_path))
    elif shutil.which("ffmpeg") is None:
        pytest.skip("there is no ffmpeg here: apt-get install ffmpeg")
    film, greys = tmp_path / "a.mp4", (0, 80, 160, 240)
    with waiting() as reel:
        for number, grey in enumerate(greys, 7):
            reel.add(number, np.full((47, 63, 3), grey, np.uint8))
        reel.play(str(film), range(7, 11), 24.0)
    command = [
        need_ffmpeg("a.mp4"),
        "-nostdin",
        "-loglevel",
        "error",
        "-i",
        film,
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    data = subprocess.run(command, capture_output=True, check=True, timeout=60).stdout
    frames = np.frombuffer(data, np.uint8).reshape(4, 48, 64, 3)
    assert np.abs(frames[:, :44, :60].mean(axis=(1, 2, 3)) - greys).max() < 3
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]
