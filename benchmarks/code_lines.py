"""How much code there is: lines that hold something besides a comment or a docstring, for each package.

    python benchmarks/code_lines.py                  of the files as they lie here
    python benchmarks/code_lines.py --at COMMIT      of a commit
    python benchmarks/code_lines.py --files          a line for each module, too

A line counts once however much stands on it, so long lines would hide code: `ruff format` holds them all to one length, and
the last column says how long they are in the mean. Stubs (.pyi) count as code does, and are told once more by themselves.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import tarfile
import tokenize
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("node", "emulator", "host")
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
LAYOUT = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
}
Sizes = dict[str, tuple[int, int]]  # what is counted -> its lines of code, and the characters on them


def code_lines(source: str) -> tuple[int, int]:
    """How many lines of a module hold code, and how many characters they hold without their indents.

    A string of several lines that is not a docstring is code, but for its empty lines.
    """
    lines = source.splitlines()
    numbers: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in LAYOUT:
            numbers.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            numbers.difference_update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    texts = [text for text in (lines[number - 1].strip() for number in numbers) if text]
    return len(texts), sum(map(len, texts))


def sources(commit: str | None) -> Iterator[tuple[str, str]]:
    """Path and text of every module, as it lies here or in a commit."""
    if commit is None:
        for path in sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py*")):
            if path.suffix in (".py", ".pyi"):
                yield path.relative_to(ROOT).as_posix(), path.read_text()
        return
    packed = subprocess.run(["git", "archive", commit, *LAYERS], cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for member in archive:
            file = archive.extractfile(member)
            if file is not None and member.name.endswith((".py", ".pyi")):
                yield member.name, file.read().decode()


def measure(modules: Iterator[tuple[str, str]], by_file: bool) -> Sizes:
    """Sizes of the layers, of the packages in them, and of the modules if they are wanted; then of all, and of stubs."""
    sizes: Sizes = {}
    for name, source in modules:
        lines, characters = code_lines(source)
        above = [str(folder) for folder in PurePosixPath(name).parents if folder.name]
        stub = ["~of these stubs"] if name.endswith(".pyi") else []
        for key in (*above, *([name] if by_file else []), "~all", *stub):
            before = sizes.get(key, (0, 0))
            sizes[key] = before[0] + lines, before[1] + characters
    return sizes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--at", metavar="COMMIT", help="count what stands in this commit")
    parser.add_argument("--files", action="store_true", help="a line for each module, too")
    options = parser.parse_args()
    sizes = measure(sources(options.at), options.files)
    width = max(map(len, sizes))
    print(f"{'':{width}}   lines  characters a line")
    for key, (lines, characters) in sorted(sizes.items()):
        print(f"{key.lstrip('~'):{width}}  {lines:6,}  {characters / max(lines, 1):.1f}")


if __name__ == "__main__":
    main()
