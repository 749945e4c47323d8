"""The words are the field's: retired ones do not come back, one class has one name, and one number one value."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Collection, Iterator, Mapping

from support import paths
from support.modules import Modules, read_modules

# Retired word -> what is said instead. In no identifier, and in no first line of a docstring.
RETIRED = {
    "astray": "not at start",
    "sieve sift sifted": "classify",
    "newborn newborns brood bear bears": "spawn",
    "birth births": "spawn, spawned",
    "backlog": "work queue",
    "traveller travellers": "in transit",
    "tally tallies tallied": "reduction, reply",
    "untold": "to notify",
    "wires wired": "native links",
    "lend lent": "native links, link state",
    "nursery": "fork server",
    "crew": "node processes",
    "pilot": "sampling pre-pass",
    "enquiry": "look-ahead request",
    "promise promises": "channel clock",
    "holdings": "local geometry",
    "drowsy nap naps linger lingers gather gathers pace": "back-off, batch threshold, tuning",
    "keeper": "array supervisor",
    "rig": "scene animation",
    "jam jams": "deadlock",
}
# In no name of a module or a class; elsewhere they are plain English (a line of text, a word of memory, a turn of a scene).
RETIRED_AS_NAMES = frozenset(
    word
    for words in (
        "ahead answers book books door eyes fly heard hidden looking maps order orders places ready round rounds",
        "shot shots steady talk tally told tracks trial turn turns usage wanted whole wires word words",
    )
    for word in words.split()
)
# (module or "", word) -> why it stays
KEPT: dict[tuple[str, str], str] = {
    ("", "jam"): "the command and its request have this name",
    ("emulator.processes.array", "linger"): "ZeroMQ's word",
    ("node.links.zmq_channel", "linger"): "ZeroMQ's word",
    ("node.main", "linger"): "ZeroMQ's word",
    ("emulator.simulator.event_loop", "order"): "the order of samples, not a command",
    ("emulator.simulator.sample_order", "order"): "the order of samples, not a command",
    ("host.scene.formats.nff_words", "words"): "the words of an NFF file",
    ("host.service.answers", "answers"): "what the service sends back to a client is called so in docs/service.md",
    ("host.service.events", "ready"): "the state that users read in `raygrid status`",
    ("host.service.listener", "backlog"): "asyncio's word",
    ("host.service.schedule", "turns"): "clients take turns",
}
# Words that are still in a module. They may only go.
LEFT: dict[str, str] = {}

MODULES = read_modules(paths.ROOT)
WORDS = frozenset(word for words in RETIRED for word in words.split())
Uses = dict[str, set[str]]


def words_of(name: str) -> set[str]:
    """The words of an identifier, whether it is written with underscores or with capitals."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


def identifiers(tree: ast.AST) -> Iterator[str]:
    """Every name in a module: of functions, classes, arguments, variables, attributes and keywords."""
    for node in ast.walk(tree):
        for field in ("name", "id", "attr", "arg", "asname"):
            name = getattr(node, field, None)
            if isinstance(name, str):
                yield name


