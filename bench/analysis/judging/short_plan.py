"""The shortest run that calibrates a further unit of a lot well enough.

Equation: of a planned run only the columns X of the lot's model are needed, with its lag and its loop along the planned
temperature; they give the covariance S' of the amplitudes that the run will leave of the lot's S (`prior`). In the
prior's coordinates the trace of S' is the mean variance of the prediction over the lot's whole run: what an I-optimal
design minimises (W. J. Studden, Ann. Stat. 5 (1977) 1411; Bayesian: K. Chaloner, I. Verdinelli, Stat. Sci. 10 (1995)
273). Error and interval are those of simulated runs of the lot's units by the plan (`another_way`).

Candidates go through the whole range of the lot, from its start: turning points in either order, there only or there
and back, with a small loop on the way or none, at shares of the rates that the lot was driven at, with soaks or none;
and at multiples of them, as far as a chamber is known to go. What the model leaves between heating and cooling counts
in proportion to the rate, so that a faster plan is taken only where lag and loop of the model carry it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bench.analysis.diagnosis.plan import ChamberLimits, Move, Plan, kept_rates
from bench.analysis.diagnosis.prediction import ChamberModel, chamber_model, predicted_record
from bench.analysis.judging.prior import Prior
from bench.base import InputError

_SPEEDS = (1.0, 0.75, 0.5, 0.25)
_FASTER = (1.25, 1.5, 2.0, 3.0)
_SOAKS_MIN = (0.0, 10.0, 30.0)
_LAST_MIN = 20.0
"""Rest at the end, so that the unit gets there: a cell that it half went through looks unlike the lot's."""
_LEAST_RECOGNISED = 0.97
_ROW_S = 30.0
_SETTLE_MIN = 10.0


@dataclass(frozen=True)
class ShortPlan:
    """A plan, the error of a calibration by it [deg/h RMS over the lot's whole run], and what it saves."""

    plan: Plan
    limits: ChamberLimits
    error_dph: float
    low_dph: float
    high_dph: float
    """Ends of the 95 % interval."""
    seen: float
    """Share of the lot's cells of temperature that it goes through."""
    whole_s: float
    """Duration of the lot's whole runs."""

    def to_yaml(self, lot: str, units: int) -> str:
        """The profile's file."""
        return self.plan.to_yaml(
            self.limits,
            f"A run for further units of lot {lot}, made from {units} of its units by `bench lot plan`. With the lot, "
            f"it is expected to leave {_told(self)} RMS over the lot's whole run (95 % interval). Calibrate the unit "
            f"with `bench lot complete`.",
        )


def driven_limits(prior: Prior) -> ChamberLimits:
    """Range and rates that the lot was driven at."""
    low, high = float(prior.cells.borders[0]), float(prior.cells.borders[-1])
    rates = kept_rates(prior.records)
    if min(rates) <= 0.0:
        raise InputError("the runs of this lot do not go through temperatures both ways; a plan needs their rates")
    return ChamberLimits(low, high, *rates)


def shortest(prior: Prior, target_dph: float, fastest: tuple[float, float] | None = None) -> ShortPlan:
    """The shortest candidate whose interval ends below the target; InputError where none does.

    `fastest`: heating and cooling [degC/min] of the chamber; None: as fast as the lot was driven.
    """
    driven = driven_limits(prior)
    heating, cooling = driven.heating_degc_per_min, driven.cooling_degc_per_min
    if fastest is not None:
        heating, cooling = max(heating, fastest[0]), max(cooling, fastest[1])
    bounds = replace(driven, heating_degc_per_min=heating, cooling_degc_per_min=cooling)
    chamber = chamber_model(prior.records)
    plans = sorted(candidates(prior, driven, bounds, chamber), key=lambda plan: plan.duration_s)
    best: ShortPlan | None = None
    unlike = 0
    for plan in plans:
        found = judged(prior, plan, bounds, chamber)
        if found.seen < 1.0:
            continue
        if found.high_dph <= target_dph:
            if _recognised(prior, plan, chamber):
                return found
            unlike += 1
        best = found if best is None or found.high_dph < best.high_dph else best
    if best is None:
        raise InputError("no plan goes through all temperatures of this lot")
    if unlike:
        raise InputError(
            f"{unlike} of {len(plans)} plans leave at most {target_dph:g} deg/h (--target), but after each of them "
            f"more than {100.0 * (1.0 - _LEAST_RECOGNISED):.0f} % of the lot's own units would look unlike their lot "
            "and need the whole run; give a larger target, or calibrate a larger lot"
        )
    raise InputError(
        f"none of {len(plans)} plans is sure to leave at most {target_dph:g} deg/h (--target): the best is expected to "
        f"leave {_told(best)} in {best.plan.duration_s / 3600.0:.1f} h; give a larger target, or calibrate a larger lot"
    )


