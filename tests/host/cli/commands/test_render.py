"""raygrid render --layers: files of layers, what is refused before the work, and frames that are there already."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from support.cli import here, misused, one_line, warm_kernels
from support.render import SCENES

from raygrid.host.image.layer_pictures import layer_picture

__all__ = ["warm_kernels"]

TINY = str(SCENES / "tiny.nff")
MOBILE = str(SCENES / "mobile.toml")
SMALL = ("--array", "2x1x1", "--size", "32x24", "--samples", "1", "--quiet")
NONE = "depth normal surface material"


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_layers_lie_beside_pictures_and_are_named(tmp_path):
    outputs = [word for suffix in ("png", "npy") for word in ("-o", f"{tmp_path}/a.{suffix}")]
    outcome = here("render", TINY, *SMALL, *outputs, "--layers", "surface, depth", "--stats", f"{tmp_path}/a.json")
    assert (outcome.code, outcome.err) == (0, "")
    names = ["a.png", "a.npy", "a.depth.png", "a.surface.png", "a.depth.npy", "a.surface.npy"]
    assert outcome.out.splitlines() == [f"{tmp_path}/{name}" for name in names]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, "a.json"])
    for layer in ("depth", "surface"):
        values = np.load(tmp_path / f"a.{layer}.npy")
        assert values.shape == (24, 32)
        with Image.open(tmp_path / f"a.{layer}.png") as image:
            np.testing.assert_array_equal(np.asarray(image), layer_picture(layer, values))
    runs = json.loads((tmp_path / "a.json").read_text())["layers"]["surfaces"]
    numbers = np.load(tmp_path / "a.surface.npy")
    assert set(numbers[numbers >= 0].tolist()) <= {n for run in runs for n in range(run["first"], run["last"] + 1)}
    plain = here("render", TINY, *SMALL, "-o", f"{tmp_path}/b.png")
    assert plain.code == 0
    assert (tmp_path / "b.png").read_bytes() == (tmp_path / "a.png").read_bytes()


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_an_exr_holds_its_layers(tmp_path):
    openexr = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    outcome = here("render", TINY, *SMALL, "-o", f"{tmp_path}/a.exr", "--layers", "depth,normal,surface,material")
    assert (outcome.code, outcome.out) == (0, f"{tmp_path}/a.exr\n")
    with openexr.File(f"{tmp_path}/a.exr", separate_channels=True) as file:
        assert set(file.channels()) == {"R", "G", "B", "Z", "N.X", "N.Y", "N.Z", "id", "material"}


@pytest.mark.usefixtures("no_leftovers", "warm_kernels")
def test_frames_have_layers_that_resume_looks_for(tmp_path):
    command = (
        "render",
        MOBILE,
        "--frames",
        "3-4",
        *SMALL[:-1],
        "-o",
        f"{tmp_path}/f_%d.png",
        "--layers",
        "depth,material",
    )
    outcome = here(*command)
    names = [f"{tmp_path}/f_{frame}.{kind}png" for frame in (3, 4) for kind in ("", "depth.", "material.")]
    assert (outcome.code, outcome.out.splitlines()) == (0, names)
    again = here(*command, "--resume")
    assert (again.code, again.out) == (0, "")
    assert "2 of 2 frames were there already" in again.err
    (tmp_path / "f_3.material.png").write_bytes((tmp_path / "f_3.depth.png").read_bytes())
    again = here(*command, "--resume")
    assert (again.code, again.out.splitlines()) == (0, names[:3])
    more = here(*command[:-1], "depth,normal", "--resume")
    assert (more.code, len(more.out.splitlines())) == (0, 6)


@pytest.mark.parametrize("name", ["dept", "", "depth,,normal", "depth;normal"])
def test_a_layer_that_is_none_is_misuse(name):
    word = name.split(",")[1] if "," in name else name
    misused(
        here("render", TINY, "--layers", name), "render", rf"--layers: a layer came as {word!r}, wanted some of: {NONE}"
    )


@pytest.mark.parametrize(
    ("outputs", "code", "words"),
    [
        (["-"], 2, r"-: layers came with a picture on standard output, wanted the name of a file"),
        (
            ["{}/a.gif"],
            2,
            r".*/a\.gif: a file that plays has no layers, wanted numbered pictures such as f_%04d\.exr, too",
        ),
        (
            ["{}/a.png", "{}/a.depth.png"],
            1,
            r".*/a\.depth\.png: the output is the same file as the output .*/a\.depth\.png, wanted another",
        ),
        (["{}/b.png"], 1, r".*/b\.depth\.png: the output is a directory, wanted a file"),
    ],
    ids=["standard output", "film", "twice", "folder"],
)
def test_layers_that_have_no_place_are_refused_before_the_work(outputs, code, words, tmp_path):
    (tmp_path / "b.depth.png").mkdir()
    named = [word for output in outputs for word in ("-o", output.format(tmp_path))]
    scene = MOBILE if "gif" in outputs[0] else TINY
    outcome = here("render", scene, *SMALL, *named, "--layers", "depth")
    more = r" \(raygrid render --help says more\)" if code == 2 else ""
    one_line(outcome, code, f"raygrid( render)?: {words}{more}")
    assert [path.name for path in tmp_path.iterdir()] == ["b.depth.png"]
