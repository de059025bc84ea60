"""A model laid out over the rows of its runs: which rows, which columns, which nonlinear parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Theta
from bench.analysis.effects.model import Model
from bench.analysis.fit.bins import in_bins
from bench.base import BoolArray, FloatArray, InputError, IntArray
from bench.record import Dataset

LEAST_BLOCKS = 20
_STEP = 1e-4  # of a parameter's range, for slopes


@dataclass(frozen=True, eq=False)
class Bound:
    """Effects prepared to the fitted rows, with their nonlinear parameters: gives columns of any record."""

    keys: tuple[str, ...]
    effects: tuple[Effect, ...]
    theta: Mapping[str, Theta]
    slices: Mapping[str, slice]

    def columns(self, record: Dataset) -> FloatArray:
        """Constant and all effects' columns (n, 1 + k) of the whole record."""
        moved = record
        for key, effect in zip(self.keys, self.effects, strict=True):
            if effect.moves_abscissa:
                moved = moved.with_channel("temperature", effect.abscissa(moved, self.theta[key]))
        parts = [e.columns(moved, self.theta[k]) for k, e in zip(self.keys, self.effects, strict=True)]
        return np.hstack([np.ones((len(record), 1)), *parts])

    def states(self, record: Dataset) -> FloatArray:
        """Those of the columns (n, k) whose amplitude each run has for itself."""
        pairs = zip(self.keys, self.effects, strict=True)
        own = [self.slices[key].start + index for key, effect in pairs for index in effect.of_each_run]
        return self.columns(record)[:, own] if own else np.empty((len(record), 0))

    def physical(self) -> tuple[tuple[str, ...], tuple[str, ...], FloatArray]:
        """Keys, units and matrix (p, 1 + k) of all physical coefficients; the constant counted once."""
        size = 1 + sum(own.stop - own.start for own in self.slices.values())
        keys: list[str] = []
        units: list[str] = []
        rows, placed = [], False
        for key, effect in zip(self.keys, self.effects, strict=True):
            form = effect.physical()
            block = np.zeros((len(form.labels), size))
            block[:, self.slices[key]] = form.matrix[:, 1:]
            if not placed and np.any(form.matrix[:, 0]):
                block[:, 0], placed = form.matrix[:, 0], True
            keys += [f"{key}.{label}" for label in form.labels]
            units += form.units
            rows.append(block)
        if not placed:
            keys, units, rows = ["constant", *keys], ["deg/h", *units], [np.eye(1, size), *rows]
        return tuple(keys), tuple(units), np.vstack(rows)


