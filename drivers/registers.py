"""Register maps as files: the shipped ones in `drivers/chambers/`, or any YAML file, given by path."""

from __future__ import annotations

import difflib
from dataclasses import fields
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from drivers import yaml12
from drivers.errors import ConfigError
from drivers.register import MAX_BLOCK_WORDS, Register, Value, block_of
from drivers.register_map import Ramp, RegisterMap, Rule, Run

__all__ = [
    "MAX_BLOCK_WORDS",
    "Ramp",
    "Register",
    "RegisterMap",
    "Rule",
    "Run",
    "Value",
    "block_of",
    "is_map_file",
    "list_maps",
    "load_map",
    "map_text",
    "parse_map",
]

_KEYS: dict[str, type] = {"registers": Register, "identify": Rule, "run": Run, "ramp": Ramp}
_WORDS = {
    "missing": "is missing",
    "dataclass_type": "must hold keys and values",
    "mapping_type": "must hold keys and values",
    "dict_type": "must hold keys and values",
    "tuple_type": "must be a list",
    "string_type": "must be text; put it in quotes",
    "string_too_short": "must not be empty",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "finite_number": "must be a finite number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
}
_SUFFIXES = (".yaml", ".yml")


def list_maps() -> list[str]:
    """Names of the shipped maps."""
    return sorted(entry.name[:-5] for entry in (files("drivers") / "chambers").iterdir() if entry.name[-5:] == ".yaml")


def is_map_file(name_or_path: str | Path) -> bool:
    """Whether a map is given by the path of a file, not by the name of a shipped map."""
    return Path(name_or_path).suffix in _SUFFIXES


def load_map(name_or_path: str | Path) -> RegisterMap:
    """The map of a controller model, by the name of a shipped map or by the path of a YAML file.

    Raises ConfigError with everything that is wrong, with file, line and the nearest known key.
    """
    return parse_map(*map_text(name_or_path))


def map_text(name_or_path: str | Path) -> tuple[str, str]:
    """The text of a map, and how errors name it; ConfigError where there is none."""
    path = Path(name_or_path)
    try:
        if is_map_file(path):
            text = path.read_text("utf-8")
        elif str(name_or_path) in list_maps():
            text = (files("drivers") / "chambers" / f"{name_or_path}.yaml").read_text("utf-8")
        else:
            raise ConfigError(f"no register map {str(name_or_path)!r}; shipped are {', '.join(list_maps())}")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "is not text in UTF-8"
        raise ConfigError(f"register map {path}: {why}") from error
    return text, str(name_or_path)


@lru_cache(maxsize=32)  # a run asks for the same map three times, and to read one takes 20 ms
def parse_map(text: str, where: str) -> RegisterMap:
    """The map written in YAML `text`, not to be changed; `where` names it in errors. Raises ConfigError."""
    try:
        document = yaml12.parse(text, where)
    except yaml12.YamlError as error:
        raise ConfigError(f"{where}:{error.line or 1}: {error}") from error
    data = document.content
    if not isinstance(data, dict):
        raise ConfigError(f"{where}:1: a register map must be a mapping")
    registers = data.get("registers")
    for name, entry in registers.items() if isinstance(registers, dict) else ():
        if isinstance(entry, dict):
            entry["name"] = name
            entry.setdefault("word_order", data.get("word_order"))
    try:
        return TypeAdapter(RegisterMap).validate_python(data)
    except ValidationError as error:
        raise ConfigError(_explain(error, document)) from error


def _explain(error: ValidationError, document: yaml12.Document) -> str:
    """Every error as file, line, key, value, what is allowed, and the nearest known key."""
    found = sorted(dict.fromkeys(_located(entry, document) for entry in error.errors()))
    return "\n".join(f"{document.file}:{line}: {text}" for line, text in found)


def _located(entry: ErrorDetails, document: yaml12.Document) -> tuple[int, str]:
    """Line and text of one error."""
    kind = entry["type"]
    place = (*entry["loc"], *getattr(entry.get("ctx", {}).get("error"), "place", ()))
    if kind == "unexpected_keyword_argument":
        known = [one.name for one in fields(_KEYS[str(place[0])] if len(place) > 1 else RegisterMap)]
        near = difflib.get_close_matches(str(place[-1]), known, 1)
        text = "unknown key" + (f"; did you mean {near[0]}?" if near else f"; known are {', '.join(known)}")
    else:
        message = entry["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
        allowed = _WORDS.get(kind) or message
        simple = isinstance(entry["input"], str | int | float) and kind != "value_error"
        text = f"is {entry['input']!r}; it {allowed}" if simple else allowed
    where = ".".join(map(str, place))
    return document.line(place), f"{f'{where}: ' if where else ''}{text}"
