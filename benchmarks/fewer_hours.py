"""Chamber hours that a lot's earlier units save: stated intervals, worst unit, units unlike the lot.

    python -m benchmarks.fewer_hours [UNITS] [LOT] [LOTS] [FIRST]

Units of `benchmarks.lots` (their truth shares no equation with the model), with ageing and noise that walks, go through
`ramp_-40_85`. The lot's first units go the whole way. Each further unit ends at the first look (every ten minutes) at
which it has been through every temperature of the lot, is like it, and is expected to have less than the limit; every
tenth goes the whole way as an audit (every twentieth: said beside it). FIRST is the seed of the first of LOTS lots.

The error that is stated is that over the whole ramp, with all that is slow in it. By that the whole ramp's own fit is
judged by rows that it was made from: it follows the walk of this ramp, which no calibration keeps. What counts in use
is the next ramp, which begins an hour after the run ended, while ageing and walk go on: both are counted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from bench.acquisition import load_profile
from bench.analysis import Prior, load_model
from bench.analysis.fit.fitting import fit_model
from bench.base import FloatArray, library
from bench.record import Dataset
from benchmarks.lots import STEP_S, UNLIKE, Truth, behind, member, still

MODEL = "spline_lag_loop"
LIMIT_DPH = 0.2
LIMITS_DPH = (0.13, 0.15, 0.17, LIMIT_DPH)
LOOK_S = 600.0
AUDITS = (10, 20)
"""Every so many units, one goes the whole way: the default of `audit_every`, and half as many."""
_REST_S = 3600.0


@cache
def ramp_degc() -> FloatArray:
    """Temperature of the unit's case [degC] throughout the whole ramp."""
    profile = load_profile(library() / "ramp_-40_85.yaml")
    return behind(profile.setpoint(np.arange(0.5 * STEP_S, profile.duration_s, STEP_S)), 180.0)


@dataclass(frozen=True, eq=False)
class Run:
    """30 s means of a run, and its bias (n,) [deg/h] without white noise, and without any."""

    record: Dataset
    slow: FloatArray
    still: FloatArray


def through(truth: Truth, name: str, seed: int, *ways: FloatArray) -> list[Run]:
    """A unit that goes through temperatures of its case [degC], one way after the other, while it ages."""
    random = np.random.default_rng(seed)
    degc = np.concatenate(ways)
    bias = still(truth, degc)
    ageing = random.normal(0.0, 0.05) * np.log1p(STEP_S * (np.arange(degc.size) + 0.5) / 3600.0)
    slow = bias + ageing + np.cumsum(random.normal(0.0, 0.004, degc.size))
    shown = behind(degc, truth.lag_s) + random.normal(0.0, 0.01, degc.size)
    rate = slow + random.normal(0.0, 0.08, degc.size)
    runs, begin = list[Run](), 0
    for way in ways:
        rows = slice(begin, begin + way.size)
        time = STEP_S * (np.arange(way.size) + 0.5)
        segment = np.zeros(way.size, dtype=np.int64)
        channels = {"rate": rate[rows], "temperature": shown[rows]}
        record = Dataset(name, time, channels, segment, interval_s=STEP_S, unit=name)
        runs.append(Run(record, slow[rows], bias[rows]))
        begin = rows.stop
    return runs


def ramped(truth: Truth, name: str, seed: int) -> Run:
    """A unit that goes through the whole ramp."""
    return through(truth, name, seed, ramp_degc())[0]


def _after(truth: Truth, seed: int, rows: int) -> Run:
    """The whole ramp again, an hour after a first one that ended with so many rows."""
    ramp = ramp_degc()
    back = np.interp(np.arange(0.0, _REST_S, STEP_S), [0.0, 0.75 * _REST_S], [ramp[rows - 1], ramp[0]])
    return through(truth, "next", seed, ramp[:rows], back, ramp)[-1]


@dataclass(frozen=True)
class Ended:
    """How a unit ended: share of the ramp, stated interval and error [deg/h RMS], and that of the whole ramp's fit."""

    share: float
    low_dph: float
    high_dph: float
    error_dph: float
    whole_dph: float
    next_dph: float
    """Error in the next ramp …"""
    whole_next_dph: float
    """… and that of the whole ramp's fit in the ramp after it."""
    like: bool