def _recognised(prior: Prior, plan: Plan, chamber: ChamberModel) -> bool:
    """Whether the lot's own units would still look like their lot after this plan."""
    planned = predicted_record(prior.records, plan.setpoint(), _ROW_S, chamber)
    return prior.recognised(planned) >= _LEAST_RECOGNISED


def _told(plan: ShortPlan) -> str:
    return f"{plan.error_dph:.3g} ({plan.low_dph:.3g} to {plan.high_dph:.3g}) deg/h"


def judged(prior: Prior, plan: Plan, limits: ChamberLimits, chamber: ChamberModel) -> ShortPlan:
    """What a plan leaves."""
    planned = predicted_record(prior.records, plan.setpoint(), _ROW_S, chamber)
    error, low, high, seen = prior.foreseen(planned)
    return ShortPlan(plan, limits, error, low, high, seen, prior.duration_s)


def candidates(prior: Prior, driven: ChamberLimits, limits: ChamberLimits, chamber: ChamberModel) -> Iterator[Plan]:
    """All plans that are tried; turning points lie so far out that the unit's thermometer gets to the lot's ends."""
    ways = dict.fromkeys(_rates(driven, limits, speed) for speed in (*_SPEEDS, *_FASTER))
    first_degc = [
        float(one.channel("temperature")[np.isfinite(one.channel("temperature"))][0]) for one in prior.records
    ]
    start = float(round(float(np.median(first_degc)) - chamber.unit.offset_degc))
    ends = (limits.lowest_degc, limits.highest_degc)
    low, high = (float(round(2.0 * (end - chamber.unit.offset_degc)) / 2.0) for end in ends)
    for cold_first, back, loop, rates, soak in product(
        (True, False), ("none", "start", "other"), (False, True), ways, _SOAKS_MIN
    ):
        first, second = (low, high) if cold_first else (high, low)
        plan_name = f"short_{'cold' if cold_first else 'hot'}_first"
        points = [first, second]
        if loop:
            points += [first + 0.5 * (second - first), first + 0.8 * (second - first)]
        points += {"none": [], "start": [start], "other": [first]}[back]
        rests = [soak if point in (low, high) else 0.0 for point in points]
        rests[-1] = max(rests[-1], _LAST_MIN)
        yield Plan(plan_name, "", start, _moves(start, points, rests, rates), _SETTLE_MIN)


def _rates(driven: ChamberLimits, limits: ChamberLimits, speed: float) -> tuple[float, float]:
    """Heating and cooling [degC/min] at so many times the rates that the lot was driven at, within the limits."""
    heating = min(speed * driven.heating_degc_per_min, limits.heating_degc_per_min)
    return heating, min(speed * driven.cooling_degc_per_min, limits.cooling_degc_per_min)


def _moves(
    start: float, points: Sequence[float], rests: Sequence[float], rates: tuple[float, float]
) -> tuple[Move, ...]:
    moves, at = [], start
    for point, rest in zip(points, rests, strict=True):
        moves.append(Move(point, round(rates[0] if point > at else rates[1], 2), rest))
        at = point
    return tuple(moves)
