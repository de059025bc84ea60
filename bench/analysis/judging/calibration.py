"""calibration.json: everything that another program needs to compensate this unit, and to know how far to trust it.

The bias at a point is the sum over `coefficients` of value times its power, each channel in its unit: `a2` of a
polynomial multiplies T^2, `piece3.a2` of a spline multiplies (T - knots[2])^2 between knots[2] and knots[3],
`frequency^1` multiplies the frequency. Outside `validity` hold each channel at the end of its range and flag the value,
as a unit does. Covariances: `scaled` holds the amplitudes that were solved for (and the nonlinear parameters), their
joint covariance, and the matrix that turns amplitudes into coefficients, so that cov(coefficients) = M C M' in full.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis.diagnosis.scores import Score
from bench.analysis.noise.floor import Floor
from bench.base import FloatArray, __version__, finite
from bench.record import Manifest


def calibration(
    manifest: Manifest, interval_s: float, best: Score | None, floor: Floor, answer: Mapping[str, Any]
) -> dict[str, Any]:
    """Its content; `calibration` is null where no model could be fitted. `answer` is the analysis in short."""
    return {
        "unit": manifest.unit,
        "run": manifest.run,
        "profile": manifest.profile,
        "created": manifest.created,
        "quantity": "bias (zero-rate output) [deg/h], to be subtracted from the unit's output",
        "software": {**manifest.versions, "bench_analysis": __version__},
        "verdict": {key: answer[key] for key in ("verdict", "sentence", "complete", "admissible", "warnings")},
        "averaging_s": interval_s,
        "noise": _noise(floor),
        "residual": _residual(best),
        "calibration": _fit(best),
        "data": dict(manifest.files),
    }


def _fit(best: Score | None) -> dict[str, Any] | None:
    if best is None:
        return None
    fit = best.fit
    _, _, matrix = fit.bound.physical()
    content = fit.to_json()
    content["scaled"] = {
        "values": [*fit.beta.tolist(), *fit.theta.values()],
        "parameters": list(fit.theta),
        "covariance": _nested(fit.covariance),
        "to_coefficients": matrix.tolist(),
    }
    return content


def _residual(best: Score | None) -> dict[str, Any] | None:
    if best is None:
        return None
    parts = (best.held_out, best.by_blocks, best.by_segments)
    distinct = {part.by: part for part in parts}
    return {
        "rms_dph": finite(best.rms_dph),
        "interval_dph": [finite(end) for end in best.interval_dph],
        "held_out": [
            {
                "by": part.by,
                "rms_dph": finite(part.rms_dph),
                "interval_dph": [finite(end) for end in part.interval_dph],
                "reason": part.reason,
            }
            for part in distinct.values()
        ],
    }


def _noise(floor: Floor) -> dict[str, Any]:
    noise = floor.noise
    coefficients = [("white", "deg/sqrt(h)"), ("flicker", "deg/h"), ("walk", "deg/h/sqrt(h)")]
    if noise is not None and noise.correlated:
        coefficients.append(("correlated", "deg/h"))
    return {
        "floor_dph": finite(floor.floor_dph),
        "reason": floor.reason,
        "stretches": [{"name": name, "from_s": a, "to_s": b} for name, a, b in floor.stretches],
        "coefficients": [
            {
                "name": name,
                "unit": unit,
                "value": getattr(noise, name),
                "interval": [finite(end) for end in noise.intervals.get(name, (np.nan, np.nan))],
                "determined": name not in noise.undetermined,
            }
            for name, unit in coefficients
            if noise is not None
        ],
    }


def _nested(matrix: FloatArray) -> list[list[float | None]]:
    return [[finite(value) for value in row] for row in matrix.tolist()]
