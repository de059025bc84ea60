"""Whether parts of a run, with a gap between them, may be used for one calibration.

A unit that kept its power over the gap is the same as before: only the temperature during the gap, which it may depend
on, is not recorded. A unit that was switched off has a new turn-on bias. Its parts are one record only if they agree
over temperatures that both passed: the step between them is compared with its own uncertainty, beside one curve in
temperature and direction. Agreement that is not shown is not assumed (docs/decisions/0005-parts-of-a-run.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.base import BoolArray, FloatArray, number
from bench.record import Dataset, Gap, Manifest

_SIGMAS = 3.0
_LEAST_ROWS = 10
"""Means that each part needs in the temperatures that both passed."""
_BIN_DEGC = 1.0
"""Residuals within such a bin of temperature may all be wrong together."""
_LEAST_OVERLAP_DEGC = 2.0
_DEGREES = ((40.0, 5), (15.0, 3), (0.0, 1))
"""Degree of the common curve by the width of the overlap [degC]."""


@dataclass(frozen=True)
class BiasStep:
    """Bias after a gap less bias before it, at the same temperatures [deg/h], and its standard error."""

    dph: float
    error_dph: float
    low_degc: float
    high_degc: float


@dataclass(frozen=True)
class Joint:
    """One gap: what is known of it, and whether both sides may stand behind one calibration."""

    gap: Gap
    step: BiasStep | None
    admissible: bool
    sentence: str

    def to_json(self) -> dict[str, Any]:
        """Numbers of the step, and the judgement."""
        step = None if self.step is None else vars(self.step)
        return {**self.gap.content(), "step": step, "admissible": self.admissible, "sentence": self.sentence}


def joints(manifest: Manifest, data: Dataset | None, floor_dph: float) -> tuple[Joint, ...]:
    """The gaps of a run in parts, judged; none for a run of one piece."""
    parts = [part for part in manifest.parts if part.from_s is not None]
    bounds = [part.from_s for part in parts if part.from_s is not None] + [np.inf]
    judged = []
    for i, part in enumerate(parts):
        if gap := part.gap:
            step = None if data is None else _step(data, bounds[max(i - 1, 0)], bounds[i], bounds[i + 1], floor_dph)
            judged.append(_judge(gap, step, floor_dph))
    return tuple(judged)


def _judge(gap: Gap, step: BiasStep | None, floor_dph: float) -> Joint:
    power, text = gap.unit_power, gap.text
    if power == "kept":
        why = "the unit kept its power; the temperature during the gap, which it may depend on, is not recorded"
        return Joint(gap, step, True, f"{text}; {why}")
    off = "the unit was without power" if power == "lost" else "whether the unit kept its power is not known"
    if step is None:
        why = "no temperature that both parts passed in the same directions shows whether its turn-on bias is the same"
        return Joint(gap, step, False, f"{text}; {off}, and {why}: NOT ADMISSIBLE as one calibration, run it again")
    size = f"{number(step.dph, 2)} ± {number(step.error_dph, 2)} deg/h between {step.low_degc:.0f} and "
    size += f"{step.high_degc:.0f} °C"
    if abs(step.dph) > _SIGMAS * step.error_dph:
        why = f"its parts differ by {size}: NOT ADMISSIBLE as one calibration, run it again"
        return Joint(gap, step, False, f"{text}; {off}, and {why}")
    if not step.error_dph <= floor_dph:
        why = f"its parts differ by {size}, too uncertain to call it the same: NOT ADMISSIBLE as one calibration"
        return Joint(gap, step, False, f"{text}; {off}, and {why}, run it again")
    return Joint(gap, step, True, f"{text}; {off}, but its parts agree ({size})")


def _step(data: Dataset, before_s: float, at_s: float, after_s: float, floor_dph: float) -> BiasStep | None:
    """The step at `at_s` between the part from `before_s` and the one up to `after_s`; None where it does not show."""
    temperature, bias = data.channel("temperature"), data.bias
    known = np.isfinite(temperature) & np.isfinite(bias) & (data.time >= before_s) & (data.time < after_s)
    after = data.time >= at_s
    if not (known & after).any() or not (known & ~after).any():
        return None
    low = max(float(temperature[known & side].min()) for side in (after, ~after))
    high = min(float(temperature[known & side].max()) for side in (after, ~after))
    rows = known & (temperature >= low) & (temperature <= high)
    counts = [int(np.count_nonzero(rows & side)) for side in (after, ~after)]
    if high - low < _LEAST_OVERLAP_DEGC or min(counts) < _LEAST_ROWS:
        return None
    fitted = _fit(temperature[rows], data.direction[rows].astype(np.float64), after[rows], bias[rows])
    if fitted is None:
        return None
    noise_dph = floor_dph * float(np.sqrt(sum(1.0 / count for count in counts)))
    error = max(fitted[1], noise_dph) if np.isfinite(noise_dph) else fitted[1]
    return BiasStep(fitted[0], error, low, high)


def _fit(
    temperature: FloatArray, direction: FloatArray, after: BoolArray, bias: FloatArray
) -> tuple[float, float] | None:
    """The step and its error (sandwich over bins of temperature) beside a common curve; None if not determined."""
    width = float(np.ptp(temperature))
    degree = next(degree for least, degree in _DEGREES if width >= least)
    x = 2.0 * (temperature - temperature.min()) / width - 1.0
    columns = [np.polynomial.legendre.legvander(x, degree), after.astype(np.float64)[:, None]]
    if np.ptp(direction):
        columns.append(direction[:, None])
    design = np.hstack(columns)
    if np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    solved = np.linalg.lstsq(design, bias, rcond=None)[0]
    residual = bias - design @ solved
    groups = np.round(temperature / _BIN_DEGC).astype(np.int64) * 2 + after
    scores = np.array([design[groups == group].T @ residual[groups == group] for group in np.unique(groups)])
    inverse = np.linalg.inv(design.T @ design)
    at = degree + 1
    covariance = inverse @ (scores.T @ scores) @ inverse * len(scores) / max(len(scores) - 1, 1)
    return float(solved[at]), float(np.sqrt(covariance[at, at]))
