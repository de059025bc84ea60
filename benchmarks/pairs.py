"""Pairs of hidden effects, and how often the stated uncertainties hold the truth.

    python -m benchmarks.pairs --pairs 100 --singles 400 --seed 1 --out pairs.jsonl

A pair is two mechanisms of the simulated truth at strength 1 each on a ramp at two rates, with an isothermal run. It
counts as right where both families are found, and the places and time constants that truth and effect share lie within
two of their stated standard deviations; counted beside it where their sizes do, too. Coverage is counted over such
values of units with one mechanism at strength 1 to 2 whose effect was found first. Results are appended to the file as
they come; what stands there already is not run again. Prints one JSON object with n and seed; exit code 1 where a 95 %
interval lies beyond its bar: 90 % of the pairs, 68 +- 6 % of the values within one standard deviation and 95 +- 3 %
within two.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, cycle, islice
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.effects import registry as effects
from bench.mystery.hidden import HIDDEN
from benchmarks import campaigns, cases
from benchmarks.trials import MODEL
from drivers.sim.truth import MECHANISMS

BAR = 0.9
COVERAGE = {1: (0.68, 0.06), 2: (0.95, 0.03)}
_STILL = 4
_TURN = ("scale_factor_temperature", "scale_factor_nonlinearity")


def _field(name: str, unit: float = 1.0, sized: bool = False) -> Callable[[Mapping[str, Any], float], float]:
    """A field of an entry in the effect's unit; of an amplitude, times the factor that gives the strength."""

    def value(entry: Mapping[str, Any], factor: float) -> float:
        found = entry.get(name, MECHANISMS[entry["mechanism"]].model_fields[name].default)
        found = found[0] if isinstance(found, list | tuple) else found
        return float(found) * unit * (factor if sized else 1.0)

    return value


SHARED: dict[str, dict[str, Callable[[Mapping[str, Any], float], float]]] = {
    "thermal_lag": {"tau_s": _field("tau_s", sized=True)},
    "bias_jump": {"at_h": _field("at_s", 1.0 / 3600.0), "a": _field("step_dph", sized=True)},
    "bias_kink": {"at_degc": _field("at_degc")},
    "aging": {"line": _field("linear_dph_per_h", sized=True)},
    "supply_voltage": {"k": _field("k_dph_per_v", sized=True)},
    "drive_amplitude": {"k1": _field("k_dph_per_percent", sized=True)},
    "temperature_rate": {"k1": _field("k_dph_per_degc_per_min", sized=True)},
}
"""Values that a mechanism and its effect have in common, by the effect's name for them."""
_SIZES = {"a", "line", "k", "k1"}


@dataclass(frozen=True)
class Case:
    """One unit with one or two mechanisms."""

    hidden: str
    strength: float
    number: int


def todo(pairs: int, singles: int, seed: int) -> Iterator[Case]:
    """All cases, pairs and single mechanisms in turn."""
    known = [name for name, one in HIDDEN.items() if one.effect and name not in _TURN]
    every = [
        (a, b) for a, b in combinations(known, 2)
        if HIDDEN[a].effect != HIDDEN[b].effect and (not HIDDEN[a].group or HIDDEN[a].group != HIDDEN[b].group)
    ]  # fmt: skip
    mixed = sorted(every, key=lambda pair: hash_of(pair[0] + pair[1] + str(seed)))
    both = [Case("+".join(pair), 1.0, seed * 10_000 + i) for i, pair in enumerate(islice(cycle(mixed), pairs))]
    alone = [
        Case(name, (1.0, 1.5, 2.0)[i % 3], seed * 10_000 + 5000 + i)
        for i, name in enumerate(islice(cycle(SHARED), singles))
    ]
    for i in range(max(len(both), len(alone))):
        yield from (*both[i : i + 1], *alone[i : i + 1])


def hash_of(text: str) -> int:
    """A number that shuffles, the same in every process."""
    return sum((i + 1) * 7919 * ord(letter) for i, letter in enumerate(text)) % 104_729


