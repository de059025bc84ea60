"""The catalogue of effects, for people and programs: everything from the effects and their docstrings."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from typing import Any, cast

from bench.analysis.effects.base import Effect, Parameter
from bench.analysis.effects.registry import PACKED, PACKS, doc, effect_names, get, make

SECTIONS = ("Equation", "Units", "Source", "When left out", "Look-alikes", "Separated by")
_EXAMPLE = "k * dT_dt * quadrature"


@dataclass(frozen=True)
class CatalogueEntry:
    """One effect: what rankings, command line and documentation want to know."""

    name: str
    family: str
    summary: str
    needs: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    options: dict[str, Any]
    moves_abscissa: bool
    suspect: bool
    """May be missing from a model: false for the static curves, which are what it is missing from, and for formulas."""
    sections: dict[str, str]

    @property
    def look_alikes(self) -> tuple[str, ...]:
        """Effects that the documentation says are easily taken for this one."""
        words = re.findall(r"[a-z_]+", self.sections.get("Look-alikes", ""))
        return tuple(dict.fromkeys(word for word in words if word in effect_names() and word != self.name))


def catalogue() -> tuple[CatalogueEntry, ...]:
    """All effects that are registered, the built-in ones first."""
    return tuple(entry(name) for name in effect_names())


def suspected() -> tuple[str, ...]:
    """Names of the effects that may be missing from a model."""
    return tuple(one.name for one in catalogue() if one.suspect)


def entry(name: str) -> CatalogueEntry:
    """Catalogue entry of one effect; InputError for an unknown name."""
    effect = make(name, {"formula": _EXAMPLE} if name == "expression" else None)
    return CatalogueEntry(
        name=name,
        family=effect.family,
        summary=doc(name).strip().split("\n", 1)[0].rstrip("."),
        needs=effect.needs,
        parameters=effect.parameters,
        options=_options(name, effect),
        moves_abscissa=effect.moves_abscissa,
        suspect=effect.family != "static" and name != "expression",
        sections=sections(name),
    )


def sections(name: str) -> dict[str, str]:
    """The documentation of an effect by heading, each one paragraph."""
    text = doc(name)
    paragraphs: dict[str, str] = {}
    marks = list(re.finditer(rf"^({'|'.join(SECTIONS)}): ", text, re.MULTILINE))
    for mark, after in zip(marks, [*marks[1:], None], strict=True):
        body = text[mark.end() : after.start() if after else len(text)]
        paragraphs[mark.group(1)] = " ".join(body.split())
    return paragraphs


def _options(name: str, effect: Effect) -> dict[str, Any]:
    if name == "expression":
        return {"formula": _EXAMPLE, "bounds": {}}
    known = [item.name for item in fields(cast(Any, get(name))) if not item.metadata.get("fitted")]
    return {option: getattr(effect, option) for option in known}


def markdown() -> str:
    """docs/effects.md: a table of all built-in effects, then a chapter for each."""
    names = [name for name in effect_names() if get(name).__module__.startswith("bench.analysis.effects.")]
    entries = [entry(name) for name in (*names, *(name for name in PACKED if name not in names))]
    packs = "; ".join(f"`{pack}` ({', '.join(kind.name for kind in kinds)})" for pack, kinds in PACKS.items())
    lines = [
        "# Effects",
        "",
        "Written by `python -m bench.analysis.effects` from its docstrings; do not edit. The bias is one constant plus "
        "the sum of the effects in the model. Amplitudes are solved exactly; nonlinear parameters are searched between "
        "the bounds given here. The places of jumps, kinks and loops are searched within what the run visits.",
        "",
        "Some effects exist in one kind of gyro only. Every model may contain them, but a diagnosis suspects them only "
        f"with `--effect KIND`: {packs}.",
        "",
        "| effect | what for | family | needs | nonlinear parameters |",
        "|---|---|---|---|---|",
    ]
    for one in entries:
        parameters = ", ".join(f"`{p.name}`" for p in one.parameters) or "-"
        needs = ", ".join(one.needs) or "time"
        lines.append(f"| [{one.name}](#{one.name}) | {one.summary} | {one.family} | {needs} | {parameters} |")
    for one in entries:
        lines += ["", f"## {one.name}", "", f"{one.summary}.", ""]
        lines += [f"- **{heading}:** {text}" for heading, text in one.sections.items()]
        options = ", ".join(f"`{key}: {_yaml(value)}`" for key, value in one.options.items())
        lines += [f"- **Options:** {options}"] * bool(options)
        lines += [_parameter(parameter) for parameter in one.parameters]
    return "\n".join(lines) + "\n"


def _yaml(value: object) -> object:
    return str(value).lower() if isinstance(value, bool) else value if value != "" else "''"


def _parameter(parameter: Parameter) -> str:
    scale = ", logarithmic" * parameter.log + ", a change point" * parameter.change_point
    span = f"{parameter.low:g} to {parameter.high:g} {parameter.unit}".rstrip()
    return f"- **Parameter** `{parameter.name}`: {parameter.meaning}, {span}{scale}"
