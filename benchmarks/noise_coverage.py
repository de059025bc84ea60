"""How often do the stated 95 % intervals of noise and noise floor hold the truth?

    python -m benchmarks.noise_coverage --runs 400 --seed 1 --out coverage.jsonl

Every run is noise made from numpy alone: white samples at 500 Hz, flicker from lines of its spectrum, a random walk
from its steps, without a line of the bench's own noise model. It is recorded in 1 s means with the scatter of their
samples, as a run that passes through four soaks with thermal tails, or as one that has an isothermal run beside it.
The bench then reads its noise as every command does. Results are appended to the file as they come; what stands there
already is not run again. Prints one JSON object: of each case and quantity how many of n intervals hold the truth, and
the 95 % interval of that share; exit code 1 where it lies outside 93 to 97 %.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.stats import binomtest

from bench.analysis.noise.floor import noise_floor
from bench.base.channels import FloatArray
from bench.record.dataset import Dataset, Segment
from benchmarks import campaigns

SAMPLES_HZ = 500
MEANS_S = 30.0
HOUR_S = 3600.0
Coefficients = tuple[float, float, float]
NOISES: dict[str, Coefficients] = {
    "white": (0.01, 0.0, 0.0),
    "shipped": (0.01, 0.03, 0.03),
    "walking": (0.02, 0.05, 0.3),
    "filtered": (0.01, 0.0, 0.03),
}
"""N [deg/sqrt(h)], B [deg/h], K [deg/h/sqrt(h)]."""
FILTERS_S = {"filtered": 20.0}
"""Time constant of the filter that the white noise passes; samples within a row then say nothing of N."""
_FINE = 10  # steps of a filter in each row
QUANTITIES = ("white", "flicker", "walk", "floor")
BAR = (0.93, 0.97)
_SOAKS_S = (900, 900, 1200, 900)
_RAMP_S = 4500
_STATIC_S = 6 * 3600
_TAIL_DPH, _TAIL_S = 0.05, 300.0


@dataclass(frozen=True)
class Case:
    """One simulated run."""

    noise: str
    static: bool
    number: int


def cases(runs: int, noises: Sequence[str] = ()) -> Iterator[Case]:
    """All of them, run by run, so that a campaign cut short is a smaller campaign."""
    for number in range(runs):
        for name in noises or NOISES:
            yield from (Case(name, static, number) for static in (False, True))


def run_case(case: Case, seed: int) -> dict[str, Any]:
    """Of each quantity the truth, the value, the interval."""
    rng = np.random.default_rng([seed, case.number, case.static, zlib.crc32(case.noise.encode())])
    noise, filter_s = NOISES[case.noise], FILTERS_S.get(case.noise, 0.0)
    run = recorded(noise, rng, _SOAKS_S, _RAMP_S, filter_s)
    still = recorded(noise, rng, (_STATIC_S,), 0, filter_s) if case.static else None
    found = noise_floor([run], MEANS_S, still)
    if found.noise is None:
        raise RuntimeError(found.reason)
    truth = dict(zip(QUANTITIES, (*noise, true_floor(noise, len(run), filter_s)), strict=True))
    values = {name: getattr(found.noise, name) for name in QUANTITIES[:3]} | {"floor": found.floor_dph}
    intervals = dict(found.noise.intervals) | {"floor": found.interval_dph}
    return {name: [truth[name], values[name], *intervals[name]] for name in QUANTITIES}


def recorded(
    noise: Coefficients, rng: np.random.Generator, soaks_s: Sequence[int], ramp_s: int, filter_s: float = 0.0
) -> Dataset:
    """A run of ramps and soaks in 1 s means, in which nothing but noise and the tails of the soaks is left."""
    kinds = [(kind, length) for soak in soaks_s for kind, length in (("ramp", ramp_s), ("soak", soak)) if length]
    starts = np.concatenate([[0], np.cumsum([length for _, length in kinds])])
    rows = int(starts[-1])
    temperature, tail, segment = np.zeros(rows), np.zeros(rows), np.zeros(rows, dtype=np.int64)
    segments, at = [], 25.0
    for index, (kind, length) in enumerate(kinds):
        here = slice(int(starts[index]), int(starts[index + 1]))
        segment[here] = index
        if kind == "ramp":
            temperature[here] = at + np.arange(length) / 60.0
            at += length / 60.0
        else:
            temperature[here] = at
            tail[here] = _TAIL_DPH * np.exp(-np.arange(length) / _TAIL_S)
        segments.append(
            Segment(index, f"{kind} {index}", kind, here.start, here.stop, "constant" if kind == "soak" else "heating")
        )
    rate, scatter = made(noise, rng, rows, filter_s)
    variances = {} if filter_s else {"rate": scatter}
    channels = {"rate": rate + tail, "temperature": temperature}
    return Dataset(
        "simulated", np.arange(rows, dtype=np.float64) + 0.5, channels, segment, tuple(segments),
        counts={"rate": np.full(rows, float(SAMPLES_HZ))}, variances=variances,
    )  # fmt: skip


def made(
    noise: Coefficients, rng: np.random.Generator, rows: int, filter_s: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Means over 1 s and the variance of white samples behind each, (rows,) each."""
    n, b, k = noise
    white = n * 60.0 * (filtered(rows, rng, filter_s) if filter_s else rng.standard_normal(rows))
    scatter = (n * 60.0) ** 2 * SAMPLES_HZ * rng.chisquare(SAMPLES_HZ - 1, rows) / (SAMPLES_HZ - 1)
    walk = k / 60.0 * np.cumsum(rng.standard_normal(rows))
    return white + b * flicker(rows, rng) + walk, scatter


