"""Files of the user as validated pydantic models: everything wrong is said at once, with file, line and what to do."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from bench.base.errors import InputError
from bench.base.spelling import nearest
from bench.base.yaml12 import Document, Place, PlacedError, dump, parse_yaml, read_text, read_yaml

__all__ = [
    "STRICT",
    "Document",
    "Place",
    "PlacedError",
    "dump",
    "export_schema",
    "json_schema",
    "load_config",
    "nearest",
    "parse_yaml",
    "read_text",
    "read_yaml",
    "schema_text",
]

STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True)
"""`model_config` of every model of a file: unknown keys, wrong types, NaN and infinity are errors."""

_PYDANTIC_WORDS = {
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "string_type": "must be text; put it in quotes",
    "bool_type": "must be true or false",
    "model_type": "must hold keys and values",
    "model_attributes_type": "must hold keys and values",
    "too_short": "must have at least {min_length} of them",
    "too_long": "must have at most {max_length} of them",
    "string_too_long": "must have at most {max_length} characters",
}

M = TypeVar("M", bound=BaseModel)


def load_config(source: Path | str | Document, model: type[M]) -> M:
    """A validated model from a YAML file (or from a document already read).

    Raises InputError; its first line is the first thing wrong, the further ones follow, each with file and line.
    """
    document = source if isinstance(source, Document) else read_yaml(source)
    if not isinstance(document.content, dict):
        raise InputError(f"must hold keys and values, such as `name: …`; found {_kind(document.content)}",
                         document.file, document.line(()))  # fmt: skip
    try:
        # Through JSON: its strict mode takes a list for a tuple, and nothing else that is lax.
        return model.model_validate_json(json.dumps(document.content))
    except ValidationError as error:
        schema = model.model_json_schema()
        found = [_explain(detail, document, schema) for detail in _details(error)]
        found = sorted(dict.fromkeys(found))
        (line, text), rest = found[0], found[1:]
        further = "".join(f"\n{document.file}:{line}: {text}" for line, text in rest)
        raise InputError(text + further, document.file, line) from None


def _details(error: ValidationError) -> list[ErrorDetails]:
    """Every error once: a list whose items are wrong is not also too short."""
    details = error.errors(include_url=False)
    inner = {detail["loc"][:n] for detail in details for n in range(len(detail["loc"]))}
    return [
        detail
        for detail in details
        if (detail["type"] != "too_short" or detail["loc"] not in inner) and not _instead(detail, details)
    ]


def _instead(detail: ErrorDetails, details: Sequence[ErrorDetails]) -> bool:
    """Whether keys and values stand where text may, too: then only what is wrong with them is of interest."""
    place = detail["loc"][:-1]
    text = detail["type"] == "string_type" and isinstance(detail["input"], dict)
    return text and any(other is not detail and other["loc"][: len(place)] == place for other in details)


def _explain(detail: ErrorDetails, document: Document, schema: dict[str, Any]) -> tuple[int, str]:
    """(line, text) of one pydantic error in the words of this file."""
    error = detail.get("ctx", {}).get("error")
    path = _path((*detail["loc"], *getattr(error, "place", ())), document.content)
    node = _schema_at(schema, detail["loc"], document.content)
    where = _spell(path)
    line = document.line(path)
    kind, context = detail["type"], detail.get("ctx", {})
    key = str(context.get("discriminator", "")).strip("'")
    if kind == "extra_forbidden":
        known = _schema_at(schema, detail["loc"][:-1], document.content).get("properties", {})
        text = f"unknown key '{path[-1]}'{nearest(str(path[-1]), known)}; known here: {', '.join(known)}"
    elif kind == "missing":
        missing = detail["loc"][-1]
        meaning = node.get("description", "").split("\n")[0].rstrip(".")
        text = f"{where + ': ' if where else ''}missing key '{missing}'" + (f" ({meaning})" if meaning else "")
    elif kind == "union_tag_not_found":
        allowed = ", ".join(node.get("discriminator", {}).get("mapping", {}))
        text = f"{where}: missing key {key}; one of {allowed}"
    elif kind == "union_tag_invalid":
        known = re.findall(r"'([^']*)'", context["expected_tags"])
        text = f"{where}: {key} is '{context['tag']}'{nearest(context['tag'], known)}"
        text += f"; one of {', '.join(known)}"
    elif kind in {"value_error", "assertion_error"}:
        text = f"{where + ': ' if where else ''}{error or detail['msg']}"
    else:
        value = json.dumps(detail["input"], ensure_ascii=False)
        value = value if len(value) < 60 else _kind(detail["input"])
        said = re.sub(r"^(Input|String) should", "must", detail["msg"])
        allowed = _PYDANTIC_WORDS[kind].format(**context) if kind in _PYDANTIC_WORDS else said
        if kind == "string_pattern_mismatch" and "examples" in node:
            allowed = f"must be written like {node['examples'][0]!r}"
        text = f"{where} is {value}: {allowed}"
        if context.get("expected") and isinstance(detail["input"], str):
            text += nearest(detail["input"], re.findall(r"'([^']*)'", context["expected"]))
    return line, text


def _path(loc: tuple[str | int, ...], content: Any) -> Place:
    """Position in the file of a pydantic location, which also names the members of unions."""
    path: list[str | int] = []
    for i, step in enumerate(loc):
        inside = isinstance(content, dict) and step in content
        if inside or (isinstance(content, list) and isinstance(step, int) and step < len(content)):
            content = content[step]
            path.append(step)
        elif i == len(loc) - 1 and not isinstance(content, dict | list):
            break
    return tuple(path)


def _schema_at(schema: dict[str, Any], loc: tuple[str | int, ...], content: Any) -> dict[str, Any]:
    """The part of a JSON schema that describes a pydantic location; empty when it is not found."""
    node = _resolve(schema, schema)
    for step in loc:
        if step in node.get("properties", {}):
            node = node["properties"][step]
        elif isinstance(step, int) and "items" in node:
            node = node["items"]
        elif step in node.get("discriminator", {}).get("mapping", {}):
            node = {"$ref": node["discriminator"]["mapping"][step]}
        elif isinstance(node.get("additionalProperties"), dict):
            node = node["additionalProperties"]
        else:
            members = [_resolve(schema, member) for member in node.get("anyOf", [])]
            node = next((member for member in members if member.get("title") == step), node)
        node = _resolve(schema, node)
    return node


def _resolve(schema: dict[str, Any], node: dict[str, Any]) -> dict[str, Any]:
    """Follow `$ref`, and an optional value to the value."""
    while True:
        members = [member for member in node.get("anyOf", []) if member.get("type") != "null"]
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rsplit("/", 1)[1]] | {k: v for k, v in node.items() if k != "$ref"}
        elif len(members) == 1:
            node = members[0] | {k: v for k, v in node.items() if k == "description"}
        else:
            return node


def _spell(path: Place) -> str:
    """`segments[2].rate_degc_per_min`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).lstrip(".")


def _kind(value: Any) -> str:
    names = {dict: "keys and values", list: "a list", str: "text", bool: "true or false", type(None): "nothing"}
    return names.get(type(value), "a number")


def json_schema(model: type[Any], title: str | None = None) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a model or a dataclass of pydantic, for editors and check-jsonschema."""
    schema = TypeAdapter(model).json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": title or model.__name__}


def schema_text(model: type[Any], title: str | None = None) -> str:
    """The schema as the text of a file, the same on every machine."""
    return json.dumps(json_schema(model, title), indent=1, ensure_ascii=False) + "\n"


def export_schema(model: type[Any], path: Path, title: str | None = None) -> bool:
    """Write the schema where it differs from what `path` holds; True when it did."""
    text = schema_text(model, title)
    if path.is_file() and path.read_text(encoding="utf-8") == text:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return True
