"""Carries out `raygrid schema`: prints JSON schemas of the files that users write, and of what commands print as JSON."""

from __future__ import annotations

import json
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import AliasChoices, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from raygrid.host.image.outputs import write_result

if TYPE_CHECKING:
    from pydantic_core import core_schema

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class DescribedModel(NamedTuple):
    """What has a schema: what it is, and the module and the name of its type."""

    title: str
    module: str
    name: str


KINDS = {
    "scene": DescribedModel("A scene file of raygrid (.toml)", "host.scene.formats.toml_schema", "SceneFile"),
    "cost": DescribedModel("A cost model of raygrid (.toml), for --cost", "host.machine_time.cost_models", "CostFile"),
    "request": DescribedModel("A request to an array that stays", "host.client.requests", "Request"),
    "sample": DescribedModel("A line of raygrid probe --json, of a recording", "emulator.driver", "NodeSample"),
}


class EditorSchema(GenerateJsonSchema):
    """Says what pydantic leaves to code: a number that stands for three, and keys that may be spelt in two ways."""

    def function_before_schema(self, schema: core_schema.BeforeValidatorFunctionSchema) -> JsonSchemaValue:
        """What is converted before it is checked."""
        made = super().function_before_schema(schema)
        if getattr(schema["function"]["function"], "__name__", "") == "_tripled":
            return {"anyOf": [made["prefixItems"][0], made]}
        return made

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """A table of a file."""
        made = super().model_schema(schema)
        spellings = []
        for field in schema["cls"].model_fields.values():
            if isinstance(field.validation_alias, AliasChoices):
                first, *others = map(str, field.validation_alias.choices)
                for other in others:
                    made["properties"][other] = made["properties"][first]
                if first in made.get("required", ()):
                    made["required"].remove(first)
                    spellings.append({"oneOf": [{"required": [name]} for name in (first, *others)]})
        return made | {"allOf": spellings} if spellings else made


def schema_of(kind: str) -> dict[str, Any]:
    """The JSON schema of one of KINDS."""
    about = KINDS[kind]
    model = getattr(import_module(f"raygrid.{about.module}"), about.name)
    made = TypeAdapter(model).json_schema(schema_generator=EditorSchema)
    return {"$schema": DIALECT, **made, "title": about.title}


def run_schema(kind: str | None) -> None:
    """Print a schema; None: which there are."""
    if kind is None:
        for name, about in KINDS.items():
            write_result(f"{name:9}{about.title}")
    else:
        write_result(json.dumps(schema_of(kind), indent=2))
