"""What no catalogue holds: mechanisms outside it and outside the grammar's grid, and whether a formula describes them.

    python -m benchmarks.outside --seeds 6 --out outside.jsonl

Every truth is integrated by itself at one second from the states of the chamber and the channels of a unit, with states
of its own, and shares no operator with the bench. It is added to a run with the noise of the simulated unit, at a
strength (RMS that the static curve cannot absorb over that of the noise). The bench is given a run and a check run.
*Equivalent*: on a run that it was not given, of a third profile, the answer predicts at least 80 % of the variance that
the truth adds beside a static curve; the noise of that run, which both have, cancels in the differences. `checked` is
the error on the check run, over the true model's. Results are appended to the file as they come; what stands there
already is not run again. Prints one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from bench.analysis.diagnosis.diagnose import diagnose
from bench.analysis.effects.model import Model
from bench.analysis.fit.fitting import fit_model
from bench.base import FloatArray
from bench.record.dataset import Dataset
from benchmarks import campaigns, cases
from benchmarks.bars import table
from benchmarks.mechanisms import TRUTHS
from benchmarks.mechanisms.world import World, constants
from benchmarks.trials import MODEL

RUN, CHECK, JUDGE = cases.TWO_RATES, cases.LOOPS, "steps_-40_85"
LEAST_SHARE = 0.8
MOST_RATIO = 1.15


@dataclass(frozen=True)
class Trial:
    """One mechanism in one unit."""

    truth: str
    strength: float
    seed: int


def run_trial(trial: Trial) -> dict[str, Any]:
    """What the bench answers, and how well its answer predicts an unseen run."""
    made, truth = _unit(trial)
    first, check, judge, still = made
    began = time.process_time()
    found = diagnose([first], MODEL, check=[check], static=still)
    spent = time.process_time() - began
    formula = next(iter(found.formulas), None)
    model = found.improved if formula is None else formula.model
    before, after, oracle = _errors(model, first, judge, truth[0], truth[2])
    checked = _errors(model, first, check, truth[0], truth[1])
    return {
        "verdict": found.verdict,
        "proved": found.proved,
        "found": [suspect.effect for suspect in found.found],
        "formula": "" if formula is None else formula.formula,
        "evidence": None if formula is None else round(formula.evidence, 1),
        "share": round(1.0 - (_rms(after - oracle) / _rms(before - oracle)) ** 2, 4),
        "ratio": round(_rms(after) / _rms(oracle), 4),
        "before": round(_rms(before) / _rms(oracle), 4),
        "checked": round(_rms(checked[1]) / _rms(checked[2]), 4),
        "cpu_s": round(spent, 2),
    }


def _unit(trial: Trial) -> tuple[tuple[Dataset, ...], tuple[FloatArray, ...]]:
    """Run, check run, judging run and isothermal run of a unit, and what the truth adds to the first three [deg/h]."""
    case = cases.case((), 0.0, trial.seed, RUN, MODEL)
    name = f"{trial.truth}"
    added, known = [], list[float]()
    for number, profile in enumerate((RUN, CHECK, JUDGE)):
        quiet = case.quiet(profile, number)
        rng = np.random.default_rng([trial.seed, *map(ord, name)])  # the same unit in all runs
        series = TRUTHS[trial.truth](world(quiet, profile, known), rng)
        added.append((quiet, _means(series, quiet.time)))
    first, one = added[0]
    target = trial.strength * cases.rms(cases.absorbed(first, case.noise(RUN, 0), MODEL))
    factor = target / max(cases.rms(cases.absorbed(first, one, MODEL)), 1e-12)
    runs = [_plus(quiet, factor * values) for quiet, values in added]
    return (*runs, case.quiet(cases.STATIC, 4)), tuple(factor * values for _, values in added)


def _means(series: FloatArray, time_s: FloatArray) -> FloatArray:
    """Means (n,) of the values of every second over the rows about these times, as far as there are seconds."""
    total, half = np.concatenate([[0.0], np.cumsum(series)]), 0.5 * cases.INTERVAL_S
    ends = (np.clip(time_s - half, 0.0, len(series)), np.clip(time_s + half, 0.0, len(series)))
    low, high = (np.interp(end, np.arange(len(total)), total) for end in ends)
    return np.asarray((high - low) / np.maximum(ends[1] - ends[0], 1.0))


def world(quiet: Dataset, profile: str, known: list[float]) -> World:
    """States of the chamber and channels of the unit, every second; `known` are its `constants`."""
    trace = cases.trace(profile)
    seconds = np.arange(trace.seconds, dtype=np.float64) + 0.5

    def channel(name: str) -> FloatArray:
        """Straight between knots whose means over the rows are the recorded values."""
        values = quiet.channels[name]
        good = np.isfinite(values)
        recorded = np.interp(quiet.time, quiet.time[good], values[good])
        knots = recorded.copy()
        for _ in range(30):
            knots += recorded - _means(np.interp(seconds, quiet.time, knots), quiet.time)
        return np.interp(seconds, quiet.time, knots)

    return World(
        seconds, trace.case[1:], trace.air[1:], trace.compressor[1:], trace.heater[1:],
        **{name: channel(name) for name in ("quadrature", "drive", "frequency", "supply")}, constant=constants(known),
    )  # fmt: skip


def _plus(run: Dataset, values: FloatArray) -> Dataset:
    return replace(run, channels={**run.channels, "rate": run.channels["rate"] + values})


def _left(model: Model, first: Dataset, check: Dataset) -> FloatArray:
    """Error (n,) of a model on the check run, without the constant between two days."""
    left = check.bias - fit_model(model, first, covariance="none").predict(check).bias
    return np.asarray(left - np.nanmean(left))


def _errors(
    model: Model, first: Dataset, other: Dataset, truth: FloatArray, its: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors (n,) on another run of the static model, of a model, and of the static model without the truth."""
    oracle = _left(MODEL, _plus(first, -truth), _plus(other, -its))
    return _left(MODEL, first, other), _left(model, first, other), oracle


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def trials(seeds: int, strengths: tuple[float, ...] = (1.0, 3.0), truths: tuple[str, ...] = ()) -> Iterator[Trial]:
    """Seed by seed, so that an interrupted campaign is a smaller campaign."""
    for seed in range(1, seeds + 1):
        for name in truths or TRUTHS:
            yield from (Trial(name, strength, seed) for strength in strengths)


