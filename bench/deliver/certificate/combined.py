"""Quantities that a certificate combines: from its runs, its verification, and the uncertainty of its instruments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import date

import numpy as np

from bench.analysis import COVERAGE, Completeness, HeldOut, Quantity, of_data, over_floor
from bench.deliver.certificate.laboratory import Instrument

OF_TABLE = ("scale_factor_error_ppm",)
"""Quantities that are wrong by as much as the rate of the table is."""


def of_all(runs: Sequence[Completeness]) -> Iterator[Quantity]:
    """What is missing in all runs together: samples are added, of shares and gaps the worst one counts."""
    for same in zip(*(tuple(of_data(run)) for run in runs), strict=False):
        name = same[0].name
        uncounted = next((one for one in same if np.isnan(one.value)), None)
        if name == "samples_lost":
            yield uncounted or Quantity.exact(name, sum(one.value for one in same))
        elif name in {"samples_missing_ppm", "longest_gap_s"}:
            yield uncounted or max(same, key=lambda one: one.value)


def with_table(quantity: Quantity, instruments: Sequence[Instrument], on: date) -> Quantity:
    """A scale factor with the uncertainty of the rate that it was compared with; unknown where nobody states that."""
    if np.isnan(quantity.value):
        return quantity
    stated = [(tool, one) for tool in instruments for one in tool.uncertainty if one.unit == "ppm"]
    if not any(tool.turns for tool, _ in stated):
        why = "interval not known: the rate table states no uncertainty in ppm"
        return replace(quantity, low=np.nan, high=np.nan, reason=why)
    square = sum(one.standard**2 + one.drifted(tool.calibrated, on) ** 2 for tool, one in stated)
    low, high = (np.hypot(quantity.value - end, COVERAGE * np.sqrt(square)) for end in (quantity.low, quantity.high))
    return replace(quantity, low=float(quantity.value - low), high=float(quantity.value + high))


def verified(error: HeldOut, known: Mapping[str, Quantity]) -> tuple[Quantity, ...]:
    """The error of a verification in place of that on held-out data; `known` are the quantities of the calibration."""
    low, high = error.interval_dph
    peak = known.get("residual_peak_dph", Quantity("residual_peak_dph"))
    spread = peak.value - peak.low
    return (
        Quantity("residual_rms_dph", error.rms_dph, low, high),
        Quantity("residual_peak_dph", error.peak_dph, error.peak_dph - spread, error.peak_dph + spread),
        over_floor(error, known["noise_floor_dph"]),
        Quantity.exact("extrapolated_percent", 100.0 * error.out_of_range),
    )
