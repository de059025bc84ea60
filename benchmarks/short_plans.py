"""`bench lot plan` on units that nobody has seen: the promised error against the reached one, and the hours saved.

    python -m benchmarks.short_plans [UNITS] [LOT] [SEEDS] [TARGET] [HEATING COOLING]

Units of `benchmarks.fewer_hours` (lag, loop, ageing, noise that walks; their truth shares no equation with the model).
The lot's units go through the whole ramp; the plan is made from them; further units go through the plan, and then, as a
judge, through the whole ramp, while their ageing and their noise go on. The error is over that ramp. Refused units are
those that look unlike their lot, as `bench lot complete` refuses them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from bench.acquisition import profile_from_text
from bench.analysis import Prior, ShortPlan, load_model, shortest
from benchmarks.fewer_hours import MODEL, ramp_degc, ramped, rms, share, through
from benchmarks.lots import STEP_S, UNLIKE, Truth, behind, member


@dataclass(frozen=True)
class Reached:
    """Of one unit: what was stated [deg/h RMS], what was reached, the same without slow noise, and its likeness."""

    low_dph: float
    high_dph: float
    error_dph: float
    still_dph: float
    like: bool


def reached(prior: Prior, plan: ShortPlan, truth: Truth, seed: int) -> Reached:
    """One unit, calibrated by the plan's run and its lot."""
    path = plan.plan.setpoint()
    rows = path.size // round(STEP_S)
    planned = behind(path[: rows * round(STEP_S)].reshape(rows, -1).mean(axis=1), 180.0)
    short, ramp = through(truth, "X", seed, planned, ramp_degc())
    found = prior.expected(short.record)
    curve = prior.curve(ramp.record, found.amplitudes)
    likeness = prior.like(short.record)
    errors = [rms(curve - one) for one in (ramp.slow, ramp.still)]
    return Reached(found.low_dph, found.high_dph, *errors, likeness is not None and likeness.like)


def prior_of(lot: int, seed: int) -> tuple[Prior, np.random.Generator]:
    """A lot whose units went through the whole ramp."""
    random = np.random.default_rng(seed)
    known = [ramped(member(random), f"L{i:03d}", 100_000 * seed + i).record for i in range(lot)]
    return Prior.of(load_model(MODEL), known), random


def main(units: int = 60, lot: int = 40, seeds: int = 3, target_dph: float = 0.35, *fastest: float) -> None:
    """`fastest`: heating and cooling of a chamber [degC/min] that is faster than the lot was driven."""
    everyone, others = [], []
    for seed in range(1, seeds + 1):
        prior, random = prior_of(lot, seed)
        plan = shortest(prior, target_dph, (fastest[0], fastest[1]) if fastest else None)
        hours = profile_from_text(plan.to_yaml("L", lot)).duration_s / 3600.0
        print(f"lot {seed}: {lot} units, {hours:.2f} h of {plan.whole_s / 3600:.2f} h, promised {plan.error_dph:.3f} "
              f"({plan.low_dph:.3f} to {plan.high_dph:.3f})", flush=True)  # fmt: skip
        print(f"  {[(one.to_degc, one.rate_degc_per_min, one.rest_min) for one in plan.plan.moves]}")
        begin = 100_000 * seed
        found = [reached(prior, plan, member(random), begin + 1000 + i) for i in range(units)]
        bad = [reached(prior, plan, change(member(random), random), begin + 5000 + 100 * k + i)
               for k, change in enumerate(UNLIKE.values()) for i in range(max(1, units // 10))]  # fmt: skip
        everyone, others = everyone + found, others + bad
        errors = np.array([one.error_dph for one in found])
        still = np.median([one.still_dph for one in found])
        print(f"  reached: median {np.median(errors):.3f}, 95 % below {np.quantile(errors, 0.95):.3f}, worst "
              f"{errors.max():.3f}; median without slow noise {still:.3f}", flush=True)  # fmt: skip
    for words, some in (("all", everyone), ("not refused", [one for one in everyone if one.like])):
        n = len(some)
        print(f"{words}: within {target_dph}: {share(sum(one.error_dph <= target_dph for one in some), n)}")
        print(f"{words}: in the stated interval: "
              f"{share(sum(one.low_dph <= one.error_dph <= one.high_dph for one in some), n)}; above it "
              f"{share(sum(one.error_dph > one.high_dph for one in some), n)}")  # fmt: skip
    print(f"units of the lot refused as unlike: {share(sum(not one.like for one in everyone), len(everyone))}")
    print(f"unlike units refused: {share(sum(not one.like for one in others), len(others))}")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:4]), *(float(word) for word in sys.argv[4:7]))
