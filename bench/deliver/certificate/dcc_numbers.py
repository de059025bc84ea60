"""Numbers of certificate.json as quantities of the D-SI, in lists that have its structure."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bench.deliver.certificate.dsi import dsi, unit_of

if TYPE_CHECKING:
    from lxml.builder import ElementMaker
    from lxml.etree import _Element as Element

_ONE_SIGMA = "0.6827"
_OWN_UNIT = frozenset({"value", "low", "high", "std", "standard", "lower", "upper", "marginal", "from", "to"})
"""Keys whose number has the unit that stands beside it."""
_TITLES = ("meaning", "source", "key", "name")


class Numbers:
    """Makes the elements; `facts` says which uncertainty belongs to which number."""

    def __init__(self, node: ElementMaker, si: ElementMaker, facts: Mapping[str, Any]) -> None:
        self.node, self.si = node, si
        known = facts["uncertainty"]
        self._probability = known["coverage_probability"]
        self._whole = known
        self._at = {one["temperature_degc"]: one for one in known.get("by_temperature", ())}

    def listed(self, path: str, name: str, content: Any) -> Element | None:
        """A list of all numbers below `path`; None where there is none."""
        entries = content if isinstance(content, Mapping) else dict(enumerate(content))
        parts = [part for key, value in entries.items() if (part := self._part(path, key, value, entries)) is not None]
        if not parts:
            return None
        title = next((str(entries[key]) for key in _TITLES if entries.get(key)), _words(name))
        notes = [f"{_words(str(key))}: {value}" for key, value in self._notes(entries)]
        described = [self._text("description", *notes)] if notes else []
        return self.node("list", self._text("name", title), *described, *parts, id=_id(path))

    def _part(self, path: str, key: Any, value: Any, beside: Mapping[Any, Any]) -> Element | None:
        below = f"{path}.{key}"
        if isinstance(value, Mapping | list | tuple):
            return self.listed(below, str(key), value)
        unit = _unit(str(key), path, beside)
        if not _is_number(value) or unit is None or _in_another(str(key), beside):
            return None
        words = str(beside.get("meaning", _words(str(key)))) if key == "value" else _words(str(key))
        number = self.si(
            "real", self.si("value", json.dumps(value)), self.si("unit", unit), *self._spread(path, key, beside)
        )
        return self.node("quantity", self._text("name", words), number, id=_id(below))

    def _spread(self, path: str, key: Any, beside: Mapping[Any, Any]) -> Iterator[Element]:
        """The expanded uncertainty of a number, where it has one."""
        if key == "value" and beside.get("std"):
            yield self._expanded(beside["std"], 1, _ONE_SIGMA)
        at = None
        if path == "as_left" and key == "mean_dph":
            at = self._whole
        if path.startswith("over_temperature") and str(key).startswith("left_"):
            at = self._at.get(beside["temperature_degc"])
        if at and at.get("expanded_dph") and (at.get("coverage_factor") or 0) >= 1:
            yield self._expanded(at["expanded_dph"], at["coverage_factor"], json.dumps(self._probability))

    def _expanded(self, uncertainty: float, factor: float, probability: str) -> Element:
        known = {"uncertainty": json.dumps(uncertainty), "coverageFactor": json.dumps(factor),
                 "coverageProbability": probability}  # fmt: skip
        return self.si("expandedUnc", *(self.si(name, text) for name, text in known.items()))

    def _notes(self, entries: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
        for key, value in entries.items():
            if isinstance(value, str | bool) and value != "" and key not in {"name", "unit"}:
                yield key, value
            elif _is_number(value) and _unit(str(key), "", entries) is None:
                yield key, f"{value} {entries.get('unit', '')}"

    def _text(self, tag: str, *lines: str) -> Element:
        return self.node(tag, *(self.node("content", line, lang="en") for line in lines))


def _unit(key: str, path: str, beside: Mapping[Any, Any]) -> str | None:
    """D-SI unit of a number; None where the D-SI cannot say it."""
    if key in _OWN_UNIT and "unit" in beside:
        return dsi(str(beside["unit"]))
    if key == "sensitivity" and "unit" in beside:
        power = beside.get("power", 1)
        unit = str(beside["unit"])
        return dsi("1" if unit == "deg/h" else f"deg/h/{unit}" + (f"^{power}" if power > 1 else ""))
    if key.isdigit():  # an item of a list has the unit that the name of the list ends in
        return dsi("deg/h" if path.endswith("turn_ons") else unit_of(path.rpartition(".")[2]))
    if key == "value" and "key" in beside:
        return dsi(unit_of(str(beside["key"])))
    return dsi(unit_of(key))


def _in_another(key: str, beside: Mapping[Any, Any]) -> bool:
    """Whether a number stands in the uncertainty of its neighbour."""
    return key == "std" and "value" in beside and bool(beside[key])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _words(key: str) -> str:
    return key.replace("_", " ")


def _id(path: str) -> str:
    return re.sub(r"[^\w.-]", "_", path)
