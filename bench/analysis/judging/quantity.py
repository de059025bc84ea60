"""A number that a run is judged by: its name, its unit and meaning, and the interval that holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from bench.base import finite
from bench.record import StoredQuantity

COVERAGE = 2.0
"""Coverage factor k of every expanded uncertainty."""

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

OF_DATA: frozenset[str] = frozenset(
    {"samples_lost", "samples_missing_ppm", "longest_gap_s", "temperature_hole_degc", "condition", "heating_min"}
    | {"cooling_min", "extrapolated_percent", "lowest_temperature_degc", "highest_temperature_degc"}
)
"""Quantities that describe the data, not the unit: outside its limits such a number says nothing of the unit."""

SIGNED: frozenset[str] = frozenset(
    {"scale_factor_error_ppm", "scale_factor_temperature_ppm_per_degc", "rate_ramp_dphh"}
    | {"lowest_temperature_degc", "highest_temperature_degc"}
)
"""Quantities that may be below zero; the others are sizes or counts."""

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
        "longest_gap_s": ("s", "longest gap without a sample, within a part of the run"),
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
    about: tuple[str, str] = ("", "")
    """Unit and meaning of one that a limits file computes by an expression; those of the others are known."""

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
        return cls(stored.name, value, low, high, stored.reason, about=(stored.unit or "", stored.meaning))

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return MEANING.get(self.name, self.about)[0]

    @property
    def meaning(self) -> str:
        """What it is, in words."""
        usual = MEANING.get(self.name, self.about)[1]
        return _IN_VERIFICATION.get(self.name, usual) if self.in_verification else usual

    def to_json(self) -> dict[str, Any]:
        """All of it; null where there is no number."""
        numbers = {"value": self.value, "low": self.low, "high": self.high}
        known = {key: finite(value) for key, value in numbers.items()}
        return {"name": self.name, "unit": self.unit, "meaning": self.meaning, **known, "reason": self.reason}
