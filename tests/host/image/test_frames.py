"""Frames of a job: their numbers, the names of their files, and which files are whole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin
from support.render import SCENES, rendered

from raygrid.host.image.frames import (
    check_job,
    check_patterns,
    has_number,
    is_played,
    parse_frames,
    path_of,
    pattern_of,
    wants_shot,
)
from raygrid.host.image.resume_check import KEYWORD, frame_is_there, is_whole, save_marked
from raygrid.host.scene.load import load_scene
from raygrid.node.errors import OutputError

# ---- numbers and names ----


def test_frames_are_read():
    assert parse_frames("1-250") == (1, 250)
    assert parse_frames("7") == (7, 7)


@pytest.mark.parametrize("text", ["", "a", "0", "0-3", "1-", "-1", "5-4", "1-2-3", "1.5", "1-100001", "²", "9" * 10])
def test_what_are_no_frames_is_refused(text):
    with pytest.raises(ValueError, match="wanted"):
        parse_frames(text)


@pytest.mark.parametrize(
    ("pattern", "path"),
    [("f_%04d.png", "f_0007.png"), ("%d.png", "7.png"), ("%3d.png", "  7.png"), ("100%%_%02d.npy", "100%_07.npy")],
)
def test_the_number_stands_where_the_pattern_says(pattern, path):
    assert path_of(pattern, 7) == path


def test_a_doubled_percent_sign_is_one():
    assert path_of("50%%.png", None) == "50%.png"
    assert not has_number("50%%d.png")
    assert path_of("50%%d.png", 7) == "50%d.png"


@given(st.text(alphabet="%d04s.a", max_size=8), st.integers(1, 10**9 - 1))
def test_every_name_is_a_pattern_that_is_understood_or_refused(name, frame):
    assert path_of(pattern_of(name), frame) == name
    try:
        numbered = has_number(name)
    except OutputError:
        assert "%" in name
        return
    assert numbered == (path_of(name, frame) != path_of(name, frame + 1))


@pytest.mark.parametrize("pattern", ["%s.png", "%5.2d.png", "50%.png", "%0d.png", "%-4d.png", "%%%.png", "%"])
def test_a_percent_sign_that_means_nothing_is_refused(pattern):
    with pytest.raises(OutputError, match=r"a % in its name that is no number, wanted one such as %04d, or %% for a %"):
        check_patterns([pattern], None, None, False)


def test_several_frames_want_one_place():
    with pytest.raises(
        OutputError, match=r"f.png: several frames would go to this one file, wanted a number such as %04d"
    ):
        check_patterns(["f.png"], None, (1, 2), True)
    with pytest.raises(OutputError, match=r"f.json: statistics of several frames came"):
        check_patterns(["f.gif"], "f.json", (1, 2), True)
    check_patterns(["f.png"], "f.json", (3, 3), True)
    check_patterns(["f.gif", "f.mp4", "f.webp", "%d.png"], "%d.json", None, True)
    for shot in (True, False):
        with pytest.raises(OutputError, match="2 places"):
            check_patterns(["%d_%d.png"], None, (3, 3), shot)


def test_what_plays():
    assert [is_played(name, True) for name in ("a.gif", "a.webp", "a.mp4", "a.png", "%d.gif", "%d.webp")] == [
        *(True, True, True),
        *(False, False, False),
    ]
    assert [is_played(name, False) for name in ("a.gif", "a.webp", "a.mp4")] == [True, False, True]


def test_when_a_shot_is_wanted():
    assert wants_shot((1, 1), False, ["a.png"])
    assert wants_shot(None, True, ["a.png"])
    assert wants_shot(None, False, ["a.npy", "a_%04d.png"])
    assert not wants_shot(None, False, ["a.webp", "a%%d.png"])


def test_a_job_that_names_no_frames_has_no_numbers():
    check_job(["a.png", "50%%.png"], "a.json", None)
    for outputs, stats in ((["%d.png"], None), (["a.gif"], None), (["a.png"], "%d.json")):
        with pytest.raises(OutputError, match="one of several frames and none were named"):
            check_job(outputs, stats, None)


# ---- files that are whole ----


@pytest.fixture(scope="module")
def picture():
    return rendered(load_scene(SCENES / "tiny.nff"), size=(32, 24))


def never(path, digest):
    return False


def always(path, digest):
    return True


def test_a_png_says_itself_what_it_is(picture, tmp_path):
    file = tmp_path / "a.png"
    save_marked(picture, str(file), "srgb", "digest")
    with Image.open(file) as opened:
        assert np.array_equal(np.array(opened), picture.bytes())
    assert is_whole(str(file), "digest", 32, 24, never)
    assert not is_whole(str(file), "another", 32, 24, never)
    assert not is_whole(str(file), "digest", 32, 25, never)


def test_a_png_whose_pixels_were_edited_is_another(picture, tmp_path):
    """Its text was kept, as editors do."""
    file = tmp_path / "a.png"
    save_marked(picture, str(file), "srgb", "digest")
    with Image.open(file) as opened:
        edited, text = opened.copy(), opened.info[KEYWORD]
    for pixels, whole in ((edited.copy(), True), (edited, False)):
        if not whole:
            red, green, blue = pixels.getpixel((3, 5))
            pixels.putpixel((3, 5), (red, green, blue ^ 1))
        kept = PngImagePlugin.PngInfo()
        kept.add_text(KEYWORD, text)
        pixels.save(file, pnginfo=kept)
        assert is_whole(str(file), "digest", 32, 24, never) == whole
    assert frame_is_there([(str(file), "digest")], None, (32, 24), always)


def test_a_png_of_before_its_pixels_had_a_digest_does_not_match(picture, tmp_path):
    file = tmp_path / "a.png"
    picture.save(file, texts={KEYWORD: "digest"})
    assert not is_whole(str(file), "digest", 32, 24, never)
    assert is_whole(str(file), "digest", 32, 24, always)


@pytest.mark.parametrize("suffix", [".jpg", ".npy", ".png", ".ppm", ".tif"])
def test_others_are_vouched_for_by_the_journal(picture, tmp_path, suffix):
    file = tmp_path / f"a{suffix}"
    picture.save(file)
    assert is_whole(str(file), "digest", 32, 24, always)
    assert not is_whole(str(file), "digest", 32, 24, never)
    assert not is_whole(str(file), "digest", 24, 32, always)


@pytest.mark.parametrize("suffix", [".jpg", ".npy", ".png", ".ppm", ".tif"])
def test_a_torn_file_is_not_whole(picture, tmp_path, suffix):
    file = tmp_path / f"a{suffix}"
    picture.save(file, texts={KEYWORD: "digest"})
    data = file.read_bytes()
    for length in (0, 10, len(data) // 2, len(data) - 30):
        file.write_bytes(data[:length])
        assert not is_whole(str(file), "digest", 32, 24, always), length


def test_a_png_without_its_very_end_is_not_whole(picture, tmp_path):
    file = tmp_path / "a.png"
    save_marked(picture, str(file), "srgb", "digest")
    data = file.read_bytes()
    for length in range(len(data) - 20, len(data)):
        file.write_bytes(data[:length])
        assert not is_whole(str(file), "digest", 32, 24, always), len(data) - length


def test_what_is_no_file_is_not_whole(tmp_path):
    assert not is_whole(str(tmp_path), "digest", 32, 24, always)
    assert not is_whole(str(tmp_path / "none.png"), "digest", 32, 24, always)
    (tmp_path / "pickle.npy").write_bytes(b"\x80\x04N.")
    assert not is_whole(str(tmp_path / "pickle.npy"), "digest", 32, 24, always)
