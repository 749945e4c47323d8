"""Builds the site into build/site, and takes every warning of Sphinx for an error. `make docs`"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from pages import ROOT, put_together  # noqa: E402


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Build the site, HTML, from the pages and from the code.")
    parser.add_argument("--into", type=Path, default=ROOT / "build" / "site", help="folder of the site (build/site)")
    into: Path = parser.parse_args(words).into
    try:
        from sphinx.cmd.build import build_main
    except ModuleNotFoundError:
        print("Sphinx is not installed, wanted the extra docs: pip install '.[docs]' here", file=sys.stderr)
        return 1
    sources = into.with_name(into.name + "-sources")
    put_together(sources)
    strict = ["-W", "--keep-going", "-q", "-E", "-b", "html", "-c", str(HERE)]
    code = build_main([*strict, "-d", str(into.with_name(into.name + "-doctrees")), str(sources), str(into)])
    if code == 0:
        print(f"the site is {into / 'index.html'}")
    return code


if __name__ == "__main__":
    raise SystemExit(main())