def conduct(prior: Prior, truth: Truth, seed: int, limits_dph: Sequence[float]) -> list[Ended]:
    """One unit through the ramp, looked at every ten minutes: how it ends by each limit."""
    run = ramped(truth, "U", seed)
    whole, end = run.record, run.record.time[-1]
    own = fit_model(load_model(MODEL), whole, covariance="none", weights="count")
    after = _after(truth, seed, len(whole))
    left, later = rms(own.predict(whole).bias - run.slow), rms(own.predict(after.record).bias - after.slow)
    ends: dict[float, Ended] = {}
    for at in np.append(np.arange(LOOK_S, end, LOOK_S), end + 1.0):
        so_far = whole.select(whole.time < at)
        found = prior.expected(so_far)
        met = [one for one in limits_dph if one not in ends and found.seen >= 1.0 and found.high_dph <= one]
        told = prior.like(so_far) if met and at < end else None
        if at > end:
            met = [one for one in limits_dph if one not in ends]
        elif told is None or not told.like:
            ends |= {
                one: Ended(1.0, found.low_dph, found.high_dph, left, left, later, later, like=False) for one in met
            }
            continue
        error = rms(prior.curve(whole, found.amplitudes) - run.slow)
        judge = _after(truth, seed, len(so_far))
        used = rms(prior.curve(judge.record, found.amplitudes) - judge.slow)
        share = min(at / end, 1.0)
        ends |= {one: Ended(share, found.low_dph, found.high_dph, error, left, used, later, like=True) for one in met}
        if len(ends) == len(limits_dph):
            break
    return [ends[one] for one in limits_dph]


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def share(hits: int, n: int) -> str:
    """A share with its 95 % interval (Clopper-Pearson)."""
    low, high = scipy.stats.binomtest(hits, n).proportion_ci(0.95)
    return f"{100 * hits / n:.1f} % of {n} (95 %: {100 * low:.1f} to {100 * high:.1f} %)"


def campaign(units: int, lot: int, seed: int) -> tuple[list[list[Ended]], list[Ended]]:
    """Units of the lot, by each limit, and units of each kind that is unlike it."""
    random = np.random.default_rng(seed)
    begin = 100_000 * seed
    known = [ramped(member(random), f"L{i:03d}", begin + i).record for i in range(lot)]
    prior = Prior.of(load_model(MODEL), known)
    good = [conduct(prior, member(random), begin + 1000 + i, LIMITS_DPH) for i in range(units)]
    changes: list[Callable[[Truth, np.random.Generator], Truth]] = list(UNLIKE.values())
    each = max(1, units // len(changes))
    bad = [
        conduct(prior, change(member(random), random), begin + 50_000 + 1000 * k + i, (LIMIT_DPH,))[0]
        for k, change in enumerate(changes)
        for i in range(each)
    ]
    return good, bad


def saved(ended: Sequence[Ended], lot: int = 0, audit: int = AUDITS[0]) -> float:
    """Share of the hours that these units save [%], with so many before them that went the whole way."""
    hours = [1.0 if i % audit == audit - 1 else one.share for i, one in enumerate(ended)]
    return 100.0 * (1.0 - (sum(hours) + lot) / (len(hours) + lot))


def worst(ended: Sequence[Ended]) -> str:
    """The worst unit and that by the whole ramp, over this ramp and over the next one; 95 % of them, too."""
    text = []
    for name, own, whole in (
        ("this ramp", [one.error_dph for one in ended], [one.whole_dph for one in ended]),
        ("next ramp", [one.next_dph for one in ended], [one.whole_next_dph for one in ended]),
    ):
        figures = [
            f"{what} {of(own):.3f}, whole {of(whole):.3f} ({of(own) / of(whole):.2f} times)"
            for what, of in (
                ("worst", np.max),
                ("95 % below", lambda values: np.quantile(values, 0.95)),
                ("median", np.median),
            )
        ]
        text.append(f"    {name}: {'; '.join(figures)}")
    return "\n".join(text)


def main(units: int = 60, lot: int = 40, lots: int = 8, first: int = 1) -> None:
    everyone: list[list[list[Ended]]] = []
    others: list[Ended] = []
    for seed in range(first, first + lots):
        good, bad = campaign(units, lot, seed)
        everyone.append(good)
        others += bad
        ended = [one[LIMITS_DPH.index(LIMIT_DPH)] for one in good]
        print(f"lot {seed}: {lot} units before, {units} units, {LIMIT_DPH} deg/h")
        for audit in AUDITS:
            print(f"    audits every {audit}th: {saved(ended, 0, audit):.1f} % of the hours saved "
                  f"({saved(ended, lot, audit):.1f} % with the first {lot})")  # fmt: skip
        print(worst(ended), flush=True)
    for at, limit in enumerate(LIMITS_DPH):
        by_lot = [[one[at] for one in good] for good in everyone]
        ended = [one for own in by_lot for one in own]
        early = [one for one in ended if one.like]
        held = sum(one.low_dph <= one.error_dph <= one.high_dph for one in early)
        hours = [saved(own) for own in by_lot]
        print(
            f"limit {limit} deg/h: saved {np.mean(hours):.1f} % ({min(hours):.1f} to {max(hours):.1f})\n{worst(ended)}"
        )
        print(f"    stated interval holds: {share(held, len(early))}")
        print(f"    within the limit: {share(sum(one.error_dph <= limit for one in ended), len(ended))}")
        print(f"    units of the lot taken for unlike: {share(len(ended) - len(early), len(ended))}")
    each = len(others) // lots // len(UNLIKE)
    for k, kind in enumerate(UNLIKE):
        own = [one for i, one in enumerate(others) if (i // each) % len(UNLIKE) == k]
        print(f"  {kind}: whole ramp for {share(sum(one.share == 1.0 for one in own), len(own))}")
    print(f"unlike units that got the whole ramp: {share(sum(one.share == 1.0 for one in others), len(others))}")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