def run_case(case: Case) -> dict[str, Any]:
    """Effects found, and of each value that is shared the error in standard deviations."""
    hidden = tuple(case.hidden.split("+"))
    unit = cases.case(hidden, case.strength, case.number, cases.TWO_RATES, MODEL)
    found = diagnose([unit.run(cases.TWO_RATES)], MODEL, static=unit.run(cases.STATIC, _STILL))
    values: dict[str, float] = {}
    for entry, factor in unit.parts:
        suspect = next((s for s in found.found if s.effect == HIDDEN[entry["mechanism"]].effect), None)
        for name, truth in SHARED.get(entry["mechanism"], {}).items():
            stated = None if suspect is None else suspect.parameters.get(name)
            if stated is not None and stated.std > 0.0:
                values[f"{entry['mechanism']}.{name}"] = round((stated.value - truth(entry, factor)) / stated.std, 3)
    return {"effects": [s.effect for s in found.found], "deviations": values}


def right(case: Case, result: dict[str, Any]) -> tuple[bool, bool, bool]:
    """Whether both families were found; and places and times within two standard deviations; and sizes as well."""
    named = {effects.make(name).family for name in result["effects"]}
    wanted = {effects.make(str(HIDDEN[name].effect)).family for name in case.hidden.split("+")}
    both = wanted <= named
    off = {name.partition(".")[2] for name, z in result["deviations"].items() if abs(z) > 2.0}
    return both, both and off <= _SIZES, both and not off


_PAIRS = {
    "both found": "both effects of a pair found",
    "places and times": "and places and time constants within two deviations",
    "sizes too": "and sizes within two deviations as well",
}


def table(results: Sequence[tuple[Case, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Pairs found, and coverage of one and two standard deviations over single mechanisms."""
    pairs = [right(case, found) for case, found in results if "+" in case.hidden]
    alone = [z for case, found in results if "+" not in case.hidden for z in found["deviations"].values()]
    rows = [_row(what, [pair[i] for pair in pairs], BAR, 1.0) for i, what in enumerate(_PAIRS)]
    for sigma, (share, margin) in COVERAGE.items():
        rows.append(_row(f"within {sigma}", [abs(z) <= sigma for z in alone], share - margin, share + margin))
    return [row for row in rows if row["n"]]


def _row(what: str, held: Sequence[bool], low: float, high: float) -> dict[str, Any]:
    if not held:
        return {"what": what, "n": 0}
    ends = binomtest(sum(held), len(held)).proportion_ci(0.95, method="exact")
    return {
        "what": what, "n": len(held), "held": sum(held), "share": round(sum(held) / len(held), 4),
        "interval": [round(ends.low, 4), round(ends.high, 4)], "bar": [round(low, 2), round(high, 2)],
        "missed": bool(ends.high < low or ends.low > high),
    }  # fmt: skip


def section(path: Path) -> str:
    """The part of docs/hidden_effects.md about these results; empty without any."""
    found = campaigns.read(path, lambda c: (Case(c["hidden"], c["strength"], c["number"]), c["found"]))
    if not found:
        return ""
    lines = [
        "## Pairs of effects, and coverage of stated uncertainties",
        "",
        "Written from `python -m benchmarks.pairs`: two mechanisms at strength 1 each, and values of single mechanisms",
        "at strength 1 to 2 whose effect was found.",
        "",
        "| count | n | share | 95 % interval | bar |",
        "|---|---|---|---|---|",
    ]
    words = _PAIRS | {"within 1": "values within one standard deviation", "within 2": "values within two"}
    for row in table(found):
        low, high = (100.0 * end for end in row["interval"])
        bar = " to ".join(f"{100 * end:.0f}" for end in row["bar"])
        share = f"{100 * row['share']:.0f} %"
        lines.append(f"| {words[row['what']]} | {row['n']} | {share} | {low:.0f} to {high:.0f} % | {bar} % |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--singles", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("pairs.jsonl"))
    arguments = parser.parse_args()
    wanted = list(todo(arguments.pairs, arguments.singles, arguments.seed))
    rows = table(campaigns.found(wanted, run_case, arguments.out, Case))
    print(json.dumps({"seed": arguments.seed, "table": rows}, indent=1))
    return 1 if any(row["missed"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
