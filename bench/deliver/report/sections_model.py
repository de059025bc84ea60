"""Sections about models: ladder, compensation, spline pieces, residual, coefficients; and the glossary."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bench.analysis import Analysis, Fit, Score, refused_models
from bench.base import CHANNELS, FloatArray, capital, ends, finite, in_print, number, with_uncertainty
from bench.deliver.report import figures_model
from bench.deliver.report.markup import Row, Section, figure, glossary, heading, paragraph, table

_ROWS = {
    "all": "all rows",
    "heating": "heating only",
    "cooling": "cooling only",
    "soaks_2": "2 soaks",
    "soaks_3": "3 soaks",
    "bins": "equal bins",
}
_HELD_OUT = {"check": "a run that was not used for the fit", "blocks": "contiguous blocks, each left out in turn"}
_HELD_OUT["segments"] = "segments, each left out in turn"

_TERMS = (
    ("bias, zero-rate output", "output of the gyro while it does not turn [deg/h]."),
    ("RMS", "root of the mean square of measured minus modelled bias, over the means used for the fit."),
    ("in-sample, held-out", "error on the data of the fit, and on other data. Only the second predicts later runs."),
    ("noise floor", "the residual error of a perfect model, due to the noise of the gyro."),
    ("N, B, K", "angle random walk [deg/√h], bias instability [deg/h], rate random walk [deg/h/√h]: IEEE Std 952."),
    ("Allan deviation", "scatter between neighbouring means, as a function of the averaging time."),
    ("segment, soak, ramp", "one piece of the profile; a soak holds the temperature, a ramp changes it evenly."),
    ("settled", "air in its band, its slope below the limit, the unit's sensor agrees: all for the required time."),
    ("knot", "temperature at which two pieces of a spline meet, with equal value, slope and curvature."),
    ("standard uncertainty", "one standard deviation, computed for noise with white, flicker and random-walk parts."),
    ("validity", "range of each channel in the fitted data; outside it a unit clamps its input and sets a flag."),
)  # fmt: skip


def ladder(analysis: Analysis) -> Section | None:
    """All models side by side, in-sample and held-out, against the floor."""
    comparison, best = analysis.comparison, analysis.best
    if comparison is None:
        return None
    refused = refused_models(comparison)
    lost = table("Models that these data cannot determine", ("model", "why"), refused) if refused else Markup()
    if best is None:
        return Section("ladder", "Ladder of models", paragraph("No model could be fitted.") + lost)
    scores, floor_dph = comparison.scores, finite(comparison.floor_dph)
    names = [analysis.uncompensated, *(score.model.name for score in scores)]
    in_sample = np.array([analysis.uncompensated_dph, *(score.rms_dph for score in scores)])
    held_out = np.array([np.nan, *(score.held_out.rms_dph for score in scores)])
    band = np.array([(np.nan, np.nan), *(score.held_out.interval_dph for score in scores)])
    plot = figures_model.model_ladder(names, in_sample, held_out, band, floor_dph)
    rows = [Row((names[0], "constant", number(in_sample[0]), "–", "–", _ratio(in_sample[0], floor_dph), ""))]
    rows += [_rung(score, floor_dph, score is best) for score in scores]
    head = (
        "model",
        "fitted to",
        "in-sample RMS [deg/h]",
        "held-out RMS [deg/h]",
        "95 % interval",
        "× floor",
        "",
    )
    how = _HELD_OUT.get(best.held_out.by, best.held_out.by)
    checks = f" ({', '.join(comparison.check)})" if comparison.check else ""
    words = (
        f"Held out: {how}{checks}. Averages over {comparison.interval_s:g} s; noise floor {number(floor_dph)} deg/h."
    )
    caption = "Model error on a logarithmic scale: open circles in-sample, filled held-out with 95 % interval."
    alt = "Error of each model. " + "; ".join(
        f"{name}: {number(a)} in-sample, {number(b)} held-out"
        for name, a, b in zip(names, in_sample, held_out, strict=True)
    )
    html = paragraph(words) + figure("fig-ladder", plot, caption, alt)
    html += table("The ladder of models", head, rows, (2, 3, 4, 5))
    if comparison.by_counts:
        html += paragraph(f"Rows count by the noise that each fit estimates; {comparison.by_counts}.")
    for text in (comparison.constants, comparison.spikes):
        html += paragraph(f"{capital(text)}.") if text else ""
    return Section("ladder", "Ladder of models", html + lost)


def _rung(score: Score, floor_dph: float | None, is_best: bool) -> Row:
    low, high = score.held_out.interval_dph
    note = "best" if is_best and np.isfinite(score.held_out.rms_dph) else score.held_out.reason
    cells = (
        score.model.name, _ROWS.get(score.model.rows, score.model.rows), number(score.rms_dph),
        number(score.held_out.rms_dph), f"{number(low)} to {number(high)}",
        _ratio(score.held_out.rms_dph, floor_dph), note,
    )  # fmt: skip
    return Row(cells, "best" if is_best else "")


def compensation(analysis: Analysis) -> Section | None:
    """Measured bias, model and residual over time."""
    data, best = analysis.dataset, analysis.best
    if data is None or best is None:
        return None
    model = data.bias - analysis.residual()
    plot = figures_model.compensation(data, model, best.model.name, finite(analysis.floor.floor_dph))
    words = (
        f"{best.model.name}: {number(best.rms_dph)} deg/h RMS after compensation, on the data it was fitted to; "
        f"{analysis.uncompensated}: {number(analysis.uncompensated_dph)} deg/h."
    )
    caption = f"{words} Green band: noise floor."
    figure_html = figure("fig-compensation", plot, caption, f"Bias, model and compensated bias over time. {words}")
    return Section("compensation", "Compensation over time", figure_html)


def spline(analysis: Analysis) -> Section | None:
    """The pieces and knots of the best model of the ladder that has a spline."""
    found = _spline(analysis)
    if found is None or analysis.dataset is None:
        return None
    score, knots, pieces = found
    plot = figures_model.spline_pieces(analysis.dataset, knots, pieces)
    words = (
        f"{len(pieces)} cubic pieces of {number(float(knots[1] - knots[0]))} °C, smooth to the second derivative at "
        f"the knots (model '{score.model.name}')."
    )
    caption = f"{words} Each piece has a separate colour; diamonds are the knots, grey is the measurement."
    return Section(
        "spline", "Spline pieces", figure("fig-spline", plot, caption, f"Cubic spline over temperature: {words}")
    )


def _spline(analysis: Analysis) -> tuple[Score, FloatArray, FloatArray] | None:
    """Score, knots (m + 1,) and coefficients (m, 4) of the best model with a spline."""
    scores = analysis.comparison.scores if analysis.comparison else ()
    order = sorted(scores, key=lambda s: (s is not analysis.best, np.nan_to_num(s.held_out.rms_dph, nan=np.inf)))
    return next(((score, *found) for score in order if (found := spline_of(score)) is not None), None)


def spline_of(score: Score) -> tuple[FloatArray, FloatArray] | None:
    """Knots (m + 1,) [degC] and coefficients (m, 4) of a model's spline; None where it has none."""
    for key, effect in zip(score.fit.bound.keys, score.fit.bound.effects, strict=True):
        if effect.name == "spline":
            knots = np.array(effect.state()["knots"])
            values = [c.value for c in score.fit.coefficients if c.key.startswith(f"{key}.piece")]
            pieces = np.array(values).reshape(-1, 4)
            # The one constant of a model stands with its first effect; the picture needs it here.
            first = score.fit.coefficients[0]
            if not first.key.startswith(f"{key}."):
                pieces[:, 0] += first.value
            return knots, pieces
    return None


