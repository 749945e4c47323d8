"""Frames of a job: their numbers, the names of their files, and which files are whole."""

import numpy as np
import pytest
from PIL import Image
from support_render import SCENES, rendered

from raygrid.host.frames import check_pattern, parse_frames, path_of
from raygrid.host.load import load_scene
from raygrid.host.whole import KEYWORD, is_whole
from raygrid.node.errors import OutputError

# ---- numbers and names ----


def test_frames_are_read():
    assert parse_frames("1-250") == (1, 250)
    assert parse_frames("7") == (7, 7)
    assert parse_frames("0-0") == (0, 0)


@pytest.mark.parametrize("text", ["", "a", "1-", "-1", "5-4", "1-2-3", "1.5", "1-100001", "²", "9" * 10])
def test_what_are_no_frames_is_refused(text):
    with pytest.raises(ValueError, match="wanted"):
        parse_frames(text)


@pytest.mark.parametrize(
    ("pattern", "path"),
    [("f_%04d.png", "f_0007.png"), ("%d.png", "7.png"), ("%3d.png", "  7.png"), ("100%_%02d.npy", "100%_07.npy")],
)
def test_the_number_stands_where_the_pattern_says(pattern, path):
    assert path_of(pattern, 7) == path


def test_without_frames_the_name_is_taken_as_it_is():
    assert path_of("50%d.png", None) == "50%d.png"
    check_pattern("50%d%d.png", None)


def test_several_frames_want_one_place():
    for pattern in ("f.png", "%d_%d.png", "%s.png", "%5.2d.png"):
        with pytest.raises(OutputError, match=r"the output has .* wanted one, such as f_%04d\.png"):
            check_pattern(pattern, (1, 2))
    check_pattern("f.png", (3, 3))
    with pytest.raises(OutputError, match="2 places"):
        check_pattern("%d_%d.png", (3, 3))


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
    picture.save(file, texts={KEYWORD: "digest"})
    with Image.open(file) as opened:
        assert np.array_equal(np.array(opened), picture.bytes())
    assert is_whole(str(file), "digest", 32, 24, never)
    assert not is_whole(str(file), "another", 32, 24, never)
    assert not is_whole(str(file), "digest", 32, 25, never)


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
    picture.save(file, texts={KEYWORD: "digest"})
    data = file.read_bytes()
    for length in range(len(data) - 20, len(data)):
        file.write_bytes(data[:length])
        assert not is_whole(str(file), "digest", 32, 24, always), len(data) - length


def test_what_is_no_file_is_not_whole(tmp_path):
    assert not is_whole(str(tmp_path), "digest", 32, 24, always)
    assert not is_whole(str(tmp_path / "none.png"), "digest", 32, 24, always)
    (tmp_path / "pickle.npy").write_bytes(b"\x80\x04N.")
    assert not is_whole(str(tmp_path / "pickle.npy"), "digest", 32, 24, always)
