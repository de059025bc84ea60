"""Models side by side: error in the fitted rows, on data left out, and a segment at a time, beside the noise floor.

Held out are whole contiguous pieces, never random rows: their neighbours are nearly equal to them. Effects see the
whole record, rows are masked afterwards. In-sample error alone proves nothing: more intervals always lower it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from bench.analysis.diagnosis.pieces import BLOCKS, pieces_of
from bench.analysis.diagnosis.proof import visited_again, without_states
from bench.analysis.diagnosis.scores import Comparison, Counted, HeldOut, Score, SegmentScore
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model
from bench.analysis.fit.disturbances import left_out_words, undisturbed
from bench.analysis.fit.fitting import Fit, fit_model, refuse_unfit
from bench.analysis.fit.own_jumps import jump_words, with_own_jump
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.thresholds import LEAST_RANGE_DEGC, LEAST_RATES, NEAR_RANGE
from bench.base import BoolArray, FloatArray, InputError, IntArray, despike, shared, usual_workers
from bench.record import Dataset, refuse_mixed

ROTATION = "scale factor"
"""Name of what is fitted beside the bias where a rate table turned the unit."""
_RESAMPLES = 2000


def ladder() -> tuple[Model, ...]:
    """Baselines and the models of the source papers, simplest first; all but the last three are common practice."""
    cubic, line, parabola = (effects.make("polynomial", {"order": order}) for order in (3, 1, 2))
    return (
        Model("fixed points, line", (line,), "soaks_2"),
        Model("fixed points, parabola", (parabola,), "soaks_3"),
        Model("cubic, heating only", (cubic,), "heating"),
        Model("polynomial", (cubic,)),
        Model("regression", (effects.make("regression"),)),
        Model("spline", (effects.make("spline", {"intervals": 24}),)),
    )


def beside_rotation(models: Sequence[Model], record: Dataset) -> tuple[Model, ...]:
    """The models as they can be judged on a record: where a rate table turned the unit, beside a scale factor.

    Without one a model of the bias would be judged by the scale factor's error. Models that have one stay as they are;
    soaks or one branch do not determine one. At one temperature the scale factor over the rate takes their place.
    """
    rates = rates_of(record)
    if rates.size < LEAST_RATES:
        return tuple(models)
    sizes = np.unique(np.abs(rates[rates != 0.0]))
    over_rate = effects.make("scale_factor_nonlinearity", {"order": 3 if sizes.size > 1 else 2})
    own = [model for model in models if "applied_rate" in model.needs]
    if np.ptp(record.channel("temperature")[np.isfinite(record.bias)]) < LEAST_RANGE_DEGC:
        return (Model(ROTATION, (over_rate,)), *own)
    over_temperature = effects.make("scale_factor_temperature")
    return tuple(
        model if model in own else model.adding(over_temperature).adding(over_rate, f"{model.name} + {ROTATION}")
        for model in models
        if model in own or model.rows == "all"
    )


def plain_name(name: str) -> str:
    """Name of a model without the scale factor that `beside_rotation` gave it."""
    return name.removesuffix(f" + {ROTATION}")


def rates_of(record: Dataset) -> FloatArray:
    """Distinct rates [deg/s] at which a table turned the unit, 0 for rest."""
    applied = record.channels.get("applied_rate", np.zeros(0))
    return np.unique(np.round(applied[np.isfinite(applied)]))


def compare(
    datasets: Dataset | Sequence[Dataset],
    models: Sequence[Model],
    floor_dph: float,
    check: Dataset | Sequence[Dataset] | None = None,
    *,
    strict: bool = True,
    lot: bool = False,
) -> Comparison:
    """Score models on runs of one unit, or of a `lot` of units; `floor_dph` is the noise floor of these means or NaN.

    With `check` runs the held-out error is that of a fit to all `datasets` on them; without, that on 20
    contiguous blocks left out in turn, more where a record reaches an end of its temperatures in one block only. A
    model that cannot be fitted raises its InputError, or is refused where not `strict`.
    """
    records = (datasets,) if isinstance(datasets, Dataset) else tuple(datasets)
    checks = () if check is None else (check,) if isinstance(check, Dataset) else tuple(check)
    refuse_unfit(checks)
    if not lot:
        refuse_mixed((*records, *checks))
    records, checks = (tuple(map(undisturbed, some)) for some in (records, checks))
    checks = tuple(with_own_jump(check, records) for check in checks)
    with one_blas_thread():
        fits = shared([partial(_fitted, model, records) for model in models], usual_workers())
        known = [(model, fit) for model, fit in zip(models, fits, strict=True) if isinstance(fit, Fit)]
        tasks = [_outside(model, fit, records, checks) for model, fit in known]
        held = iter(shared([task for own in tasks for task in own], usual_workers()))
    scores = [
        _score(model, fit, records, checks, floor_dph, [next(held) for _ in own])
        for (model, fit), own in zip(known, tasks, strict=True)
    ]
    failed = [(model.name, e) for model, e in zip(models, fits, strict=True) if isinstance(e, InputError)]
    if failed and strict:
        raise failed[0][1]
    refused = [(name, str(error)) for name, error in failed]
    names = tuple(tuple(record.name for record in group) for group in (records, checks))
    interval_s = records[0].interval_s if records else np.nan
    left_out = (*left_out_words((*records, *checks)), *jump_words(checks))
    return Comparison(names[0], names[1], floor_dph, interval_s, tuple(scores), tuple(refused), left_out)


def _fitted(model: Model, records: tuple[Dataset, ...]) -> Fit | InputError:
    """The fit to all rows, or why there is none."""
    try:
        return fit_model(model, records)
    except InputError as error:
        return error


def _outside(
    model: Model, fit: Fit, records: tuple[Dataset, ...], checks: tuple[Dataset, ...]
) -> list[Callable[[], HeldOut]]:
    """What tells the errors by blocks, by segments and, where rows count by their noise, of a fit by their samples."""
    settled = _settled(model, fit)
    blocks = "blocks", [pieces_of(record) for record in records]
    segments = "segments", [record.segment for record in records]
    tasks: list[Callable[[], HeldOut]] = [
        partial(_left_out, settled, fit, records, *left) for left in (blocks, segments)
    ]
    if plain := fit.counted:
        by_blocks = partial(_left_out, settled, plain, records, *blocks, hold=True)
        tasks.append(partial(checked, plain, checks) if checks else by_blocks)
    return tasks


def _settled(model: Model, fit: Fit) -> Model:
    """Automatic options stay as all rows settled them; parameters are searched again from where all rows put them."""
    return replace(fit.model, name=model.name)


def _score(
    model: Model,
    fit: Fit,
    records: tuple[Dataset, ...],
    checks: tuple[Dataset, ...],
    floor_dph: float,
    held: Sequence[HeldOut],
) -> Score:
    residuals = tuple(record.bias - fit.predict(record).bias for record in records)
    by_blocks, by_segments, *of_counted = held
    counted = None
    if plain := fit.counted:
        left = tuple(record.bias - plain.predict(record).bias for record in records)
        counted = Counted(_rms(records, left), of_counted[0])
    return Score(
        model=_settled(model, fit),
        fit=fit,
        counted=counted,
        rms_dph=_rms(records, residuals),
        interval_dph=_interval(records, residuals),
        held_out=checked(fit, checks) if checks else by_blocks,
        by_blocks=by_blocks,
        by_segments=by_segments,
        segments=tuple(_segments(records, residuals, floor_dph)),
    )


def checked(fit: Fit, checks: tuple[Dataset, ...]) -> HeldOut:
    """Error of a fit on check runs that it did not see."""
    try:
        predictions = [fit.predict(check) for check in checks]
    except InputError as error:
        return HeldOut("check", reason=str(error))
    residuals = tuple(
        without_states(check.bias - p.bias, fit.bound.states(check), check.count("rate"))
        for check, p in zip(checks, predictions, strict=True)
    )
    outside = float(np.mean(np.concatenate([fit.out_of_range(check, NEAR_RANGE) for check in checks])))
    found = error_of("check", checks, residuals, outside)
    if "temperature" not in fit.validity:
        return found
    fitted, weights = np.array(fit.validity["temperature"]), [check.count("rate") for check in checks]
    plain = _plain(residuals)
    return replace(found, shape_dph=visited_again(fitted, checks, plain, weights).rms_dph)


def error_of(
    by: str, records: tuple[Dataset, ...], residuals: tuple[FloatArray, ...], out_of_range: float = 0.0
) -> HeldOut:
    """Error of residuals (n,) [deg/h] of records that the fit did not see; its peak is that of disturbances, too."""
    heights = [abs(one.height_dph) for record in records for one in record.disturbed or ()]
    rms, interval, peak = _rms(records, residuals), _interval(records, residuals), max([_peak(residuals), *heights])
    plain = _plain(residuals)
    spikes = sum(int(np.isfinite(r).sum() - np.isfinite(p).sum()) for r, p in zip(residuals, plain, strict=True))
    without = _rms(records, plain) if spikes else rms
    return HeldOut(by, rms, interval, peak, out_of_range, spikes=spikes, plain_dph=without)


def _plain(residuals: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """Residuals (n,) without spikes."""
    return tuple(np.where(despike(own), own, np.nan) for own in residuals)


def _left_out(
    model: Model, whole: Fit, records: tuple[Dataset, ...], by: str, pieces: Sequence[IntArray], hold: bool = False
) -> HeldOut:
    """Refit without each piece in turn and predict it; a fold that cannot be fitted leaves only its reason.

    With `hold` the nonlinear parameters stay those of the whole fit.
    """
    folds = [(i, piece) for i, own in enumerate(pieces) for piece in np.unique(own).tolist()]
    if len(folds) < 2:
        return HeldOut(by, reason=f"the data are one piece: nothing can be left out by {by}")
    residuals = tuple(np.full(len(record), np.nan) for record in records)
    outside = 0
    for i, piece in folds:
        out = pieces[i] == piece
        rows = [~out if j == i else np.ones(len(record), dtype=bool) for j, record in enumerate(records)]
        try:
            part = fit_model(
                model, records, rows, covariance="none", weights=whole.weights or "count", start=whole.theta, hold=hold
            )
        except InputError as error:
            return HeldOut(by, reason=f"{_without(records[i], by, piece)}: {error}")
        residuals[i][out] = (records[i].bias - part.predict(records[i]).bias)[out]
        outside += int(np.sum(part.out_of_range(records[i], NEAR_RANGE) & out))
    share = outside / sum(len(record) for record in records)
    return error_of(by, records, residuals, share)


def _without(record: Dataset, by: str, piece: int) -> str:
    if by == "segments":
        return f"without segment '{segment_name(record, piece)}' of {record.name}"
    return f"without block {piece + 1} of {record.name}"


def _segments(
    records: tuple[Dataset, ...], residuals: tuple[FloatArray, ...], floor_dph: float
) -> Iterable[SegmentScore]:
    for record, residual in zip(records, residuals, strict=True):
        for index in dict.fromkeys(record.segment.tolist()):
            own = record.segment == index
            if np.any(np.isfinite(residual[own])):
                rms = _rms((record.select(own),), (residual[own],))
                yield SegmentScore(record.name, segment_name(record, index), rms, rms / floor_dph)


def segment_name(record: Dataset, index: int) -> str:
    """Name of a segment of a record."""
    named = {segment.index: segment.name for segment in record.segments}
    return named.get(index, "outside segments" if index < 0 else f"segment {index}")


def _squares(records: tuple[Dataset, ...], residuals: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray]:
    """Weighted squares and weights of all rows, zero in gaps; weights as the fit's: samples behind the mean."""
    count = np.concatenate([record.count("rate") for record in records])
    residual = np.concatenate(residuals)
    present: BoolArray = np.isfinite(residual) & (count > 0)
    weights = np.where(present, np.minimum(count / np.median(count[present]) if present.any() else 0.0, 1.0), 0.0)
    return weights * np.where(present, residual, 0.0) ** 2, weights


