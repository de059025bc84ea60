"""A station of many that leaves its level: how often it is found, how soon, and how often nothing is called a shift.

    python -m benchmarks.station_shifts [SEEDS]

Fleets of lots drawn alike (spread 2 between, 1 within), of 50 stations that differ by constants; the values are normal,
with heavy tails (Student's t with three degrees of freedom) or skewed (lognormal). One quantity. At last the error of
the levels of the first, the middle and the last lots, beside their own trend, where every station drifts.
"""

from __future__ import annotations

import sys

import numpy as np
import scipy

from bench.archive.fleet.drift import DAY_S, Levelled, drifts
from bench.archive.fleet.shifts import Shift, charts_for, shifts
from bench.base import FloatArray

STATIONS, PER_LOT, ODD = 50, 200, 7
SHAPES = ("normal", "heavy tails", "skewed")


def drawn(random: np.random.Generator, shape: str, units: int) -> FloatArray:
    """Values of spread about 1 [any unit]."""
    if shape == "normal":
        return random.normal(size=units)
    values: FloatArray = random.standard_t(3, units) if shape == "heavy tails" else random.lognormal(0.0, 1.0, units)
    return values


def fleet(seed: int, shape: str, shift: float, *, units: int, mixed: bool) -> tuple[Levelled, int]:
    """A fleet over 100 days, and the row from which on station 7 is off by `shift`.

    `mixed`: the units of a lot go to all stations; else each lot goes to one.
    """
    random = np.random.default_rng(seed)
    days, lot = np.sort(random.uniform(0.0, 100.0, units)), np.arange(units) // PER_LOT
    station = random.integers(0, STATIONS, units) if mixed else random.integers(0, STATIONS, lot[-1] + 1)[lot]
    values = drawn(random, shape, units) + random.normal(0.0, 2.0, lot[-1] + 1)[lot]
    values += random.normal(0.0, 0.5, STATIONS)[station]
    begin = int(random.uniform(0.4, 0.8) * units)
    values[begin:] += np.where(station[begin:] == ODD, shift, 0.0)
    levelled = Levelled.of(values, days * DAY_S, [f"S{i}" for i in station], [f"L{i:03d}" for i in lot])
    if levelled is None:
        raise RuntimeError("a fleet of this size is never too small")
    return levelled, begin


def found(levelled: Levelled) -> list[Shift]:
    """As `bench fleet` finds them."""
    return list(shifts(levelled, "q", charts_for(levelled.values.size)))


def level_errors(seed: int, units: int = 20_000) -> FloatArray:
    """Found less true level of each lot beside the trend of all lots (lots,), where every station drifts."""
    random = np.random.default_rng(seed)
    days, lot = np.sort(random.uniform(0.0, 100.0, units)), np.arange(units) // PER_LOT
    station, level = random.integers(0, STATIONS, units), random.normal(0.0, 2.0, lot[-1] + 1)
    values = random.normal(size=units) + level[lot] + random.normal(0.0, 0.5, STATIONS)[station]
    values += random.normal(0.0, 0.02, STATIONS)[station] * (days - 50.0)
    names = [f"L{i:03d}" for i in range(level.size)]
    levelled = Levelled.of(values, days * DAY_S, [f"S{i}" for i in station], [names[i] for i in lot])
    if levelled is None:
        raise RuntimeError("a fleet of this size is never too small")
    seen = {drift.place: drift.change for drift in drifts(levelled, "q") if drift.kind == "lot"}
    when = np.bincount(lot, days) / PER_LOT
    trend = np.polyval(np.polyfit(when, level, 1), when)
    return np.array([seen[name] for name in names]) - (level - trend)


def _share(hits: int, n: int) -> str:
    low, high = scipy.stats.binomtest(hits, n).proportion_ci(0.95)
    return f"{hits} of {n} ({100 * low:.1f} to {100 * high:.1f} %)"


def main(seeds: int = 100) -> None:
    for units in (2_000, 20_000):
        for shape in SHAPES:
            for mixed in (True, False):
                alarms = sum(bool(found(fleet(seed, shape, 0.0, units=units, mixed=mixed)[0])) for seed in range(seeds))
                how = "lots over all stations" if mixed else "each lot at one station"
                print(f"{units} units, {shape}, {how}: fleets with a false alarm {_share(alarms, seeds)}", flush=True)
    for shift in (0.5, 1.0, 2.0):
        right, others, late = 0, 0, []
        for seed in range(seeds):
            levelled, begin = fleet(seed, "normal", shift, units=20_000, mixed=True)
            places = {one.place: one for one in found(levelled)}
            others += bool(set(places) - {f"S{ODD}"})
            if one := places.get(f"S{ODD}"):
                right += one.row >= begin
                own = levelled.in_order(ODD)
                late.append(int(np.sum((own >= begin) & (own <= one.row))))
        print(f"{shift} sigma at one of {STATIONS} stations: found {_share(right, seeds)}, after "
              f"{np.median(late):.0f} of its units (median); another station besides: {_share(others, seeds)}",
              flush=True)  # fmt: skip
    errors = np.array([level_errors(seed) for seed in range(min(seeds, 30))])
    for name, some in (
        ("first three", errors[:, :3]),
        ("middle ten", errors[:, 45:55]),
        ("last three", errors[:, -3:]),
    ):
        print(f"error of the level of the {name} lots of 100: {np.sqrt(np.mean(some**2)):.3f}", flush=True)


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
