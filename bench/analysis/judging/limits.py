"""Limits of a kind of unit, and the rule by which a number with its uncertainty passes them.

A number comes with the interval that holds its true value with 95 % probability. The rule is guarded acceptance with a
guard band of the expanded uncertainty (k = 2):

    PASS      the whole interval is within the limits, and the number keeps the marginal band away from them;
    MARGINAL  the number is within the limits, its interval or the marginal band is not;
    FAIL      the number itself is outside;
    INVALID   there is no number, or the run must not be judged by it.

A unit that passes is outside with a probability of at most 2.5 % (normal distribution, one limit).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, Field, field_validator, model_validator

from bench.base import STRICT, Document, PlacedError, finite, load_config
from bench.record import StoredQuantity

COVERAGE = 2.0
"""Coverage factor k of every expanded uncertainty."""
PROBABILITY = 0.95
DECISION_RULE = (
    "Guarded acceptance, guard band = expanded uncertainty (k = 2, 95 %): PASS when the whole coverage interval is "
    "within the limits and the marginal band is kept; MARGINAL when only the value is; FAIL when the value is outside; "
    "INVALID when no admissible value exists. Risk that a PASS is outside a limit: at most 2.5 %."
)

QuantityName = Literal[
    "bias_span_dph",
    "bias_max_dph",
    "residual_rms_dph",
    "residual_peak_dph",
    "residual_over_floor",
    "thermal_hysteresis_dph",
    "residual_hysteresis_dph",
    "noise_floor_dph",
    "angle_random_walk_dprh",
    "bias_instability_dph",
    "rate_random_walk_dphrh",
    "quantisation_deg",
    "rate_ramp_dphh",
    "scale_factor_error_ppm",
    "scale_factor_temperature_ppm_per_degc",
    "scale_factor_nonlinearity_ppm",
    "samples_lost",
    "samples_missing_ppm",
    "longest_gap_s",
    "lowest_temperature_degc",
    "highest_temperature_degc",
    "temperature_hole_degc",
    "temperature_step_error_dph",
    "heating_min",
    "cooling_min",
    "extrapolated_percent",
    "condition",
    "gyro_error_rms_dph",
    "gyro_error_peak_dph",
    "gyro_error_over_floor",
    "accelerometer_error_rms_mps2",
    "accelerometer_error_peak_mps2",
    "accelerometer_error_over_floor",
]

MEANING: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "bias_span_dph": ("deg/h", "bias over temperature, highest less lowest"),
        "bias_max_dph": ("deg/h", "bias over temperature, greatest absolute value"),
        "residual_rms_dph": ("deg/h", "model error on held-out data, RMS"),
        "residual_peak_dph": ("deg/h", "model error on held-out data, peak"),
        "residual_over_floor": ("1", "held-out model error over the noise floor"),
        "thermal_hysteresis_dph": ("deg/h", "thermal hysteresis, loop width"),
        "residual_hysteresis_dph": ("deg/h", "thermal hysteresis left by the model, loop width"),
        "noise_floor_dph": ("deg/h", "noise floor of the averaged data"),
        "angle_random_walk_dprh": ("deg/sqrt(h)", "angle random walk"),
        "bias_instability_dph": ("deg/h", "bias instability"),
        "rate_random_walk_dphrh": ("deg/h/sqrt(h)", "rate random walk"),
        "quantisation_deg": ("deg", "quantisation noise"),
        "rate_ramp_dphh": ("deg/h^2", "rate ramp"),
        "scale_factor_error_ppm": ("ppm", "scale factor error at 25 °C"),
        "scale_factor_temperature_ppm_per_degc": ("ppm/degC", "temperature sensitivity of the scale factor"),
        "scale_factor_nonlinearity_ppm": ("ppm", "scale factor nonlinearity, of the highest rate"),
        "samples_lost": ("1", "samples lost or damaged"),
        "samples_missing_ppm": ("ppm", "samples missing between the first and the last"),
        "longest_gap_s": ("s", "longest gap without a sample"),
        "lowest_temperature_degc": ("degC", "lowest temperature of the unit"),
        "highest_temperature_degc": ("degC", "highest temperature of the unit"),
        "temperature_hole_degc": ("degC", "widest range of temperature without data"),
        "temperature_step_error_dph": ("deg/h", "error from the steps of the temperature sensor"),
        "heating_min": ("min", "time spent heating"),
        "cooling_min": ("min", "time spent cooling"),
        "extrapolated_percent": ("%", "held-out data outside the fitted range"),
        "condition": ("1", "condition of the fit"),
        "gyro_error_rms_dph": ("deg/h", "error of the worst gyro of an inertial unit, RMS"),
        "gyro_error_peak_dph": ("deg/h", "error of the worst gyro of an inertial unit, peak"),
        "gyro_error_over_floor": ("1", "error of the worst gyro of an inertial unit over its floor"),
        "accelerometer_error_rms_mps2": ("m/s^2", "error of the worst accelerometer, RMS"),
        "accelerometer_error_peak_mps2": ("m/s^2", "error of the worst accelerometer, peak"),
        "accelerometer_error_over_floor": ("1", "error of the worst accelerometer over its floor"),
    }
)
"""Unit and meaning of each quantity, in the terms of IEEE 528 and 952."""

_IN_VERIFICATION: Mapping[str, str] = MappingProxyType(
    {
        "residual_rms_dph": "error in the verification run, RMS",
        "residual_peak_dph": "error in the verification run, peak",
        "residual_over_floor": "error in the verification run over the noise floor",
        "extrapolated_percent": "verification data outside the fitted range",
    }
)
"""Meanings where a verification run, not data held out of the fit, gave the number."""


class Verdict(StrEnum):
    """The words, best first."""

    PASS = "PASS"
    MARGINAL = "MARGINAL"
    FAIL = "FAIL"
    INVALID = "INVALID"

    @property
    def within(self) -> bool:
        """Whether the unit may go on."""
        return self in {Verdict.PASS, Verdict.MARGINAL}

    @property
    def judged(self) -> bool:
        """Whether this tells something of the unit: an invalid run neither passes nor rejects it."""
        return self is not Verdict.INVALID


@dataclass(frozen=True)
class Quantity:
    """A number, the interval that holds it with 95 % probability, and how it was found; NaN and a reason without one.

    A count has no uncertainty: its interval is itself.
    """

    name: str
    value: float = np.nan
    low: float = np.nan
    high: float = np.nan
    reason: str = ""
    in_verification: bool = False
    """An independent run gave it, not data held out of the fit."""

    @classmethod
    def expanded(cls, name: str, value: float, standard_uncertainty: float) -> Quantity:
        """A number with a symmetric interval, k = 2."""
        return cls(name, value, value - COVERAGE * standard_uncertainty, value + COVERAGE * standard_uncertainty)

    @classmethod
    def positive(cls, name: str, value: float, standard_uncertainty: float) -> Quantity:
        """An absolute value: its interval ends at zero."""
        symmetric = cls.expanded(name, value, standard_uncertainty)
        return cls(name, value, max(0.0, symmetric.low), symmetric.high)

    @classmethod
    def exact(cls, name: str, value: float) -> Quantity:
        """A number without uncertainty."""
        return cls(name, value, value, value)

    @classmethod
    def of(cls, stored: StoredQuantity) -> Quantity:
        """The quantity that a record keeps."""
        value, low, high = (np.nan if end is None else end for end in (stored.value, stored.low, stored.high))
        return cls(stored.name, value, low, high, stored.reason)

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return MEANING[self.name][0]

    @property
    def meaning(self) -> str:
        """What it is, in words."""
        usual = MEANING[self.name][1]
        return _IN_VERIFICATION.get(self.name, usual) if self.in_verification else usual

    def to_json(self) -> dict[str, Any]:
        """All of it; null where there is no number."""
        numbers = {"value": self.value, "low": self.low, "high": self.high}
        known = {key: finite(value) for key, value in numbers.items()}
        return {"name": self.name, "unit": self.unit, "meaning": self.meaning, **known, "reason": self.reason}


class Limit(BaseModel):
    """One limit of one quantity."""

    model_config = STRICT

    quantity: QuantityName
    """What is limited; its unit is the end of its name."""
    unit: str
    """Unit of the numbers below, to be read by people and checked against the quantity's own."""
    lower: float | None = None
    """Least allowed value."""
    upper: float | None = None
    """Greatest allowed value."""
    marginal: float = Field(default=0.0, ge=0)
    """Band inside the limits in which a unit is MARGINAL."""
    required: bool = True
    """Without the number the run is INVALID; false: only where the run measures it."""
    reason: str
    """Why this limit: a requirement, a data sheet, experience."""

    @field_validator("unit")
    @classmethod
    def _known_unit(cls, unit: str, info: Any) -> str:
        own = MEANING.get(info.data.get("quantity", ""), (unit, ""))[0]
        if unit != own:
            raise ValueError(f"unit is '{unit}', {info.data['quantity']} is in '{own}'")
        return unit

    @model_validator(mode="after")
    def _some_room(self) -> Limit:
        if self.lower is None and self.upper is None:
            raise ValueError(f"limit of {self.quantity} has neither lower nor upper: give at least one")
        room = self.room
        if not room > 0.0:
            raise ValueError(f"limit of {self.quantity}: lower {self.lower:g} is not below upper {self.upper:g}")
        if not 2.0 * self.marginal < room:
            raise ValueError(f"limit of {self.quantity}: marginal bands of {self.marginal:g} leave nothing to pass")
        return self

    @property
    def room(self) -> float:
        """Upper less lower."""
        return (np.inf if self.upper is None else self.upper) - (-np.inf if self.lower is None else self.lower)


