"""Writes the reference of files and messages from the JSON schemas that `raygrid schema` prints."""

from __future__ import annotations

import json
from typing import Any

from markdown import block, code, escaped, table

from raygrid.host.cli.commands.schema import KINDS, schema_of

FOLDER = "reference/files"
WHERE = {  # kind -> what tells of it in words
    "scene": "[scenes.md](../../scenes.md#the-scene-file) says what each key means.",
    "cost": "[costs.md](../../costs.md) says what each key means, and where the numbers of the built-in ones come from.",
    "request": "[service.md](../../service.md#the-protocol) has the protocol, and its answers.",
    "sample": "[probes.md](../../probes.md#a-sample) says what each key means.",
}
Schema = dict[str, Any]


def schema_pages() -> dict[str, str]:
    """Path below the site -> its text: a page for each kind, the schema itself, and a page that lists them."""
    if set(KINDS) != set(WHERE):
        raise ValueError(
            f"WHERE of docs/site/schema_pages.py and the kinds of raygrid schema differ: {set(KINDS) ^ set(WHERE)}"
        )
    made = {f"{FOLDER}/index.md": _index()}
    for kind in KINDS:
        schema = schema_of(kind)
        made[f"{FOLDER}/{kind}.md"] = _page(kind, schema)
        made[f"{FOLDER}/{kind}.schema.json"] = json.dumps(schema, indent=2) + "\n"
    return made


def _index() -> str:
    rows = [(f"[{kind}]({kind}.md)", escaped(about.title)) for kind, about in KINDS.items()]
    return "\n\n".join(
        [
            "# Files and messages",
            "What users and programs write and read, from the schemas that `raygrid schema` prints. "
            "[The command line](../../commands.md#schemas-for-editors) says how an editor uses them.",
            table(("kind", "what it is"), rows),
            "\n".join(["```{toctree}", ":hidden:", "", *KINDS, "```"]),
        ]
    )


def _page(kind: str, schema: Schema) -> str:
    parts = [
        f"# {KINDS[kind].title}",
        f"{WHERE[kind]} The schema itself: [{kind}.schema.json](./{kind}.schema.json), or",
        block(f"raygrid schema {kind}"),
    ]
    definitions: dict[str, Schema] = schema.get("$defs", {})
    if "properties" in schema:
        parts += ["## The whole", _keys(schema)]
    else:
        parts += [f"One of: {_kind(schema)}"]
    for name, made in sorted(definitions.items()):
        said = made.get("description", "").split("\n\n")[0]
        parts += [f"## {name}", *([escaped(said)] if said else [])]
        parts += [_keys(made) if made.get("properties") else _kind(made)]
    return "\n\n".join(parts) + "\n"


def _keys(schema: Schema) -> str:
    required = set(schema.get("required", ()))
    rows = []
    for key, made in schema["properties"].items():
        default = "required" if key in required else code(json.dumps(made["default"])) if "default" in made else ""
        kind = _kind(made) + (" or `null`" if key in required and {"type": "null"} in made.get("anyOf", ()) else "")
        rows.append((code(key), kind, "-" if default in ("", "`null`") else default))
    return table(("key", "what it takes", "default"), rows)


def _kind(schema: Schema) -> str:
    """What a value may be, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in schema:
        return code(json.dumps(schema["const"]))
    if "enum" in schema:
        return " or ".join(code(json.dumps(value)) for value in schema["enum"])
    for union in ("anyOf", "oneOf"):
        if union in schema:
            kinds = dict.fromkeys(_kind(made) for made in schema[union] if made.get("type") != "null")
            return " or ".join(kinds)
    return _array(schema) if schema.get("type") == "array" else _plain(schema)


def _array(schema: Schema) -> str:
    if "prefixItems" in schema:
        kinds = list(dict.fromkeys(_kind(made) for made in schema["prefixItems"]))
        return f"[{len(schema['prefixItems'])} of: {'; '.join(kinds)}]".replace("[", r"\[", 1)
    least, most = schema.get("minItems"), schema.get("maxItems")
    count = f"{least} or more" if least and most is None else f"up to {_number(most)}" if most else "any number"
    return f"a list, {count}, of {_kind(schema['items'])}" if schema.get("items") else "a list"


def _plain(schema: Schema) -> str:
    words = {
        "integer": "whole number",
        "number": "number",
        "string": "text",
        "boolean": "true or false",
        "object": "table",
    }
    said = words.get(schema.get("type", ""), "anything")
    if isinstance(schema.get("additionalProperties"), dict) and schema["additionalProperties"]:
        said = f"table of {_kind(schema['additionalProperties'])}"
    low = schema.get("minimum", schema.get("ge"))
    high = schema.get("maximum", schema.get("le"))
    bounds = [
        f"from {_number(low)}" if low is not None and low > -1e30 else "",
        f"above {_number(schema['exclusiveMinimum'])}" if "exclusiveMinimum" in schema else "",
        f"to {_number(high)}" if high is not None and high < 1e30 else "",
        f"below {_number(schema['exclusiveMaximum'])}" if "exclusiveMaximum" in schema else "",
    ]
    return " ".join([said, *filter(None, bounds)])


def _number(value: float) -> str:
    return f"{int(value):,}" if value == int(value) and abs(value) < 1e16 else f"{value:g}"
