"""Strict YAML: every value with its line, and nothing guessed.

Scalars follow the YAML 1.2 core schema, not PyYAML's 1.1: `on` and `no` are text, `1e3` is a number, `12:30` is text,
`010` is ten. NaN, infinity, duplicate keys, tags, merge keys and several documents are refused.
Nothing here knows of equipment: register maps and the files of `bench` are read with it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

__all__ = ["Document", "Place", "PlacedError", "YamlError", "dump", "parse"]

Place = tuple[str | int, ...]
"""Where a value stands: keys and list positions from the top of the file."""

_MAX_NODES = 100_000
_LONGEST = 300
"""Digits of the longest whole number; a longer one is beyond every floating-point number, as infinity is."""
_INT = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.?(inf|infinity|nan)", re.IGNORECASE)
_WORDS = {word: value for value, text in ((True, "true"), (False, "false"), (None, "null"))
          for word in (text, text.title(), text.upper())} | {"~": None, "": None}  # fmt: skip


class YamlError(ValueError):
    """Something outside strict YAML; `line` counts from 1, None where there is none."""

    def __init__(self, text: str, line: int | None = None) -> None:
        super().__init__(text)
        self.line = line


class PlacedError(ValueError):
    """Raised in a model's validator about something deeper inside: its place gives the line."""

    def __init__(self, text: str, place: Place) -> None:
        super().__init__(text)
        self.place = place


@dataclass(frozen=True)
class Document:
    """A parsed file: plain Python values, and the line of each of them."""

    file: str
    content: Any
    lines: Mapping[Place, int]
    text: str = ""
    """As it was read, so that what is recorded is what was understood."""

    def line(self, path: Place) -> int:
        """Line (from 1) of the value at `path`, or of the nearest thing around it."""
        while path not in self.lines and path:
            path = path[:-1]
        return self.lines.get(path, 1)


class _Loader(yaml.SafeLoader):
    """PyYAML's parser without its YAML 1.1 guesses: every scalar arrives as text, and says whether it was quoted."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own attribute


class _Builder:
    def __init__(self) -> None:
        self.lines: dict[Place, int] = {}
        self._open: set[int] = set()

    def refuse(self, text: str, node: yaml.Node) -> YamlError:
        return YamlError(text, node.start_mark.line + 1)

    def build(self, node: yaml.Node, path: Place = ()) -> Any:
        self.lines.setdefault(path, node.start_mark.line + 1)
        if len(self.lines) > _MAX_NODES:
            raise self.refuse(f"more than {_MAX_NODES} values; aliases may have multiplied them", node)
        if id(node) in self._open:
            raise self.refuse("an alias refers to something that contains it", node)
        self._open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, path)
            if isinstance(node, yaml.SequenceNode):
                return [self.build(item, (*path, i)) for i, item in enumerate(node.value)]
            return self._scalar(node)
        finally:
            self._open.discard(id(node))

    def _mapping(self, node: yaml.MappingNode, path: Place) -> dict[str, Any]:
        self._check_tag(node, "tag:yaml.org,2002:map")
        found: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise self.refuse("a key must be plain text", key_node)
            key = key_node.value
            if key == "<<" and key_node.style is None:
                raise self.refuse("merge keys (<<) are not supported; write the values out", key_node)
            if key in found:
                first = self.lines[(*path, key)]
                raise self.refuse(f"duplicate key '{key}': already given in line {first}; keep one", key_node)
            self.lines[(*path, key)] = key_node.start_mark.line + 1
            found[key] = self.build(value_node, (*path, key))
        return found

    def _scalar(self, node: yaml.Node) -> Any:
        self._check_tag(node, "tag:yaml.org,2002:str")
        text: str = node.value
        if any("\ud800" <= sign <= "\udfff" for sign in text):
            raise self.refuse("holds half a character (a surrogate); write the character itself", node)
        if node.style is not None:  # type: ignore[attr-defined]
            return text
        value = _plain(text)
        if isinstance(value, float) and not math.isfinite(value):
            shown = text if len(text) <= _LONGEST else f"{text[:20]}... ({len(text):,} characters)"
            raise self.refuse(f"'{shown}' is not a finite number; every number must be finite", node)
        return value

    def _check_tag(self, node: yaml.Node, expected: str) -> None:
        if node.tag != expected:
            raise self.refuse(f"the tag {node.tag} is not supported; write a plain value", node)


def _plain(text: str) -> Any:
    """Value of an unquoted scalar by the YAML 1.2 core schema; words for infinity and NaN become such floats."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.fullmatch(text):
        return int(text) if len(text) <= _LONGEST else math.inf
    if _BASED.fullmatch(text):
        return int(text, 0) if len(text) <= _LONGEST else math.inf
    if _FLOAT.fullmatch(text) or _NOT_FINITE.fullmatch(text):
        return float(text.replace(".inf", "inf").replace(".nan", "nan")) if _FLOAT.fullmatch(text) else math.nan
    return text


def parse(text: str, file: Path | str) -> Document:
    """Parse YAML text; `file` is only kept. YamlError with the line for anything outside strict YAML."""
    try:
        node = yaml.compose(text, Loader=_Loader)
        if node is None:
            raise YamlError("is empty")
        builder = _Builder()
        return Document(str(file), builder.build(node), builder.lines, text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise YamlError(f"not YAML: {error.problem}", mark.line + 1 if mark else None) from None
    except yaml.YAMLError as error:
        raise YamlError(f"not YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise YamlError("is nested too deeply") from None


class _Dumper(yaml.SafeDumper):
    """Quotes text that YAML 1.2 would read as something else (PyYAML alone leaves `1e3` bare)."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    style = "'" if not isinstance(_plain(text), str) else "|" if "\n" in text else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style)


_Dumper.add_representer(str, _text)


def dump(content: Any) -> str:
    """YAML text of plain values, that `parse` reads back to equal values."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)
