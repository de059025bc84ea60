"""Figures of the certificate: bias over temperature with the model, the residual, the ladder, the Allan deviation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis import FLICKER_FLOOR, SECONDS_PER_HOUR, AllanCurve, allan_deviation, zero_rate
from bench.base import FloatArray, InputError, in_print, number, with_uncertainty
from bench.deliver.certificate.drawing import Axis, band, dots, figure, line
from bench.deliver.certificate.evidence import Evidence
from bench.record import ComparisonRecord, Dataset, load

TEMPERATURE = "temperature of the unit [°C]"
BRANCHES = ((1, "warm", "heating"), (-1, "accent", "cooling"))


def figures(evidence: Evidence, expanded_dph: float) -> dict[str, Any]:
    """All figures as data, and the terms of the model as text; a figure that cannot be drawn is left out."""
    source = evidence.source
    left = source.dataset.bias - source.fit.predict(source.dataset).bias
    made: dict[str, Any] = {"bias": _bias(source.dataset, left), "residual": _residual(evidence, left, expanded_dph)}
    made["terms"] = _terms(evidence)
    if (ladder := _ladder(evidence)) is not None:
        made["ladder"] = ladder
    if (allan := _allan(evidence)) is not None:
        made["allan"] = allan
    return made


def _terms(evidence: Evidence) -> list[list[str]]:
    """Key, value, standard uncertainty and unit of each term, in the digits of the report."""
    content = evidence.stored.content()["calibration"]
    terms = [(*_key(entry), "") for entry in content["parameters"]]
    terms += [(*_key(entry), in_print(entry["unit"])) for entry in content["coefficients"]]
    return [
        [key, *(text.replace("-", "−") for text in with_uncertainty(value, std)), unit]
        for key, value, std, unit in terms
    ]


def _key(entry: Mapping[str, Any]) -> tuple[str, float, float]:
    std = entry["std"]
    return entry["key"], entry["value"], np.nan if std is None else std


def _bias(data: Dataset, left: FloatArray) -> dict[str, Any]:
    x, y = (
        data.channel("temperature"),
        zero_rate(data),
    )  # while the unit turns, the scale factor adds to it
    axes = Axis.around(TEMPERATURE, x), Axis.around("bias [deg/h]", y)
    series = [dots(*_branch(data, sign, y), axes, colour, name) for sign, colour, name in BRANCHES]
    model = y - left
    series += [line(*_curve(data, sign, model), axes, "ink", "model" if sign > 0 else "") for sign, _, _ in BRANCHES]
    words = f"Bias over temperature: {number(float(np.nanmin(y)))} to {number(float(np.nanmax(y)))} deg/h."
    return figure(axes, series, words)


def _residual(evidence: Evidence, left: FloatArray, expanded_dph: float) -> dict[str, Any]:
    verification = evidence.verification
    data = evidence.source.dataset if verification is None else verification.data
    y = left if verification is None else verification.left
    span = np.array([-1.4, 1.4]) * expanded_dph
    axes = (
        Axis.around(TEMPERATURE, evidence.source.dataset.channel("temperature")),
        Axis.around("left [deg/h]", y, span),
    )
    series = [band(-expanded_dph, expanded_dph, axes[1], "± U")]
    series += [dots(*_branch(data, sign, y), axes, colour, name) for sign, colour, name in BRANCHES]
    what = "the verification run" if verification else "the calibration run"
    return figure(axes, series, f"Bias that is left over temperature in {what}.")


def _branch(data: Dataset, sign: int, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    rows = (data.direction == sign) & np.isfinite(y)
    return data.channel("temperature")[rows], y[rows]


def _curve(data: Dataset, sign: int, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Along time, broken where the direction changes."""
    rows = (data.direction == sign) & np.isfinite(y)
    return np.where(rows, data.channel("temperature"), np.nan), np.where(rows, y, np.nan)


def _ladder(evidence: Evidence) -> dict[str, Any] | None:
    """Models of compare.json from the simplest to the best: errors on fitted and on held-out data, beside the floor."""
    compared = ComparisonRecord.find(evidence.run.path)
    models = [model for model in compared.models if model.held_out_rms_dph] if compared else []
    if compared is None or not models:
        return None
    inside = np.array([model.rms_dph for model in models], dtype=np.float64)
    outside = np.array([model.held_out_rms_dph for model in models], dtype=np.float64)
    floor = float(compared.floor_dph or np.nan)
    axis = Axis.around("model error, RMS [deg/h]", inside, outside, np.array([floor]), log=True, margin=0.08)
    places = axis.place(np.column_stack([inside, outside]))
    rows = [
        {"name": m.name, "inside": a, "outside": b, "text": number(m.held_out_rms_dph)}
        for m, (a, b) in zip(models, places.tolist(), strict=True)
    ]
    at = float(axis.place(np.array([floor]))[0]) if np.isfinite(floor) else None
    words = "; ".join(f"{row['name']} {row['text']} deg/h" for row in rows)
    return {"x": axis.to_json(), "rows": rows, "floor": at, "alt": f"Model error on held-out data: {words}."}


def _allan(evidence: Evidence) -> dict[str, Any] | None:
    noise = evidence.stored.noise
    curves = _curves(evidence)
    if not curves or not noise.coefficients:
        return None
    taus = np.concatenate([curve.tau_s for curve in curves])
    values = np.concatenate([curve.deviation_dph for curve in curves])
    axes = (
        Axis.around("averaging time [s]", taus, log=True),
        Axis.around("Allan deviation [deg/h]", values, log=True),
    )
    series = [
        line(curve.tau_s, curve.deviation_dph, axes, "grey", "soaks" if i == 0 else "")
        for i, curve in enumerate(curves)
    ]
    white, flicker, walk = (entry.value or 0.0 for entry in noise.coefficients)
    tau_h = np.geomspace(taus.min(), taus.max(), 60) / SECONDS_PER_HOUR
    whole = np.sqrt(white**2 / tau_h + (FLICKER_FLOOR * flicker) ** 2 + walk**2 * tau_h / 3.0)
    series.append(line(tau_h * SECONDS_PER_HOUR, whole, axes, "accent", "estimated noise"))
    return figure(axes, series, "Allan deviation of the soaks and of the noise that was estimated from them.")


def _curves(evidence: Evidence) -> list[AllanCurve]:
    """Allan deviation of each stretch of this run from which the noise was estimated."""
    base = load(evidence.run.path, 1.0)
    own = {segment.name for segment in base.segments}
    found = []
    for stretch in evidence.stored.noise.stretches:
        rows = (base.time >= stretch.from_s) & (base.time <= stretch.to_s)
        if (stretch.name in own or not own) and rows.sum() > 60:
            try:
                found.append(allan_deviation(base.bias[rows], 1.0))
            except InputError:
                continue
    return found