def first_lines(tree: ast.AST) -> Iterator[str]:
    """The first line of every docstring."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            said = ast.get_docstring(node)
            if said:
                yield said.splitlines()[0]


def class_names(tree: ast.AST) -> Iterator[str]:
    return (node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef))


def retired(modules: Modules, words: Collection[str], as_names: Collection[str]) -> Uses:
    """Module -> the retired words that it uses."""
    found: Uses = {}
    for name, module in modules.items():
        used = {word for known in {*identifiers(module.tree), *name.split(".")[1:]} for word in words_of(known)}
        used |= {word.lower() for line in first_lines(module.tree) for word in re.findall(r"[A-Za-z]+", line)}
        named = {word for known in (*class_names(module.tree), *name.split(".")[1:]) for word in words_of(known)}
        both = used & set(words) | named & set(as_names)
        if both:
            found[name] = both
    return found


def faults(found: Uses, kept: Collection[tuple[str, str]], left: Mapping[str, str]) -> list[str]:
    """Retired words that are used, and lines of the tables that are no longer so."""
    wrong = [
        f"{name} uses {word!r}"
        for name, words in found.items()
        for word in sorted(words - set(left.get(name, "").split()))
        if ("", word) not in kept and (name, word) not in kept
    ]
    wrong += [
        f"{name} no longer uses {word!r}"
        for name, words in left.items()
        for word in set(words.split()) - found.get(name, set())
    ]
    for name, word in kept:
        if not any(word in words for where, words in found.items() if name in ("", where)):
            wrong.append(f"{word!r} is kept for {name or 'all'}, and not used")
    return sorted(wrong)


def twice(modules: Modules) -> list[str]:
    """Names of classes that stand in two modules, or twice in one."""
    homes: dict[str, list[str]] = {}
    for name, module in modules.items():
        for known in class_names(module.tree):
            homes.setdefault(known, []).append(name)
    return [f"{name} is a class of {' and of '.join(where)}" for name, where in homes.items() if len(where) > 1]


def two_values(numbers: Mapping[str, Mapping[str, object]]) -> list[str]:
    """Numbers of modules that have one name and not one value."""
    values: dict[str, dict[str, object]] = {}
    for module, names in numbers.items():
        for name, value in names.items():
            if name.isupper() and isinstance(value, int | float) and not isinstance(value, bool):
                values.setdefault(name, {})[module] = value
    return [f"{name}: {where}" for name, where in sorted(values.items()) if len(set(where.values())) > 1]


def test_retired_words_do_not_come_back():
    assert faults(retired(MODULES, WORDS, RETIRED_AS_NAMES), KEPT, LEFT) == []


def told_of_another(modules: Modules) -> list[str]:
    """First lines that only refer to another function, where what is done stands once and is said there."""
    return [
        f"{name}: {line}"
        for name, module in modules.items()
        for line in first_lines(module.tree)
        if line.startswith("As ")
    ]


def test_every_first_line_says_what_is_done():
    assert told_of_another(MODULES) == []


def test_no_two_classes_share_a_name():
    assert twice(MODULES) == []


def test_a_number_of_the_node_has_one_value():
    names = [name for name, module in MODULES.items() if module.layer == "node"]
    numbers = {name: vars(importlib.import_module(f"raygrid.{name}")) for name in names}
    assert sum(len(known) for known in numbers.values()) > 1000
    assert two_values(numbers) == []


def test_each_check_sees_what_is_wrong(tmp_path):
    (tmp_path / "node" / "jit").mkdir(parents=True)
    sieve = tmp_path / "node" / "jit" / "cache.py"
    sieve.write_text(
        '"""The nursery of kernels."""\nclass Door:\n    def bear_next(self, eyesAstray):\n        door = 1\n'
    )
    (tmp_path / "node" / "jit" / "tally.py").write_text("class Door:\n    pass\n")
    modules = read_modules(tmp_path)
    found = retired(modules, WORDS, RETIRED_AS_NAMES)
    assert found == {"node.jit.cache": {"nursery", "door", "bear", "astray"}, "node.jit.tally": {"tally", "door"}}
    left = {"node.jit.cache": "nursery sieve"}
    kept = [("", "door"), ("node.jit.cache", "bear"), ("node.jit.tally", "bear")]
    assert faults(found, kept, left) == [
        "'bear' is kept for node.jit.tally, and not used",
        "node.jit.cache no longer uses 'sieve'",
        "node.jit.cache uses 'astray'",
        "node.jit.tally uses 'tally'",
    ]
    assert told_of_another(modules) == []
    sieve.write_text('def f():\n    """As `g`, faster."""\n')
    assert told_of_another(read_modules(tmp_path)) == ["node.jit.cache: As `g`, faster."]
    assert twice(modules) == ["Door is a class of node.jit.cache and of node.jit.tally"]
    assert two_values({"a": {"N": 1, "M": 2.0, "x": 1}, "b": {"N": 1, "M": 3, "x": 2}}) == ["M: {'a': 2.0, 'b': 3}"]
