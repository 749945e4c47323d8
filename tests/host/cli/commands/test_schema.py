"""The schemas for editors allow what the readers take, and refuse what they refuse."""

import json
import tomllib

import jsonschema
import pytest
from support.cli import here
from support.paths import ROOT, SCENES

from raygrid.host.cli.commands.schema import KINDS, schema_of
from raygrid.host.cli.group_start import SCHEMAS

FILES = [
    *(("scene", path) for path in (*sorted(SCENES.glob("*.toml")), ROOT / "host" / "scene" / "demo.toml")),
    *(("cost", path) for path in sorted((ROOT / "emulator" / "costs").glob("*.toml"))),
]
BALL = {"kind": "sphere", "centre": [0, 0, 0], "radius": 1}


def faults(kind: str, document: object) -> list[str]:
    return [fault.message for fault in jsonschema.Draft202012Validator(schema_of(kind)).iter_errors(document)]


@pytest.mark.parametrize(("kind", "path"), FILES, ids=lambda value: getattr(value, "name", value))
def test_examples_are_allowed(kind, path):
    assert faults(kind, tomllib.loads(path.read_text())) == []


def test_both_spellings_are_allowed_and_one_is_wanted():
    american = {"kind": "sphere", "center": [0, 0, 0], "radius": 1}
    assert faults("scene", {"surfaces": [BALL, american]}) == []
    assert faults("scene", {"surfaces": [BALL | american]})
    assert faults("scene", {"surfaces": [{"kind": "sphere", "radius": 1}]})
    assert faults("scene", {"materials": {"a": {"color": [1, 0, 0], "diffuse": 0.5, "specular": [0.1, 0, 0]}}}) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"surfaces": [BALL | {"colr": 1}]},
        {"surfaces": [BALL | {"radius": "1"}]},
        {"surfaces": [BALL | {"kind": "ball"}]},
        {"materials": {"a": {"diffuse": -1}}},
        {"materials": {"a": {"diffuse": [1, 1]}}},
        {"image": {"width": 1.5}},
        {"sky": 1},
    ],
    ids=str,
)
def test_what_the_reader_refuses_is_refused(wrong):
    assert faults("scene", {"surfaces": [BALL]} | wrong)


def test_a_schema_is_json_and_the_kinds_are_listed():
    for kind in KINDS:
        outcome = here("schema", kind)
        assert (outcome.code, outcome.err) == (0, "")
        made = json.loads(outcome.out)
        jsonschema.Draft202012Validator.check_schema(made)
        assert made["title"] == KINDS[kind].title
    assert tuple(KINDS) == SCHEMAS
    assert [line.split()[0] for line in here("schema").out.splitlines()] == list(SCHEMAS)
