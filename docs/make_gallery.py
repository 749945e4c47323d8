"""Renders the pictures of the gallery, and writes docs/gallery.md, which shows each with its command. `make gallery`

Pictures of scenes in scenes/ go to docs/gallery/, and are kept with the sources. Those of standard scenes that lie elsewhere
(RAYGRID_SHARED, or ../shared) go to build/gallery/, if the scenes are there; the site shows them, the page does not.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PAGE, PICTURES = ROOT / "docs" / "gallery.md", ROOT / "docs" / "gallery"
SHARED = Path(os.environ.get("RAYGRID_SHARED", ROOT.parent / "shared"))
SHARED_PICTURES = ROOT / "build" / "gallery"
MOST_BYTES = 600_000  # of all pictures that are kept with the sources
HEAD = """\
# Gallery

Scenes that come with raygrid, and the command of each picture. `make gallery` renders them anew, and writes this page.
[Scenes](scenes.md) says what is in them.
"""
MORE = """\
## Standard scenes

Scenes that do not come with raygrid: of the Standard Procedural Databases, *Spot* by Keenan Crane, who gave it to the public
domain, and a sample of the Khronos Group.
"""


class Shot(NamedTuple):
    """A picture: its file, what it shows, and the words of `raygrid render` before -o."""

    file: str
    title: str
    words: str

    @property
    def command(self) -> str:
        return f"raygrid render {self.words} -o {self.file}"


OURS = (
    Shot("glass.png", "Glass, chrome and gold on a chequered floor", "scenes/glass.toml --size 320x180 --samples 16"),
    Shot("room.png", "A room out of Blender, with a mirror ball and a glass ball", "scenes/room.glb --size 320x240 --samples 9"),
    Shot("view.png", "The same room as OBJ, from another side, in another light",
         "scenes/room.obj --from 3,3,7 --at 0,1.2,0 --fov 40 --light 2,7,4,1,0.9,0.8 --size 240x180 --samples 9"),
    Shot("lights.png", "26 lights: many shadow rays", "scenes/lights.toml --size 320x180 --samples 4"),
    Shot("tree.png", "A tree of cones and balls", "scenes/tree.nff --size 240x240 --samples 4"),
    Shot("kinds.png", "Every kind of surface", "scenes/kinds.nff --size 240x240 --samples 9"),
    Shot("balls.png", "Five balls on a floor", "scenes/tiny.nff --size 240x240 --samples 9"),
    Shot("rings.png", "Tori, which a program brings",
         "scenes/rings.toml --program scenes/programs/torus.py --allow-programs --size 320x240"),
    Shot("marble.png", "Marble, the shading rule of a program",
         "scenes/marble.toml --program scenes/programs/marble.py --allow-programs --size 320x240"),
    Shot("mobile.webp", "A mobile: 48 frames, from one to the next by what moves",
         "scenes/mobile.toml --frames 1-48 --size 120x90"),
)  # fmt: skip
THEIRS = (
    Shot("balls_3.png", "balls", "spd/balls_3.nff --size 240x240 --samples 4"),
    Shot("gears_1.png", "gears", "spd/gears_1.nff --size 240x240 --samples 4"),
    Shot("mount_5.png", "mountain", "spd/mount_5.nff --size 240x240 --samples 4"),
    Shot("rings_3.png", "rings", "spd/rings_3.nff --size 240x240 --samples 4"),
    Shot("teapot_6.png", "teapot", "spd/teapot_6.nff --size 240x240 --samples 4"),
    Shot("tetra_6.png", "tetrahedra", "spd/tetra_6.nff --size 240x240 --samples 4"),
    Shot("spot.png", "Spot, the cow", "meshes/spot_triangulated.obj --size 240x240 --samples 9"),
    Shot("duck.png", "the duck", "meshes/Duck.glb --size 240x240 --samples 9"),
)


def page() -> str:
    """docs/gallery.md."""
    return "\n".join([HEAD, *(_shown(shot, "gallery", run=True) for shot in OURS)])


def more(folder: Path = SHARED_PICTURES) -> tuple[str, list[Path]]:
    """What the site shows beside the page, and its pictures, which lie in gallery/ there; nothing if none were rendered."""
    shots = [shot for shot in THEIRS if (folder / shot.file).is_file()]
    text = "\n".join(["", MORE, *(_shown(shot, "gallery", run=False) for shot in shots)]) if shots else ""
    return text, [folder / shot.file for shot in shots]


def _shown(shot: Shot, folder: str, run: bool) -> str:
    mark = "<!-- run -->\n" if run else ""
    return f"**{shot.title}**\n\n![{shot.title}]({folder}/{shot.file})\n\n{mark}```\n{shot.command}\n```\n"


def render(shot: Shot, scenes: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    raygrid = Path(sys.executable).with_name("raygrid")
    words = [str(raygrid), "render", *shlex.split(shot.words), "-q", "-o", str(folder.resolve() / shot.file)]
    print(f"{shot.file}: {shot.command}", flush=True)
    subprocess.run(words, check=True, cwd=scenes)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Render the pictures of the gallery, and write its page.")
    parser.add_argument("--check", action="store_true", help="only say whether the page is out of date (exit code 1)")
    parser.add_argument("--only", metavar="FILE", action="append", help="render this picture alone; may be repeated")
    options = parser.parse_args(words)
    if options.check:
        return int(not PAGE.is_file() or PAGE.read_text() != page())
    if unknown := set(options.only or ()) - {shot.file for shot in (*OURS, *THEIRS)}:
        parser.error(f"--only came with {', '.join(sorted(unknown))}, wanted a picture of the gallery")
    for shots, scenes, folder in ((OURS, ROOT, PICTURES), (THEIRS, SHARED / "scenes", SHARED_PICTURES)):
        for shot in shots:
            if (scenes / shot.words.split()[0]).is_file() and (not options.only or shot.file in options.only):
                render(shot, scenes, folder)
    PAGE.write_text(page())
    print(f"the page is {PAGE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
