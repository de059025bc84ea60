"""A model of the bias: a named list of effects and their options, as a YAML file; nothing but the list.

name: spline
rows: all                 # all, heating, cooling, soaks_2, soaks_3 or bins: which rows are fitted
effects:
  - spline: {intervals: 24, ends: natural}
  - thermal_lag
  - expression: "k * dT_dt * quadrature"   # a term of your own
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.analysis.effects import registry as effects
from bench.analysis.effects.base import Effect, options_of
from bench.base import Document, InputError, dump, library, nearest_or_all, parse_yaml, read_yaml

ROWS = ("all", "heating", "cooling", "soaks_2", "soaks_3", "bins")
"""Rows that a model is fitted to: all, one branch only, the means of 2 or 3 soaks (fixed-temperature method), or
bins of equal width: a surface's at each rate, a spline's about each knot, through whose means it then goes.
"""

MODELS = Path("profiles") / "models"
"""Folder of the user's own named models, below the folder that commands and the page's server are started in."""

_KEYS = ("name", "rows", "effects")


@dataclass(frozen=True)
class Model:
    """One constant plus the sum of `effects`; `rows` says to which rows it is fitted (baselines fit fewer)."""

    name: str
    effects: tuple[Effect, ...]
    rows: str = "all"

    def __post_init__(self) -> None:
        if not self.effects:
            raise InputError(f"model '{self.name}' has no effects; known are {', '.join(effects.effect_names())}")
        if self.rows not in ROWS:
            raise InputError(f"model '{self.name}': rows is {self.rows!r}, allowed are {', '.join(ROWS)}")

    @property
    def keys(self) -> tuple[str, ...]:
        """One unique key an effect: its name, and `name_2` for the second of a kind."""
        names = [effect.name for effect in self.effects]
        seen = [names[:i].count(name) for i, name in enumerate(names)]
        return tuple(f"{name}_{n + 1}" if n else name for name, n in zip(names, seen, strict=True))

    @property
    def needs(self) -> tuple[str, ...]:
        """Channels of all effects, each once."""
        return tuple(dict.fromkeys(channel for effect in self.effects for channel in effect.needs))

    def adding(self, effect: Effect, name: str | None = None) -> Model:
        """The model with one more effect, without the terms that both have and those that it replaces."""
        more = effect.beside(self.effects)
        gone = [other.name for other in self.effects if more.replaces(other)]
        called = f"{self.name}, {more.name} for {gone[0]}" if gone else f"{self.name} + {more.name}"
        kept = tuple(other for other in self.effects if other.name not in gone)
        return replace(self, name=name or called, effects=(*kept, more))

    def to_yaml(self) -> str:
        """The file's text; `load_model` reads it back to an equal model."""
        entries = [_entry(e) for e in self.effects]
        content: dict[str, Any] = {"name": self.name, "effects": entries}
        if self.rows != "all":
            content["rows"] = self.rows
        return dump(content)


def _entry(effect: Effect) -> Any:
    options = options_of(effect)
    if effect.name == "expression" and set(options) == {"formula"}:
        return {"expression": options["formula"]}
    return {effect.name: options} if options else effect.name


def entry_text(effect: Effect) -> str:
    """An effect as one line of YAML, as it stands in the list of a model file; `effect_from` reads it back."""
    entry = _entry(effect)
    return entry if isinstance(entry, str) else json.dumps(entry)  # double quotes: a shell takes it in single ones


def shell_text(effect: Effect) -> str:
    """An effect as a command takes it: its name, or its entry in quotes where it has options."""
    text = entry_text(effect)
    return text if text == effect.name else f"'{text}'"


def effect_from(text: str) -> Effect:
    """Effect of a name, a line of YAML as `entry_text` writes it, or the formula of a term of one's own.

    InputError for an unknown name and for what is neither.
    """
    if text in effects.effect_names() or text.isidentifier():
        return effects.make(text)
    if text.lstrip().startswith("{"):
        return _effect(parse_yaml(text, "effect").content, None, 0)
    return effects.make("expression", {"formula": text})


def load_model(source: str | Path | Document) -> Model:
    """Model from a YAML file (or one that was read), by the name of a file in profiles/models, or of an effect alone.

    Raises InputError: no such model, not YAML, unknown key, effect or option (with the nearest known word and line).
    """
    if isinstance(source, Document):
        return model_from(source.content, source)
    path = Path(source)
    if path.is_file():
        return _read(path)
    name = str(source)
    if path.suffix in {".yaml", ".yml"} or path.parent != Path():
        raise InputError("no such model file", path)
    files = model_files()
    if name in files:
        return _read(files[name])
    if name in effects.effect_names() or name in effects.PACKED:
        return Model(name, (effects.make(name),))
    known = {*files, *effects.effect_names()}
    raise InputError(f"unknown model '{name}'{nearest_or_all(name, tuple(sorted(known)))}")


def model_files(project: Path = Path()) -> dict[str, Path]:
    """Named models, sorted: shipped ones, replaced by those in `profiles/models` of the user's folder `project`."""
    folders = (library() / "models", project / MODELS)
    found = {file.stem: file for folder in folders if folder.is_dir() for file in folder.glob("*.yaml")}
    return {name: found[name] for name in sorted(found) if found[name].is_file()}


def _read(path: Path) -> Model:
    document = read_yaml(path)
    return model_from(document.content, document)


def model_from(content: object, document: Document | None = None) -> Model:
    """Model from parsed YAML; InputError, with the line in `document`, for anything that is not exactly a model."""
    with _at(document):
        if not isinstance(content, Mapping):
            raise InputError(f"a model is a mapping with the keys {', '.join(_KEYS)}")
        for key in content:
            if key not in _KEYS:
                with _at(document, key):
                    raise InputError(f"unknown key '{key}'{nearest_or_all(str(key), _KEYS)}")
        name, entries, rows = content.get("name"), content.get("effects"), content.get("rows", "all")
        if not isinstance(name, str) or not name:
            raise InputError("a model needs a 'name'")
        if not isinstance(entries, list):
            raise InputError("'effects' must be a list, such as [spline] or [{spline: {intervals: 24}}]")
        return Model(name, tuple(_effect(entry, document, i) for i, entry in enumerate(entries)), rows)


def _effect(entry: object, document: Document | None, index: int) -> Effect:
    with _at(document, "effects", index):
        if isinstance(entry, str):
            return effects.make(entry)
        if isinstance(entry, Mapping) and len(entry) == 1:
            ((name, options),) = entry.items()
            if name == "expression" and isinstance(options, str):
                options = {"formula": options}
            if options is None or isinstance(options, Mapping):
                return effects.make(str(name), options)
        raise InputError(f"{entry!r} is not an effect; write its name, or {{name: {{option: value}}}}")


@contextmanager
def _at(document: Document | None, *place: str | int) -> Iterator[None]:
    """Say file and line in an InputError from inside that does not say them yet."""
    try:
        yield
    except InputError as error:
        if document is None or error.file is not None:
            raise
        raise InputError(str(error), document.file, document.line(place)) from None
