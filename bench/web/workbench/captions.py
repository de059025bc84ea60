"""Captions of figures: keys of the page's catalogue with their values, for any language, and the same in English."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from bench.base import FloatArray, finite, in_print, listed, number
from bench.deliver import Plot, described

Said = dict[str, Any]
"""`key` below `workbench.caption.` of the catalogue, and `values` by placeholder.

A value is a text that stays as it is, a number (3 significant digits), `{"number", "digits"}`, `{"number",
"decimals"}`, an `{"effect"}`, a `{"unit"}`, a `{"label"}` of a figure, another `Said`, or a list of these.
"""


def said(key: str, **values: Any) -> Said:
    """A sentence or a part of one; a number that does not exist becomes null."""
    return {"key": key, "values": {name: finite(v) if isinstance(v, float) else v for name, v in values.items()}}


def span(values: FloatArray) -> Said:
    """From the lowest to the highest of values (n,), to four digits."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (float("nan"),) * 2
    return said("span", low=_four(low), high=_four(high))


def floor_said(floor_dph: float) -> Said:
    """The noise floor as a sentence."""
    return said("floor", floor=floor_dph) if np.isfinite(floor_dph) else said("no_floor")


def effects_said(names: Sequence[str]) -> list[Said]:
    """Effects by their names."""
    return [{"effect": name} for name in names]


def captioned(plot: Plot, parts: Sequence[Said], table: list[list[Any]] | None = None) -> dict[str, Any]:
    """A figure for the page with its caption: `said` for the page's language, `words` in English."""
    return {**described(plot, " ".join(english(part) for part in parts), table), "said": list(parts)}


def english(value: Any) -> str:
    """A value of a caption, or a whole one, in English."""
    if isinstance(value, list):
        parts = [english(part) for part in value]
        return "; ".join(parts) if any("key" in part for part in value) else listed(parts)
    if not isinstance(value, Mapping):
        return value if isinstance(value, str) else number(value)
    if "key" not in value:
        return _plain(value)
    values = {name: english(part) for name, part in value["values"].items()}
    return str(_catalogue()[f"workbench.caption.{value['key']}"]).format(**values)


def _plain(value: Mapping[str, Any]) -> str:
    if "number" not in value:
        return str(value.get("effect") or value.get("label") or in_print(value["unit"]))
    if "decimals" in value:
        return f"{value['number']:.{value['decimals']}f}"
    return number(value["number"], value["digits"])


def _four(value: float) -> dict[str, Any]:
    return {"number": finite(value), "digits": 4}


@cache
def _catalogue() -> Mapping[str, Any]:
    words = files("bench.web") / "page/words/further/en.json"
    content: Mapping[str, Any] = json.loads(words.read_text(encoding="utf-8"))
    return content
