"""Linear models fitted to every sample of runs in one pass, instead of to means.

Each model leaves its own sums (`fit.state`); all models of a call share the pass. The static models are summed
as products of polynomials or in cells. Any other model is laid out by a fit to the 30 s means, which also gives its
nonlinear parameters: what has a memory is computed from the 1 s means of the whole run, which are far shorter than any
memory of an effect, and lies on the straight line between them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bench.analysis.effects.base import Effect, Scale, Series, StaticEffect, least_range, prepared
from bench.analysis.effects.model import Model
from bench.analysis.effects.polynomial import Polynomial
from bench.analysis.effects.regression import Regression
from bench.analysis.effects.spline import Spline, refuse_unvisited
from bench.analysis.effects.surface import Surface
from bench.analysis.fit.cells import Cells
from bench.analysis.fit.design import Bound
from bench.analysis.fit.disturbances import undisturbed
from bench.analysis.fit.fitting import Fit, fit_model
from bench.analysis.fit.gram import SAMPLE, ChebyshevRows, Columns, Gram
from bench.analysis.fit.normal import Normal, Solved, sandwich, solve
from bench.analysis.fit.products import Products
from bench.analysis.fit.samples import Samples
from bench.analysis.fit.smooth import choose_intervals, spline_normal
from bench.analysis.fit.state import BLOCK_S, State
from bench.analysis.fit.weighting import OF_SUMS
from bench.base import BoolArray, FloatArray, InputError
from bench.record import Dataset

CELLS = 96
"""Splines of 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48 and 96 intervals follow from one pass."""
FOLDS = 20


@dataclass(frozen=True, eq=False)
class SampledRun:
    """A run in three resolutions: its samples, its 1 s means, and the means that an ordinary fit takes."""

    samples: Samples
    seconds: Dataset
    means: Dataset


@dataclass(eq=False)
class Pass:
    """A model while its runs are read, and what can be asked of it afterwards without reading anything."""

    model: Model
    state: State
    bound: Bound
    form: Callable[[FloatArray], Normal]
    memory: Sequence[FloatArray] = ()
    """Columns (seconds, k) of each run that are computed from its 1 s means."""
    validity: Mapping[str, tuple[float, float]] | None = None

    def normal(self, groups: FloatArray) -> Normal:
        """Quadratic form of sums (..., size)."""
        return self.form(groups)

    @property
    def rows(self) -> BoolArray:
        """Blocks (b,) that the model is fitted to."""
        direction = self.state.direction
        wanted: dict[str, BoolArray] = {"heating": direction == 1, "cooling": direction == -1}
        return wanted.get(self.model.rows, np.ones(direction.size, dtype=bool))

    def solved(self, keep: BoolArray | None = None) -> Solved:
        """The fit to the blocks of the model's branch, or to those of them in `keep` (b,)."""
        chosen = self.rows if keep is None else self.rows & keep
        if not chosen.any():
            raise InputError(f"zero rows to fit for model '{self.model.name}' ({self.model.rows} rows)")
        try:
            return solve(self.normal(self.state.table[chosen].sum(axis=0)))
        except InputError as error:
            raise InputError(f"model '{self.model.name}': {error}") from None

    def fit(self, records: Sequence[SampledRun]) -> Fit:
        """The fit as an ordinary one, its covariance from the scores of the blocks (they may correlate inside)."""
        done = self.solved()
        groups = self.normal(self.state.grouped(np.arange(len(self.rows)), self.rows))
        m, p = sum(len(effect.parameters) for effect in self.model.effects), done.beta.size
        covariance = np.full((p + m, p + m), np.nan)  # of parameters that the samples did not determine: unknown
        covariance[:p, :p] = sandwich(groups, done.inner)
        return Fit(
            model=self.model,
            bound=self.bound,
            beta=done.beta,
            covariance=covariance,
            noise=None,
            rms_dph=done.rms_dph,
            condition=done.condition,
            rows=int(done.rows),
            interval_s=_interval(records),
            runs=tuple(record.means.name for record in records),
            validity=self.validity or {},
            weights_reason=OF_SUMS,
        )