def filtered(rows: int, rng: np.random.Generator, filter_s: float) -> FloatArray:
    """Means over 1 s (rows,) of white noise of one behind a filter of the first order, settled."""
    before = round(10.0 * filter_s) * _FINE
    kept = float(np.exp(-1.0 / (_FINE * filter_s)))
    fine = rng.standard_normal(before + rows * _FINE) * np.sqrt(_FINE)
    return np.asarray(lfilter([1.0 - kept], [1.0, -kept], fine)[before:].reshape(rows, _FINE).mean(axis=1))


def flicker(rows: int, rng: np.random.Generator) -> FloatArray:
    """Means over 1 s (rows,) of noise with the two-sided density 1 / (2 pi f) up to 0.5 Hz."""
    length = 1 << int(np.ceil(np.log2(8 * rows)))
    frequency = np.fft.rfftfreq(length, 1.0)
    density = np.zeros_like(frequency)
    density[1:] = np.sinc(frequency[1:]) ** 2 / (2.0 * np.pi * frequency[1:])
    lines = (rng.standard_normal(len(density)) + 1j * rng.standard_normal(len(density))) * np.sqrt(density * length / 2)
    return np.asarray(np.fft.irfft(lines, length)[:rows])


def true_floor(noise: Coefficients, rows: int, filter_s: float = 0.0) -> float:
    """Expected RMS about their mean of the 30 s means of such a run [deg/h].

    White and walk from the variances of their steps, flicker and filtered noise as their means over many draws.
    """
    n, b, k = noise
    means = round((rows - 1) / MEANS_S)
    hours = MEANS_S / HOUR_S
    steps = np.arange(1, means + 1) / means
    walked = k**2 * hours * float(np.sum((1.0 - steps) * steps))
    white = n**2 * 3600.0 * _filtered_square(means, filter_s) if filter_s else n**2 / hours * (1 - 1 / means)
    return float(np.sqrt(white + walked + b**2 * _flicker_square(means)))


@lru_cache(maxsize=4)
def _flicker_square(means: int) -> float:
    rng = np.random.default_rng(5)
    draws = [flicker(means * int(MEANS_S), rng).reshape(means, -1).mean(axis=1) for _ in range(400)]
    return float(np.mean(np.var(draws, axis=1)))


@lru_cache(maxsize=4)
def _filtered_square(means: int, filter_s: float) -> float:
    rng = np.random.default_rng(6)
    draws = [filtered(means * int(MEANS_S), rng, filter_s).reshape(means, -1).mean(axis=1) for _ in range(60)]
    return float(np.mean(np.var(draws, axis=1)))


def campaign(todo: Sequence[Case], seed: int, out: Path) -> list[tuple[Case, dict[str, Any]]]:
    """Run what is not in the file yet, and append it; all results that the file then holds."""
    return campaigns.found(todo, lambda case: run_case(case, seed), out, Case)


def table(results: Sequence[tuple[Case, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Of each noise, with and without a static run, and each quantity: how many intervals hold the truth."""
    rows = []
    for name, static in sorted({(case.noise, case.static) for case, _ in results}):
        mine = [found for case, found in results if (case.noise, case.static) == (name, static)]
        for quantity in QUANTITIES:
            held = sum(low <= truth <= high for truth, _, low, high in (found[quantity] for found in mine))
            ends = binomtest(held, len(mine)).proportion_ci(0.95, method="exact")
            rows.append({
                "noise": name, "static": static, "quantity": quantity, "n": len(mine), "held": held,
                "share": round(held / len(mine), 4), "interval": [round(ends.low, 4), round(ends.high, 4)],
                "outside": bool(ends.high < BAR[0] or ends.low > BAR[1]),
                "median_value": float(np.median([found[quantity][1] for found in mine])),
                "median_high": float(np.median([found[quantity][3] for found in mine])),
            })  # fmt: skip
    return rows


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("noise_coverage.jsonl"))
    parser.add_argument(
        "--noise", action="append", default=[], choices=sorted(NOISES), help="only this one; repeatable"
    )
    arguments = parser.parse_args()
    rows = table(campaign(list(cases(arguments.runs, arguments.noise)), arguments.seed, arguments.out))
    print(json.dumps({"seed": arguments.seed, "table": rows}, indent=1))
    return 1 if any(row["outside"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