def residual(analysis: Analysis) -> Section | None:
    """Residual of the best model over temperature and over time."""
    data, best = analysis.dataset, analysis.best
    if data is None or best is None:
        return None
    left, floor_dph = analysis.residual(), finite(analysis.floor.floor_dph)
    words = f"Residual of '{best.model.name}': {number(best.rms_dph)} deg/h RMS in-sample."
    worst = max(best.segments, key=lambda s: s.rms_dph, default=None)
    if worst is not None:
        words += f" Worst segment: {worst.name}, {number(worst.rms_dph)} deg/h."
    over_t = figures_model.residual_over_temperature(data, left, floor_dph)
    over_time = figures_model.residual_over_time(data, left, floor_dph)
    band = " Green band: noise floor." if floor_dph else ""
    html = paragraph(words) + figure(
        "fig-residual-temperature", over_t,
        "Residual over temperature. Where the branches differ, there is an effect with memory, which a static curve "
        f"cannot remove.{band}",
        f"Residual over temperature, heating and cooling separately. {words}",
    )  # fmt: skip
    html += figure(
        "fig-residual-time", over_time, f"Residual over time; dotted lines are the borders of segments.{band}",
        f"Residual over time. {words}",
    )  # fmt: skip
    return Section("residual", "Residual", html)


def coefficients(analysis: Analysis) -> Section | None:
    """Coefficients of the best model with their uncertainties and their range of validity."""
    best = analysis.best
    if best is None:
        return None
    fit = best.fit
    rows = [(c.key, *with_uncertainty(c.value, c.std), in_print(c.unit)) for c in fit.coefficients]
    rows += [_searched(fit, key) for key in fit.theta]
    words = (
        f"{best.model.name}, fitted to {fit.rows:,} means over {fit.interval_s:g} s; condition of the scaled columns "
        f"{number(fit.condition, 2)}. {_weighted(fit)} Full precision, covariance and scaling: calibration.json in the "
        "run folder."
    )
    head = ("coefficient", "value", "standard uncertainty", "unit")
    html = paragraph(words) + table(f"Coefficients of {best.model.name}", head, rows, (1, 2))
    ranges = ((name, *ends(*span, 5), _unit(name)) for name, span in fit.validity.items())
    html += heading("Range of validity")
    html += table("Range of each channel in the fitted data", ("channel", "from", "to", "unit"), ranges, (1, 2))
    return Section("coefficients", "Coefficients", html)


def _weighted(fit: Fit) -> str:
    """How the rows of a fit count."""
    if fit.noise is None or fit.weights is None:
        return f"Rows count by their samples{': ' if fit.weights_reason else ''}{fit.weights_reason}."
    noise = fit.noise
    parts = f"N {number(noise.white)} deg/√h, B {number(noise.flicker)} deg/h, K {number(noise.walk)} deg/h/√h"
    return f"Rows count by the noise beside the model (generalised least squares): {parts}."


def _searched(fit: Fit, key: str) -> tuple[str, str, str, str]:
    """Row of a nonlinear parameter."""
    value, deviation = with_uncertainty(fit.theta[key], fit.theta_std[key])
    return (key, value, "on its bound: not determined" if key in fit.on_bound else deviation, "")


def terms(analysis: Analysis) -> Section:
    """Glossary of the report."""
    return Section("terms", "Terms", glossary(_TERMS))


def _ratio(value: float, floor_dph: float | None) -> str:
    return number(value / floor_dph, 2) if floor_dph else "–"


def _unit(channel: str) -> str:
    return in_print(CHANNELS[channel].unit) if channel in CHANNELS else ""
