"""The directive `schemas`: one section for each JSON Schema of a folder, with a table of its keys.

    ```{schemas} ../../profiles/schemas
    ```

The tables come from the schema files themselves, so that a new key or a new schema appears without editing a page.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

Schema = Mapping[str, Any]
BOUNDS = {
    "minimum": "≥ {}",
    "exclusiveMinimum": "> {}",
    "maximum": "≤ {}",
    "exclusiveMaximum": "< {}",
    "minLength": "at least {} characters",
    "maxLength": "at most {} characters",
    "minItems": "at least {} entries",
    "maxItems": "at most {} entries",
    "pattern": "matches `{}`",
}


class Schemas(SphinxDirective):
    """Document every `*.json` of the folder that is given relative to the page."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Sections in the order of the files' names.

        Raises:
            DirectiveError: the folder holds no schema.
        """
        folder = Path(self.env.relfn2path(self.arguments[0])[1])
        files = sorted(folder.glob("*.json"))
        if not files:
            raise self.error(f"no JSON Schema in {folder}")
        for file in files:
            self.env.note_dependency(str(file))
        text = "\n".join(line for file in files for line in page(file.stem, json.loads(file.read_text("utf-8"))))
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def page(kind: str, schema: Schema) -> Iterator[str]:
    """One schema as Markdown: its own keys, then those of each definition."""
    yield from section(f"## {kind}", kind, schema)
    for name, definition in sorted(schema.get("$defs", {}).items()):
        yield from section(f"### {kind}: {name}", kind, definition)


def section(heading: str, kind: str, schema: Schema) -> Iterator[str]:
    """A heading, the description and a table of the keys; a definition without keys is one line with its type."""
    yield from ("", heading, "", schema.get("description", ""), "")
    if "properties" not in schema:
        yield typed(kind, schema)
        return
    keys = schema["properties"]
    titles = (
        "key",
        "type",
        "default",
        *(["meaning"] if any("description" in value for value in keys.values()) else []),
    )
    yield from (row(titles), row(["---"] * len(titles)))
    for key, value in keys.items():
        cells = f"`{key}`", typed(kind, value), default_of(key, schema), value.get("description", "")
        yield row(cells[: len(titles)])


def row(cells: Iterable[str]) -> str:
    """One row of a Markdown table."""
    return "| " + " | ".join(" ".join(cell.replace("|", r"\|").split()) for cell in cells) + " |"


def default_of(key: str, schema: Schema) -> str:
    """The default of a key as JSON; `null`, which stands for a key that is left out, is an empty cell."""
    if key in schema.get("required", ()):
        return "required"
    default = schema["properties"][key].get("default")
    return "" if default is None else f"`{json.dumps(default)}`"


def typed(kind: str, schema: Schema) -> str:
    """The type of a value in words, with its bounds and links to definitions of the same schema."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{kind}-{name.lower()})"
    for choice in ("anyOf", "oneOf", "allOf"):
        if choice in schema:
            return " or ".join(typed(kind, one) for one in schema[choice] if one.get("type") != "null")
    if "enum" in schema or "const" in schema:
        return " or ".join(f"`{json.dumps(one)}`" for one in schema.get("enum", [schema.get("const")]))
    bounds = [words.format(schema[name]) for name, words in BOUNDS.items() if name in schema]
    return ", ".join([contained(kind, schema), *bounds])


def contained(kind: str, schema: Schema) -> str:
    """The type without its bounds; lists and mappings name the type of what they hold."""
    plain = schema.get("type", "any")
    if plain == "array" and "prefixItems" in schema:
        return "list of " + ", ".join(typed(kind, one) for one in schema["prefixItems"])
    if plain == "array" and "items" in schema:
        return f"list of {typed(kind, schema['items'])}"
    if plain == "object" and isinstance(schema.get("additionalProperties"), Mapping):
        return f"mapping of {typed(kind, schema['additionalProperties'])}"
    return " or ".join(plain) if isinstance(plain, list) else str(plain)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("schemas", Schemas)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
