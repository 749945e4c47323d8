"""Writes the reference of the command line: a page for each command, from what click knows of it."""

from __future__ import annotations

import inspect
import re
import textwrap

import click
from markdown import block, code, escaped, table

from raygrid.host.cli.main import cli

FOLDER = "reference/commands"
PAGE_NAMED = re.compile(r"docs/([\w-]+)\.md")
EXAMPLES = re.compile(r"Examples?:\n(.*)", re.S)


def command_pages() -> dict[str, str]:
    """Path of a page -> its Markdown; the first lists the others."""
    pages = {f"{FOLDER}/{name}.md": _page(name, command) for name, command in sorted(cli.commands.items())}
    return {f"{FOLDER}/index.md": _index(), **pages}


def _index() -> str:
    rows = [(f"[`raygrid {name}`]({name}.md)", escaped(command.get_short_help_str(200)))
            for name, command in sorted(cli.commands.items())]  # fmt: skip
    return "\n\n".join(
        [
            "# Commands",
            "All commands with all options, as `raygrid COMMAND --help` has them. What they share, exit codes, "
            "variables, completion, is told in [the command line](../../commands.md).",
            table(("command", "what it does"), rows),
            "\n".join(["```{toctree}", ":hidden:", "", *sorted(cli.commands), "```"]),
        ]
    )


def _page(name: str, command: click.Command) -> str:
    context = click.Context(command, info_name=f"raygrid {name}")
    usage = " ".join(command.get_usage(context).removeprefix("Usage: ").split())
    parts = [f"# raygrid {name}", *_paragraphs(command.help or ""), block(usage)]
    records = [record for one in command.get_params(context) if (record := one.get_help_record(context)) is not None]
    rows = [(code(spelt), _said(told)) for spelt, told in records]
    parts += ["## Options", table(("option", "what it means"), rows), *_epilog(command.epilog or "")]
    return "\n\n".join(parts) + "\n"


def _said(text: str) -> str:
    """Words of help, with the documents that they name as links."""
    return PAGE_NAMED.sub(r"[\1](../../\1.md)", escaped(text))


def _paragraphs(text: str) -> list[str]:
    """Paragraphs of help; one that begins with click's mark for text to be left as it is becomes a block."""
    found = re.split(r"\n\s*\n", inspect.cleandoc(text))
    return [block(part.replace("\b\n", "")) if "\b" in part else _said(part) for part in found if part.strip()]


def _epilog(text: str) -> list[str]:
    """Examples as a section of their own; the rest as paragraphs."""
    parts = []
    for part in re.split(r"\n\s*\n", text.strip("\n")):
        plain = part.replace("\b\n", "").replace("\b", "")
        if (examples := EXAMPLES.fullmatch(plain)) is not None:
            parts += ["## Examples", block(textwrap.dedent(examples[1]))]
        elif plain.strip():
            parts.append(_said(plain))
    return parts
