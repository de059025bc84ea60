"""What does the bench say where nothing is missing, and where the cause is in a channel that nobody recorded?

    python -m benchmarks.clean_colours --seeds 40 --out clean_colours.jsonl

A clean run is a unit with a smooth curve, and noise of one of seven colours that the analysis does not assume; with
and without an isothermal run, and a check run, of the same noise. Counted are names (a headline, an effect that is
suspected, or a formula) and any alarm (a verdict that is not "adequate"). An unrecorded cause is an effect of
strength 2 or more whose channel is taken out of the run; counted is how often the bench then says "adequate" without
the words that a slow cause cannot be told. Results are appended to the file as they come; what stands there already
is not run again. Prints one JSON object with n and seed.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from bench.analysis.diagnosis.answer import Diagnosis
from bench.analysis.diagnosis.diagnose import diagnose
from bench.base.channels import FloatArray
from bench.mystery.hidden import static_curve
from bench.record.dataset import Dataset
from benchmarks import campaigns, cases
from benchmarks.bars import table
from benchmarks.trials import MODEL

COLOURS = ("white", "flicker x 5", "1/f^1.5", "heavy tails", "telegraph", "spikes", "grows with temperature")
PROFILES = (cases.TWO_RATES, cases.ONE_RATE)
CHANNEL = {
    "supply_voltage": "supply",
    "drive_amplitude": "drive",
    "quadrature_leakage": "quadrature",
    "unlogged_drift": "",
}
STRENGTHS = (2.0, 6.0)
UNITS = 6
WHITE_DPH = 0.11
"""White noise of a mean over 30 s; the other colours have it, too, or their own share of it."""
CANNOT = ("slow cause", "--static", "no soak shows")
"""Words of which an honest "adequate" has one where a slow cause cannot be told."""


@dataclass(frozen=True)
class Case:
    """A clean run with noise of a `colour`, or one with a `hidden` mechanism whose channel is not recorded."""

    profile: str
    number: int
    colour: str = ""
    hidden: str = ""
    strength: float = 0.0
    static: bool = True
    checked: bool = False


def todo(seeds: int) -> Iterator[Case]:
    """Seed by seed, so that a campaign cut short is a smaller campaign."""
    for number in range(1, seeds + 1):
        for profile in PROFILES:
            yield from (
                Case(profile, number, colour, static=number % 4 != 0, checked=number % 2 == 1) for colour in COLOURS
            )
            for name in list(CHANNEL)[number % 2 :: 2]:
                yield Case(profile, number, hidden=name, strength=STRENGTHS[number % 2], static=number % 3 != 0)


def noise(colour: str, rows: int, temperature: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Noise of means over 30 s (rows,) [deg/h]; a form of the analysis has none but the first."""
    white = rng.normal(size=rows)
    made: dict[str, Callable[[], FloatArray]] = {
        "white": lambda: white,
        "flicker x 5": lambda: white + 1.4 * _power_law(rows, 1.0, rng),
        "1/f^1.5": lambda: white + 1.0 * _power_law(rows, 1.5, rng),
        "heavy tails": lambda: rng.standard_t(3.0, size=rows) / np.sqrt(3.0),
        "telegraph": lambda: white + 0.7 * _telegraph(rows, rng),
        "spikes": lambda: white + np.where(rng.random(rows) < 0.005, rng.normal(size=rows) * 12.0, 0.0),
        "grows with temperature": lambda: white * np.interp(temperature, [-40.0, 85.0], [0.7, 1.6]),
    }
    return np.asarray(WHITE_DPH * made[colour]())