@dataclass(frozen=True, eq=False)
class FitRows:
    """Rows to fit, fixed for all trial parameters; `masks` (n,) a record."""

    model: Model
    records: tuple[Dataset, ...]
    masks: tuple[BoolArray, ...]

    @cached_property
    def y(self) -> FloatArray:
        """Bias of the rows to fit [deg/h]."""
        return np.concatenate([r.bias[m] for r, m in zip(self.records, self.masks, strict=True)])

    @cached_property
    def weights(self) -> FloatArray:
        """Share of a full bin's samples, at most 1: a bin cut short by a segment's end counts less."""
        counts = np.concatenate([r.count("rate")[m] for r, m in zip(self.records, self.masks, strict=True)])
        weights: FloatArray = np.minimum(counts / np.median(counts), 1.0)
        return weights

    @cached_property
    def time(self) -> tuple[FloatArray, ...]:
        """Time of the rows to fit of each record [s]."""
        return tuple(r.time[m] for r, m in zip(self.records, self.masks, strict=True))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Nonlinear parameters of all effects, in the order of `parameter_keys`."""
        return tuple(parameter for effect in self.model.effects for parameter in effect.parameters)

    @property
    def parameter_keys(self) -> tuple[str, ...]:
        """effect.parameter of each."""
        pairs = zip(self.model.keys, self.model.effects, strict=True)
        return tuple(f"{key}.{parameter.name}" for key, effect in pairs for parameter in effect.parameters)

    def start(self) -> FloatArray:
        """Start values of the nonlinear parameters (m,)."""
        return np.array([parameter.start for parameter in self.parameters])

    def using(self, index: int, effect: Effect) -> FitRows:
        """The same rows with one effect replaced."""
        effects = (*self.model.effects[:index], effect, *self.model.effects[index + 1 :])
        return replace(self, model=replace(self.model, effects=effects))

    def bind(self, values: FloatArray, trial: bool = False) -> tuple[Bound, FloatArray]:
        """Effects prepared for these parameters (m,), and their columns (rows, 1 + k); a `trial` demands no rows."""
        theta, moved, prepared = self._split(values), self.records, {}
        selected = self._selected
        pairs = list(zip(self.model.keys, self.model.effects, strict=True))
        for moves in (True, False):  # terms are scaled to the temperature that they will see
            for key, effect in pairs:
                if effect.moves_abscissa is not moves:
                    continue
                prepared[key] = ready = effect.prepare(selected)
                if not trial:
                    ready.demand(selected)
                if ready.moves_abscissa:
                    moved = tuple(r.with_channel("temperature", ready.abscissa(r, theta[key])) for r in moved)
                    selected = [r.select(m) for r, m in zip(moved, self.masks, strict=True)]
        slices, parts, at = {}, [np.ones((self.y.size, 1))], 1
        for key in self.model.keys:
            part = [prepared[key].columns(r, theta[key])[m] for r, m in zip(moved, self.masks, strict=True)]
            parts.append(np.concatenate(part))
            slices[key] = slice(at, at := at + parts[-1].shape[1])
        bound = Bound(self.model.keys, tuple(prepared[key] for key in self.model.keys), theta, slices)
        return bound, np.hstack(parts)

    def slopes(self, values: FloatArray, curve: Callable[[FloatArray], FloatArray]) -> list[FloatArray]:
        """Derivatives of a `curve` (rows,) of parameters (m,) at these values; one-sided at a bound."""
        slopes = []
        for i, parameter in enumerate(self.parameters):
            step = _STEP * (values[i] if parameter.log else parameter.high - parameter.low)
            ends = np.clip(values[i] + np.array([-step, step]), parameter.low, parameter.high)
            low, high = (curve(np.where(np.arange(values.size) == i, end, values)) for end in ends)
            slopes.append((high - low) / (ends[1] - ends[0]))
        return slopes

    def inside(self, values: FloatArray) -> BoolArray:
        """Which of the parameters (m,) at these values are not on an end of their range."""
        pairs = zip(self.parameters, values.tolist(), strict=True)
        return np.array([not parameter.on_bound(value) for parameter, value in pairs], dtype=bool)

    @cached_property
    def _selected(self) -> list[Dataset]:
        """The rows to fit of each record, where nothing moves its temperature."""
        return [r.select(m) for r, m in zip(self.records, self.masks, strict=True)]

    def _split(self, values: FloatArray) -> dict[str, Theta]:
        given = iter(values.tolist())
        pairs = zip(self.model.keys, self.model.effects, strict=True)
        return {key: {p.name: next(given) for p in effect.parameters} for key, effect in pairs}

    def blocks(self, least: int = LEAST_BLOCKS) -> IntArray:
        """Label (rows,) of contiguous blocks, at least `least` in all, none across two runs."""
        total, labels, used = self.y.size, [], 0
        for time in self.time:
            own = max(1, round(least * time.size / max(total, 1)))
            labels.append(used + np.arange(time.size) * own // max(time.size, 1))
            used += own
        return np.concatenate(labels)

    def validity(self) -> dict[str, tuple[float, float]]:
        """Range of each channel that the model needs, over the rows to fit."""
        ranges = {}
        for channel in self.model.needs:
            values = np.concatenate([r.channel(channel)[m] for r, m in zip(self.records, self.masks, strict=True)])
            ranges[channel] = (float(values.min()), float(values.max()))
        return ranges

    def scatter(self, values: FloatArray) -> tuple[FloatArray, ...]:
        """Values of the rows to fit put back on each record's time base, NaN elsewhere."""
        out, at = [], 0
        for record, mask in zip(self.records, self.masks, strict=True):
            full = np.full(len(record), np.nan)
            full[mask] = values[at : at + int(mask.sum())]
            at += int(mask.sum())
            out.append(full)
        return tuple(out)


