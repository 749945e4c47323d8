"""Carries out `raygrid doctor`: prints how raygrid stands on this computer, and what would stop an array."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TypedDict

import click

from raygrid.emulator.topology import read_cores
from raygrid.host.cli import doctor_facts
from raygrid.host.cli.doctor_facts import CacheFacts, FastPath, LimitFacts, LocationFacts
from raygrid.host.image.outputs import write_lines, write_result
from raygrid.host.text.clean_text import printable
from raygrid.host.text.tables import bytes_of, count_of, wrapped

COLUMNS, LABEL = 80, 14
WORDS = {"descriptors": "open files a process", "all_files": "open files in all", "tasks": "processes and threads"}
HELP_OF_PATH = {  # what helps if it is off, and nobody has asked for that
    "native links": "links are served by Python, which is slower: install pyzmq and xxhash as their wheels are",
    "fast kernel loading": "commands start slower: install a numba that pip chooses for this raygrid",
}


class DoctorFacts(TypedDict):
    """All that is found.

    problems  what would stop a small array, and what helps; a sentence each
    advice    what would make it slower or less able, and what helps
    """

    system: str
    versions: dict[str, str | None]
    fast_paths: dict[str, FastPath] | None
    cache: CacheFacts | None
    cores: float
    limits: dict[str, LimitFacts]
    largest_array: list[int]
    places: LocationFacts
    extras: dict[str, dict[str, str | None]]
    environment: dict[str, str]
    problems: list[str]
    advice: list[str]


def run_doctor(as_json: bool) -> None:
    """Print what is found; the exit code is 1 if a small array could not run."""
    facts = examine()
    if as_json:
        write_result(json.dumps(facts, indent=2))
    else:
        write_lines(lines_of(facts))
    if facts["problems"]:
        click.get_current_context().exit(1)


def examine() -> DoctorFacts:
    """Find out how raygrid stands on this computer."""
    versions = doctor_facts.read_versions()
    missing = [name for name, version in versions.items() if version is None and name != "raygrid"]
    problems = [f"{name} is not installed: pip install {name}" for name in missing]
    faults = doctor_facts.read_faults()
    problems += [
        f"{name} cannot be imported ({why}): pip install --force-reinstall {name}"
        for name, why in faults.items()
        if name not in missing
    ]
    paths = None if faults else doctor_facts.read_fast_paths()
    cache = None if faults else doctor_facts.read_cache()
    limits, lacks = doctor_facts.read_limits()
    places = doctor_facts.read_places()
    problems += [*_stops(paths, places), *lacks]
    return {
        "system": doctor_facts.read_system(),
        "versions": versions,
        "fast_paths": paths,
        "cache": cache,
        "cores": read_cores(),
        "limits": limits,
        "largest_array": min((one["largest"] for one in limits.values()), default=[0, 0, 0]),
        "places": places,
        "extras": doctor_facts.read_extras(),
        "environment": doctor_facts.read_environment(),
        "problems": problems,
        "advice": [*_untried(versions), *_slow(paths), *_not_kept(cache), *_no_films(places)],
    }


def _stops(paths: dict[str, FastPath] | None, places: LocationFacts) -> Iterator[str]:
    """What keeps an array from running, or lets it run far too slowly, and what helps."""
    if paths is not None and not paths["compiled kernels"]["on"]:
        yield f"kernels are interpreted, which is far slower ({paths['compiled kernels']['why']}): unset it"
    if None not in places["sockets"].values():
        tried = ", ".join(f"{base} ({why})" for base, why in places["sockets"].items())
        yield f"no directory for sockets ({tried}): set XDG_RUNTIME_DIR to one that is short, and yours alone"


def _untried(versions: dict[str, str | None]) -> Iterator[str]:
    """Which libraries are older or newer than those that raygrid was tried with, and what helps."""
    for name, wanted in doctor_facts.read_misfits().items():
        have = versions.get(name) or "another version"
        yield f"{name}: {have}, with which this raygrid was not tried: pip install '{name}{wanted}'"


def _slow(paths: dict[str, FastPath] | None) -> Iterator[str]:
    """What is slower than it could be, and what helps."""
    if paths is None or not paths["compiled kernels"]["on"]:
        return
    for name, path in paths.items():
        variable, asks, _ = (path["why"] or "").partition(" asks for it")
        if asks:
            yield f"{name}: off, which is slower: unset {variable.partition('=')[0]}"
        elif path["why"] is not None and name in HELP_OF_PATH:
            yield HELP_OF_PATH[name]


def _not_kept(cache: CacheFacts | None) -> Iterator[str]:
    """What is wrong with the place of kernels, and what helps."""
    if cache is None:
        return
    from raygrid.node.jit.cache import REMEDY

    if cache["directory"] is None:
        yield f"compiled kernels cannot be kept, and each run compiles them anew, a minute: {REMEDY}"
    elif not cache["writable"]:
        yield f"kernels that the cache lacks cannot be kept, and each run compiles them anew: {REMEDY}"
    elif cache["why"]:
        yield f"kernels are not kept in the usual place: {REMEDY}, or mend it"


def _no_films(places: LocationFacts) -> Iterator[str]:
    """What keeps frames from being put together, and what helps."""
    if places["temporary"] is None:
        needed = ".gif, .webp and .mp4 of several frames and pictures that an array gives back to Python need one"
        yield f"no temporary directory can be written, and {needed}: set TMPDIR"


# --- text --------------------------------------------------------------------------------------------


def lines_of(facts: DoctorFacts) -> Iterator[str]:
    """All that is found, for people."""
    versions = dict(facts["versions"])
    mine, python = versions.pop("raygrid"), versions.pop("Python")
    yield f"raygrid {mine or '(not installed)'}, Python {python}, {facts['system']}"
    yield from _entry("libraries", ", ".join(f"{name} {version or 'MISSING'}" for name, version in versions.items()))
    for number, (name, path) in enumerate((facts["fast_paths"] or {}).items()):
        state = f"on, {path['what']}" if path["on"] else f"off, {path['why']}"
        yield from _entry("" if number else "fast paths", f"{name}: {state}")
    yield from _cache_lines(facts["cache"])
    yield from _limit_lines(facts)
    yield from _place_lines(facts["places"])
    yield from _entry("extras", ", ".join(_extra_text(name, found) for name, found in facts["extras"].items()))
    if facts["environment"]:
        yield from _entry("environment", ", ".join(f"{name}={value}" for name, value in facts["environment"].items()))
    for sentence in facts["advice"]:
        yield from _entry("advice:", sentence, 8)
    for sentence in facts["problems"]:
        yield from _entry("PROBLEM:", sentence, 9)
    if not facts["problems"]:
        yield "a small array can run here"


def _entry(label: str, text: str, width: int = LABEL) -> list[str]:
    """A labelled paragraph."""
    first = label.ljust(width) if len(label) < width else f"{label} "
    return wrapped(printable(text), COLUMNS, first, " " * width)


def _cache_lines(cache: CacheFacts | None) -> Iterator[str]:
    if cache is None:
        return
    if cache["directory"] is None:
        yield from _entry("kernel cache", f"nowhere ({cache['why']})")
        return
    state = "can be written" if cache["writable"] else "can be read only"
    yield from _entry("kernel cache", f"{cache['directory']}, {state if cache['exists'] else 'not there yet'}")
    if cache["why"]:
        yield from _entry("", f"not in {cache['why']}")
    kept = [f"{count} for {kind}" for kind, count in cache["functions"].items()]
    kept += [count_of(cache["programs"], "program")] if cache["programs"] else []
    held = (
        f"{bytes_of(cache['bytes'])}; functions: {', '.join(kept)}"
        if kept
        else "no kernels yet: the first run takes a minute"
    )
    beside = f"; {bytes_of(cache['bytes_beside'])} beside, of other versions" if cache["bytes_beside"] else ""
    yield from _entry("", held + beside)


def _limit_lines(facts: DoctorFacts) -> Iterator[str]:
    limits = facts["limits"]
    shape = facts["largest_array"]
    by = [WORDS.get(name, name) for name, one in limits.items() if one["largest"] == shape]
    size = "x".join(map(str, shape)) if shape[0] else "none"
    yield from _entry("largest", f"{size}, by {' and '.join(by)}; {facts['cores']:g} cores to use")
    for name, one in limits.items():
        left = "no limit" if one["left"] is None else _left(name, one)
        yield from _entry("", f"{WORDS.get(name, name)}: {left}")


def _left(name: str, one: LimitFacts) -> str:
    left = one["left"] or 0
    return f"{bytes_of(left) if name == 'memory' else f'{left:,}'} ({one['limit']})"


def _place_lines(places: LocationFacts) -> Iterator[str]:
    sockets = [f"{base} ({why or 'usable'})" for base, why in places["sockets"].items()]
    yield from _entry("sockets in", ", else ".join(sockets))
    ffmpeg = places["ffmpeg"] or "not found, so no .mp4: pip install 'raygrid[mp4]'"
    yield from _entry("temporary", f"{places['temporary'] or 'no directory can be written'}; ffmpeg: {ffmpeg}")


def _extra_text(name: str, libraries: dict[str, str | None]) -> str:
    missing = [library for library, version in libraries.items() if version is None]
    return f"{name} (pip install {' '.join(missing)})" if missing else f"{name} installed"