def read(models: Sequence[Model], records: Sequence[SampledRun]) -> list[Pass | InputError]:
    """Read every sample of the runs once, for all models; one that cannot be laid out is its InputError."""
    duration_s = max(float(np.ptp(record.seconds.time)) for record in records)
    block_s = float(np.clip(duration_s / (2 * FOLDS), 1.0, BLOCK_S))
    passes = [_attempt(partial(_lay_out, model, records, block_s)) for model in models]
    going = [one for one in passes if isinstance(one, Pass)]
    for run, record in enumerate(records):
        means = undisturbed(record.means)
        needs = tuple(dict.fromkeys(name for one in going for name in one.state.sums.needs if "." not in name))
        for batch in record.samples.read([name for name in needs if name not in {"time", "rate"}]) if going else ():
            y = batch.y
            for part in means.disturbed or ():
                y = np.where((batch.time >= part.from_s) & (batch.time < part.to_s), np.nan, y)
            for one in going:
                own = _with_memory(one, run, record, batch.columns)
                one.state.add(batch.time, own, y, batch.segment, run)
    return [_attempt(partial(_settled, one)) if isinstance(one, Pass) else one for one in passes]


def _attempt(work: Callable[[], Pass]) -> Pass | InputError:
    try:
        return work()
    except InputError as error:
        return error


def _interval(records: Sequence[SampledRun]) -> float:
    time = records[0].seconds
    return float(np.ptp(time.time) / max(records[0].samples.rows - 1, 1))


def _lay_out(model: Model, records: Sequence[SampledRun], block_s: float) -> Pass:
    if model.rows not in {"all", "heating", "cooling"}:
        raise InputError(f"model '{model.name}': rows: {model.rows} is a fit to means; leave --every-sample out")
    effect = model.effects[0]
    if len(model.effects) > 1 or not isinstance(effect, StaticEffect):
        return _general(model, records, block_s)
    scales = {name: _scale(records, name) for name in effect.needs}
    ready = effect.scaled(scales)
    offset = float(np.nanmean(records[0].means.bias))
    bound = _bound(model, ready)
    validity = {name: (scale.low, scale.high) for name, scale in scales.items()}
    if isinstance(ready, Spline):
        scale = scales["temperature"]
        cells = Cells(scale.low, scale.high, CELLS, offset)
        if isinstance(ready.intervals, int):
            cells.joined(np.zeros(cells.size), ready.intervals)
        form = _spline_form(cells, ready)
        return Pass(model, State(cells, block_s), bound, form, validity=validity)
    if isinstance(ready, Surface):
        products = Products(ready.series[0], ready.series[1], ready.terms, offset)
        return Pass(model, State(products, block_s), bound, products.normal, validity=validity)
    series = _series(ready)
    columns, y = _sample(records, effect.needs)
    width = 1 + sum(one.order for one in series)
    gram = Gram.of(effect.needs, width, ChebyshevRows(series), columns, y)
    return Pass(model, State(gram, block_s), bound, gram.normal, validity=validity)


def _series(effect: Effect) -> tuple[Series, ...]:
    if isinstance(effect, Regression):
        return effect.series
    if isinstance(effect, Polynomial):
        return (prepared(effect.series),)
    raise InputError(f"{effect.name} cannot be summed over every sample; leave --every-sample out")


def _spline_form(cells: Cells, spline: Spline) -> Callable[[FloatArray], Normal]:
    def form(sums: FloatArray) -> Normal:
        if not isinstance(spline.intervals, int):
            raise RuntimeError("the number of intervals is chosen after the pass")
        return spline_normal(cells, sums, spline.intervals, spline.ends)

    return form


def _settled(one: Pass) -> Pass:
    """The pass with its automatic number of intervals chosen; InputError where an interval has too few rows."""
    effect = one.bound.effects[0]
    if not isinstance(effect, Spline) or not isinstance(one.state.sums, Cells):
        return one
    cells, label = one.state.sums, one.state.folds(FOLDS)
    if effect.intervals == "auto":
        candidates = [m for c in effect.choices() if isinstance(c, Spline) and isinstance(m := c.intervals, int)]
        possible = tuple(m for m in candidates if CELLS % m == 0)
        groups = one.state.grouped(label, one.rows)
        effect = replace(effect, intervals=choose_intervals(cells, groups, possible, effect.ends)[0])
    m = effect.intervals
    visited = cells.joined(one.state.grouped(np.zeros_like(label), one.rows)[0], int(m))[:, 0]
    refuse_unvisited(visited, (cells.low, cells.high), "samples")
    model = replace(one.model, effects=(replace(effect, scale=None),))
    return replace(one, model=model, bound=_bound(model, effect), form=_spline_form(cells, effect))