def _power_law(rows: int, slope: float, rng: np.random.Generator) -> FloatArray:
    """Noise with a spectrum of 1/f^slope; of flicker the deviation is about that of the white part per octave."""
    length = 8 * rows
    frequency = np.fft.rfftfreq(length)[1:]
    spectrum = frequency ** (-slope / 2.0) * (rng.normal(size=frequency.size) + 1j * rng.normal(size=frequency.size))
    made = np.fft.irfft(np.concatenate([[0.0], spectrum]), length)[:rows]
    scale = np.sqrt(np.mean(frequency[length // 64 :] ** -slope) * frequency.size) / length
    return np.asarray(made / (2.0 * scale) / np.sqrt(2.0))


def _telegraph(rows: int, rng: np.random.Generator) -> FloatArray:
    """Two levels, changed at random about every 20 minutes."""
    return np.where(np.cumsum(rng.random(rows) < 1.0 / 40.0) % 2, 1.0, -1.0)


@lru_cache(maxsize=2 * UNITS * 2)
def _silent(profile: str, unit: int) -> Dataset:
    curve = static_curve(np.random.default_rng(unit))
    return cases.recorded([curve], cases.SILENT, profile, 1000 * unit)


def noisy(profile: str, number: int, colour: str, seed: int) -> Dataset:
    """A run of a unit without hidden effects, with noise of this colour."""
    run = _silent(profile, 1 + number % UNITS)
    rng = np.random.default_rng([seed, number, zlib.crc32(f"{profile} {colour}".encode())])
    added = noise(colour, len(run), run.channel("temperature"), rng)
    return replace(run, channels={**run.channels, "rate": run.channels["rate"] + added})


def runs_of(case: Case, seed: int) -> tuple[Dataset, Dataset | None, list[Dataset]]:
    """The run, and the isothermal run and the check run where the case has one."""
    if case.colour:
        made = (noisy(p, case.number, case.colour, seed) for p in (case.profile, cases.STATIC, cases.LOOPS))
        run, still, check = made
        return run, still if case.static else None, [check] if case.checked else []
    unit = cases.case((case.hidden,), case.strength, case.number, case.profile, MODEL)
    run = unit.run(case.profile)
    kept = {name: values for name, values in run.channels.items() if name != CHANNEL[case.hidden]}
    return replace(run, channels=kept), unit.quiet(cases.STATIC, 4) if case.static else None, []


def run_case(case: Case, seed: int) -> dict[str, Any]:
    """What the bench says to it."""
    run, still, check = runs_of(case, seed)
    return content(diagnose([run], MODEL, check=check, static=still, seed=seed))


def content(found: Diagnosis) -> dict[str, Any]:
    """What is counted of an answer."""
    return {
        "verdict": found.verdict,
        "proved": found.proved,
        "found": [suspect.effect for suspect in found.found],
        "named": [suspect.effect for suspect in found.named],
        "formulas": len(getattr(found, "formulas", ())),
        "evidence": round(max((s.evidence for s in found.suspects), default=0.0), 2),
        "threshold": round(found.threshold, 2),
        "ratio": round(found.held_out_rms_dph / found.floor_dph, 3),
        "sentence": found.sentence,
    }


def silent_adequate(result: dict[str, Any]) -> bool:
    """Whether it says "adequate" without the words that a slow cause cannot be told."""
    return result["verdict"] == "adequate" and not any(words in result["sentence"] for words in CANNOT)


def counts(results: Sequence[tuple[Case, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Of each kind of case: n, names, alarms, each with the 95 % interval."""
    clean = [(case, found) for case, found in results if case.colour]
    listed = [_clean(f"clean, {p}", [f for case, f in clean if case.profile == p]) for p in PROFILES]
    listed += [_clean(f"clean, {colour}", [f for case, f in clean if case.colour == colour]) for colour in COLOURS]
    listed += [
        _clean(f"clean, {word} isothermal run", [f for case, f in clean if case.static is has])
        for word, has in (("with", True), ("without", False))
    ]
    listed.append(_clean("clean, with check run", [f for case, f in clean if case.checked]))
    for word, has in (("with", True), ("without", False)):
        hidden = [f for case, f in results if case.hidden and case.static is has]
        listed.append(
            {
                "what": f"cause in no channel, {word} isothermal run",
                "n": len(hidden),
                "adequate": sum(f["verdict"] == "adequate" for f in hidden),
                "adequate without the words": _share([silent_adequate(f) for f in hidden]),
            }
        )
    return [row for row in listed if row["n"]]


def _clean(what: str, results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    headline = [bool(f["named"] or f["formulas"]) for f in results]
    return {
        "what": what,
        "n": len(results),
        "headline": _share(headline),
        "named": _share([bool(f["found"] or f["formulas"]) for f in results]),
        "alarm": _share([f["verdict"] != "adequate" for f in results]),
    }


def _share(true: Sequence[bool]) -> list[float]:
    """Count, and the ends of the 95 % interval of the share (Wilson)."""
    if not true:
        return [0, 0.0, 1.0]
    ends = binomtest(sum(true), len(true)).proportion_ci(method="wilson")
    return [sum(true), round(ends.low, 4), round(ends.high, 4)]


def section(path: Path) -> str:
    """Part of docs/hidden_effects.md; empty without results."""
    results = campaigns.known(path, Case)
    if not results:
        return ""
    rows = []
    for row in counts(results):
        shares = [row.get(key) for key in ("headline", "named", "alarm", "adequate without the words")]
        rows.append((row["what"], str(row["n"]), *("–" if s is None else _words(s, row["n"]) for s in shares)))
    head = ("", "runs", "headline", "any name or formula", "any alarm", '"adequate", a slow cause not mentioned')
    text = (
        "Share of runs, with the 95 % interval. Bars: at most 2 % named, at most 5 % with any alarm, 0 without words."
    )
    return f"## Noise of seven colours, and causes that no channel records\n\n{text}\n{table(head, rows)}\n"


def _words(share: list[float], n: int) -> str:
    return f"{100 * share[0] / n:.1f} % ({100 * share[1]:.1f} to {100 * share[2]:.1f})"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--colour", action="append", default=[], choices=COLOURS, help="only this; repeatable")
    parser.add_argument("--out", type=Path, default=Path("clean_colours.jsonl"))
    arguments = parser.parse_args()
    wanted = [case for case in todo(arguments.seeds) if not arguments.colour or case.colour in arguments.colour]
    results = campaigns.found(wanted, lambda case: run_case(case, arguments.seed), arguments.out, Case)
    print(json.dumps({"seed": arguments.seed, "table": counts(results)}, indent=1))


if __name__ == "__main__":
    main()