def _rms(records: tuple[Dataset, ...], residuals: tuple[FloatArray, ...]) -> float:
    squares, weights = _squares(records, residuals)
    return float(np.sqrt(squares.sum() / weights.sum())) if weights.any() else np.nan


def _peak(residuals: tuple[FloatArray, ...]) -> float:
    residual = np.concatenate(residuals)
    return float(np.nanmax(np.abs(residual))) if np.any(np.isfinite(residual)) else np.nan


def _interval(records: tuple[Dataset, ...], residuals: tuple[FloatArray, ...]) -> tuple[float, float]:
    """95 % interval of the RMS by resampling contiguous blocks (seeded: the same data gives the same interval)."""
    squares, weights = _squares(records, residuals)
    starts = np.unique(np.linspace(0, squares.size, BLOCKS + 1).astype(np.int64)[:-1])
    return interval_of(np.add.reduceat(squares, starts), np.add.reduceat(weights, starts))


def interval_of(own: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """95 % interval of the RMS from square sums (b,) of contiguous blocks and their weights (b,)."""
    drawn = np.random.default_rng(0).integers(0, own.size, (_RESAMPLES, own.size))
    total = weight[drawn].sum(axis=1)
    rms = np.sqrt(own[drawn].sum(axis=1)[total > 0] / total[total > 0])
    low, high = np.quantile(rms, [0.025, 0.975]) if rms.size else (np.nan, np.nan)
    return float(low), float(high)