def fit_rows(model: Model, records: tuple[Dataset, ...], rows: Sequence[BoolArray] | None = None) -> FitRows:
    """Rows of a model and its runs: finite rows of `rows` that belong to the model's branch.

    Raises InputError: no run, zero rows, a channel that is missing, no soaks for the fixed-temperature method.
    """
    if not records or not any(len(record) for record in records):
        raise InputError("zero rows to fit: the run is empty, or shorter than one of its means")
    masks = tuple(np.ones(len(r), dtype=bool) for r in records) if rows is None else tuple(rows)
    if len(masks) != len(records) or any(m.shape != r.time.shape for m, r in zip(masks, records, strict=True)):
        raise InputError("rows must be one mask a dataset, as long as it")
    if model.rows.startswith("soaks"):
        records, masks = _soak_means(model, records, masks)
    if model.rows == "bins":
        chosen = tuple(record.select(mask) for record, mask in zip(records, masks, strict=True) if mask.any())
        model, records = in_bins(model, chosen)
        masks = tuple(np.ones(len(record), dtype=bool) for record in records)
    masks = tuple(mask & _usable(model, record) for record, mask in zip(records, masks, strict=True))
    if not any(mask.any() for mask in masks):
        names = ", ".join(record.name for record in records)
        raise InputError(f"zero rows to fit for model '{model.name}' ({model.rows} rows of {names})")
    within = replace(model, effects=tuple(effect.suited(records) for effect in model.effects))
    return FitRows(within, records, masks)


def _usable(model: Model, record: Dataset) -> BoolArray:
    usable = np.isfinite(record.bias)
    for channel in model.needs:
        usable = usable & np.isfinite(record.channel(channel))
    if model.rows in {"heating", "cooling"}:
        usable &= record.direction == (1 if model.rows == "heating" else -1)
    return usable


def _soak_means(
    model: Model, records: tuple[Dataset, ...], masks: tuple[BoolArray, ...]
) -> tuple[tuple[Dataset, ...], tuple[BoolArray, ...]]:
    """One row a soak, its last half averaged: the coldest, the warmest and, for three, the one nearest the middle."""
    wanted = int(model.rows.removeprefix("soaks_"))
    points = tuple(_tails(record, mask) for record, mask in zip(records, masks, strict=True))
    soaks_degc = np.concatenate([p.channel("temperature") if len(p) else np.zeros(0) for p in points])
    if soaks_degc.size == 0:
        raise InputError(f"model '{model.name}' needs {wanted} soaks; {records[0].name} has none")
    low, high = float(np.nanmin(soaks_degc)), float(np.nanmax(soaks_degc))
    middle = float(soaks_degc[np.nanargmin(np.abs(soaks_degc - 0.5 * (low + high)))])
    chosen = [low, high] if wanted == 2 else [low, middle, high]
    if min(np.diff(sorted(chosen)), default=0.0) < 1.0:
        raise InputError(f"model '{model.name}' needs {wanted} soaks more than 1 degC apart, not {soaks_degc.round(1)}")
    # Each temperature once, at its first visit: the method measures every point once.
    first = [int(np.flatnonzero(soaks_degc == value)[0]) for value in chosen]
    keep = np.isin(np.arange(soaks_degc.size), first)
    ends = np.cumsum([len(point) for point in points])[:-1]
    return points, tuple(np.split(keep, ends))


def _tails(record: Dataset, mask: BoolArray) -> Dataset:
    still = [segment for segment in record.segments if segment.settles]
    tail = np.zeros(len(record), dtype=bool)
    for segment in still:
        own = np.flatnonzero((record.segment == segment.index) & mask)
        tail[own[own.size // 2 :]] = True
    return record.select(tail).average(1e9) if tail.any() else record.select(tail)