class Limits(BaseModel):
    """Limits of a kind of unit."""

    model_config = STRICT

    name: str
    """Name of the specification, as it stands on the certificate."""
    description: str = ""
    """What it is for."""
    limits: tuple[Limit, ...] = Field(min_length=1)
    """The limits."""

    @property
    def quantities(self) -> frozenset[str]:
        """What is limited."""
        return frozenset(limit.quantity for limit in self.limits)

    @model_validator(mode="after")
    def _once_each(self) -> Limits:
        names = [limit.quantity for limit in self.limits]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise PlacedError(f"{name} is limited twice; give lower and upper in one entry", ("limits", i))
        return self


@dataclass(frozen=True)
class Result:
    """A quantity against its limit; `verdict` is None where it was neither measured nor required."""

    limit: Limit
    quantity: Quantity
    verdict: Verdict | None

    def to_json(self) -> dict[str, Any]:
        """Quantity, limit and word."""
        limit = {key: getattr(self.limit, key) for key in ("lower", "upper", "marginal", "required")}
        word = None if self.verdict is None else self.verdict.value
        return {**self.quantity.to_json(), **limit, "why": self.limit.reason, "verdict": word}


@dataclass(frozen=True)
class Judgement:
    """All results of a run; `refusals` say why it must not be judged at all."""

    limits: Limits
    results: tuple[Result, ...]
    refusals: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The worst word; INVALID where the run must not be judged."""
        if self.refusals:
            return Verdict.INVALID
        words = [result.verdict for result in self.results if result.verdict is not None]
        return max(words, key=list(Verdict).index, default=Verdict.INVALID)

    def to_json(self) -> dict[str, Any]:
        """What stands under `limits` in the JSON of `bench run` and in limits.json."""
        return {
            "name": self.limits.name,
            "verdict": self.verdict.value,
            "decision_rule": DECISION_RULE,
            "coverage_factor": COVERAGE,
            "coverage_probability": PROBABILITY,
            "refusals": list(self.refusals),
            "results": [result.to_json() for result in self.results],
        }


def load_limits(source: Path | str | Document) -> Limits:
    """Limits from a file, or from one that was read; InputError with file and line where something is wrong."""
    return load_config(source, Limits)


def judge_limits(limits: Limits, quantities: Iterable[Quantity], refusals: Sequence[str] = ()) -> Judgement:
    """Every limit applied to its quantity."""
    known = {quantity.name: quantity for quantity in quantities}
    results = []
    for limit in limits.limits:
        quantity = known.get(limit.quantity, Quantity(limit.quantity, reason="not measured by this run"))
        results.append(Result(limit, quantity, _word(limit, quantity)))
    return Judgement(limits, tuple(results), tuple(refusals))


def _word(limit: Limit, quantity: Quantity) -> Verdict | None:
    if not np.isfinite(quantity.value):
        return Verdict.INVALID if limit.required else None
    lower = -np.inf if limit.lower is None else limit.lower
    upper = np.inf if limit.upper is None else limit.upper
    if not lower <= quantity.value <= upper:
        return Verdict.FAIL
    # An unknown end proves nothing. The number must keep the marginal band, and its interval the limits.
    low, high = (np.nan_to_num(end, nan=sign * np.inf) for end, sign in ((quantity.low, -1), (quantity.high, 1)))
    sure = lower <= low and high <= upper
    clear = lower + limit.marginal <= quantity.value <= upper - limit.marginal
    return Verdict.PASS if sure and clear else Verdict.MARGINAL