def summary(results: list[tuple[Trial, dict[str, Any]]]) -> dict[str, Any]:
    """Counts by strength and by mechanism."""
    counted: dict[str, Any] = {"n": len(results)}
    for strength in sorted({trial.strength for trial, _ in results}):
        own = [(trial, found) for trial, found in results if trial.strength == strength]
        counted[f"strength {strength:g}"] = {
            "n": len(own),
            "equivalent": sum(found["share"] >= LEAST_SHARE for _, found in own),
            "within": sum(found["ratio"] <= MOST_RATIO for _, found in own),
            "median_ratio": float(np.median([found["ratio"] for _, found in own])),
            "median_before": float(np.median([found["before"] for _, found in own])),
            "most_cpu_s": max(found["cpu_s"] for _, found in own),
            "missed": sorted({trial.truth for trial, found in own if found["share"] < LEAST_SHARE}),
        }
    return counted


def section(path: Path) -> str:
    """Part of docs/hidden_effects.md; empty without results."""
    results = campaigns.known(path, Trial)
    if not results:
        return ""
    rows = []
    for strength, seed in sorted({(trial.strength, trial.seed) for trial, _ in results}):
        own = [found for trial, found in results if (trial.strength, trial.seed) == (strength, seed)]
        shares = (_share(own, key) for key in ("share", "checked", "ratio"))
        medians = (f"{np.median([one[key] for one in own]):.2f}" for key in ("before", "ratio"))
        rows.append((f"{strength:g}", str(seed), str(len(own)), *shares, *medians,
                     f"{np.median([one['cpu_s'] for one in own]):.1f}"))  # fmt: skip
    head = ("strength", "seed", "runs", "right or equivalent first", "within 1.15 of the true model's on the check run",
            "on the third run", "before, median", "with the answer, median", "CPU [s], median")  # fmt: skip
    missed = [
        f"{trial.truth} ({trial.strength:g}, {trial.seed})" for trial, found in results if found["share"] < LEAST_SHARE
    ]
    return (
        f"## Outside the catalogue: {len(TRUTHS)} mechanisms that neither catalogue nor grammar hold\n\n"
        "`python -m benchmarks.outside`. The first answer (a formula, else the effects named) is judged on a run of "
        "a third profile that the bench was not given, beside a run and a check run: right or equivalent, where it "
        "predicts at least 80 % of the variance that the truth adds; errors are over that of the model from which the "
        "truth was taken away. Bar: 90 %.\n"
        f"{table(head, rows)}\n\nNot described (strength, seed): {', '.join(missed) or 'none'}.\n"
    )


def _share(found: list[dict[str, Any]], key: str) -> str:
    good = sum(one[key] >= LEAST_SHARE if key == "share" else one[key] <= MOST_RATIO for one in found)
    low, high = binomtest(good, len(found)).proportion_ci(method="wilson")
    return f"{100 * good / len(found):.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("outside.jsonl"))
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--truths", type=lambda text: tuple(text.split(",")), default=())
    parser.add_argument("--strengths", type=lambda text: tuple(map(float, text.split(","))), default=(1.0, 3.0))
    options = parser.parse_args(arguments)
    found = campaigns.found(trials(options.seeds, options.strengths, options.truths), run_trial, options.out, Trial)
    print(json.dumps(summary(found), indent=1))


if __name__ == "__main__":
    main()