def _bound(model: Model, effect: Effect) -> Bound:
    key = model.keys[0]
    width = 0
    if not (isinstance(effect, Spline) and effect.intervals == "auto"):
        width = effect.physical().matrix.shape[1] - 1
    return Bound(model.keys, (effect,), {key: {}}, {key: slice(1, 1 + width)})


def _scale(records: Sequence[SampledRun], channel: str) -> Scale:
    ends = np.array([record.samples.range(channel) for record in records])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    return Scale.spanning(channel, low, high, least_range(channel))


def _sample(records: Sequence[SampledRun], needs: Sequence[str]) -> tuple[dict[str, FloatArray], FloatArray]:
    """Rows without gaps of the 1 s means, to see which columns depend on each other."""
    y = np.concatenate([record.seconds.bias for record in records])
    columns = {name: np.concatenate([record.seconds.channel(name) for record in records]) for name in needs}
    keep = np.isfinite(y) & np.all([np.isfinite(column) for column in columns.values()], axis=0)
    rows = np.flatnonzero(keep)
    rows = rows[:: max(1, rows.size // SAMPLE)]
    return {name: column[rows] for name, column in columns.items()}, y[rows]


def _general(model: Model, records: Sequence[SampledRun], block_s: float) -> Pass:
    """Any model, laid out by its fit to the means."""
    fit = fit_model(model, tuple(record.means for record in records), covariance="none", weights="count")
    bound = fit.bound
    moves = any(effect.moves_abscissa for effect in bound.effects)
    direct = [isinstance(effect, StaticEffect) and not moves for effect in bound.effects]
    memory = [bound.columns(record.seconds) for record in records]
    width = memory[0].shape[1]
    places = [
        at
        for key, sampled in zip(bound.keys, direct, strict=True)
        if not sampled
        for at in range(bound.slices[key].start, bound.slices[key].stop)
    ]
    sampled = [(e, bound.slices[k]) for k, e, own in zip(bound.keys, bound.effects, direct, strict=True) if own]
    channels = tuple(dict.fromkeys(name for effect, _ in sampled for name in effect.needs))
    needs = (*channels, *(f"column.{at}" for at in places))

    def write(columns: Columns, out: FloatArray) -> None:
        out[0] = 1.0
        for effect, own in sampled:
            out[own] = effect.columns(_rows(columns, effect.needs), {}).T
        for at in places:
            out[at] = columns[f"column.{at}"]

    # The columns of the 1 s means tell which of them depend on each other as well as any sample would.
    y = np.concatenate([record.seconds.bias for record in records])
    table = np.concatenate(memory)
    rows = np.flatnonzero(np.isfinite(y) & np.all(np.isfinite(table), axis=1))
    gram = Gram.mixed(needs, write, table[rows].T, y[rows])
    kept = tuple(part[:, places] for part in memory)
    settled = replace(fit.model, name=model.name)
    if gram.width != width:
        raise RuntimeError("the columns of a model changed their number")
    return Pass(settled, State(gram, block_s), bound, gram.normal, kept, fit.validity)


def _rows(columns: Columns, needs: Sequence[str]) -> Dataset:
    """Samples as a record: an effect without memory only looks at its channels."""
    own = {name: columns[name] for name in needs}
    size = next(iter(own.values())).size
    return Dataset("samples", np.arange(size, dtype=np.float64), own, np.zeros(size, dtype=np.int64))


def _with_memory(one: Pass, run: int, record: SampledRun, columns: Columns) -> Columns:
    names = [name for name in one.state.sums.needs if name.startswith("column.")]
    if not names:
        return columns
    time, own = record.seconds.time, one.memory[run]
    return {**columns, **{name: np.interp(columns["time"], time, own[:, i]) for i, name in enumerate(names)}}
