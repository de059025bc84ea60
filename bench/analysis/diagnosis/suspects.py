"""Runs and a model laid out for the evidence engine, and every effect that the model lacks as a candidate for it.

Several runs are stacked a month apart, each with a constant of its own: the turn-on bias is not a function of
temperature. The model's own nonlinear parameters take part through the slopes of the fitted curve.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bench.analysis.diagnosis.candidates import Candidate, Problem, Theta, orthonormal, outside
from bench.analysis.diagnosis.pieces import legs_of
from bench.analysis.diagnosis.probes import Probe, usual
from bench.analysis.diagnosis.resolution import Resolution, resolution
from bench.analysis.diagnosis.still import Still
from bench.analysis.effects.base import Effect
from bench.analysis.fit import design
from bench.analysis.fit.solve import solve
from bench.analysis.noise.likelihood import Record, gls
from bench.analysis.noise.whitening import Whitener
from bench.base import INSTRUMENTS, OTHERS, BoolArray, FloatArray, InputError
from bench.record import Dataset

_APART_S = 30 * 86400.0
_POINTS_OF_TWO = 14  # grid points of each parameter of a change point with a width
_POINTS_OF_PLACE = 64  # of a place in temperature: about two degrees apart, what happens there is wider
_MOST_STEPS = 4
_FAR = 0.2  # of the range of temperature (RMS): a fitted curve says nothing of a temperature that is so far away
_LEAST_LEGS = 4  # of a temperature over which a curve is not one over time
_SHARES = (1.0, 0.5, 0.2)  # of a Gauss-Newton step, the first that lowers the misfit
_ENOUGH = 1e-3  # of the misfit: a step that gains less is the last
CHANNELS = ("frequency", "drive", "quadrature", "supply", "compressor", "chamber_temperature", "applied_rate",
            *INSTRUMENTS[1:], *OTHERS)  # fmt: skip
"""That a formula or a probe may look at, beside the temperature."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A model over the rows of its runs at fixed nonlinear parameters `theta` (in the order of its effects)."""

    rows: design.FitRows
    theta: FloatArray
    still: Still | None = None
    """The unit's isothermal run."""
    sisters: tuple[Record, ...] = ()
    """Isothermal runs of units like this one."""
    white: FloatArray | None = None
    """White variance of the rows (n,) relative to the isothermal records', where it is not the same."""
    resolution: Resolution = field(default_factory=Resolution)
    """Steps of thermometer and output, where they matter."""

    @cached_property
    def problem(self) -> Problem:
        """What the engine sees: rows stacked, the model's columns, constants of further runs, slopes."""
        columns = self._bound[1]
        starts = _APART_S * np.arange(len(self.rows.time))
        time = np.concatenate([t + s for t, s in zip(self.rows.time, starts, strict=True)])
        return Problem(
            time_s=time,
            y=self.rows.y,
            base=np.hstack([columns, self._others]),
            interval_s=self.rows.records[0].interval_s,
            statics=() if self.still is None else (self.still.beside(self._terms_of(self.still.means)), *self.sisters),
            white=(1.0 if self.white is None else self.white) / self.rows.weights,
        )

    def adding(self, effect: Effect, theta: Theta) -> Layout:
        """The same rows with one more effect in the model."""
        rows = replace(self.rows, model=self.rows.model.adding(effect))
        return replace(self, rows=rows, theta=np.concatenate([self.theta, np.array(theta, dtype=np.float64)]))

    def settled(self, way: Whitener, count: int) -> Layout:
        """The same with the first `count` parameters moved to where they fit best beside all others, by Gauss-Newton.

        An effect that was found first took in a part of what is found beside it. The evidence of that counts the
        parameters of the first as free; what is predicted with both has to have them where both fit.
        """
        best, left = self, self._misfit(way) if count else np.inf
        if left == np.inf:
            return self
        low, high = (np.array([getattr(p, end) for p in self.rows.parameters[:count]]) for end in ("low", "high"))
        for _ in range(_MOST_STEPS):
            slopes, known = best._slopes
            columns = np.hstack([best._linear, slopes[:, known]])
            step = np.zeros(slopes.shape[1])
            step[known] = gls(columns, self.rows.y, way).beta[best._linear.shape[1] :]
            for share in _SHARES:
                theta = best.theta.copy()
                theta[:count] = np.clip(theta[:count] + share * step[:count], low, high)
                other = replace(best, theta=theta)
                if (reached := other._misfit(way)) < left:
                    break
            else:
                break
            gained, best, left = left - reached, other, reached
            if gained < _ENOUGH * left:
                break
        return best

    def _misfit(self, way: Whitener) -> float:
        try:
            return gls(self._linear, self.rows.y, way).rss
        except InputError:  # no column can be formed at these parameters
            return np.inf

    def prepared(self, effect: Effect) -> Effect:
        """The effect with its scales fixed to the rows, as the model's terms see them."""
        return effect.prepare([r.select(m) for r, m in zip(self.seen, self.rows.masks, strict=True)])

    def candidate(self, effect: Effect, name: str, alike: bool = False) -> Candidate:
        """The effect as a candidate; InputError where the rows do not allow it.

        One that is `alike` acts in the isothermal run in the same size.
        """
        places = [p.unit for p in effect.parameters if p.change_point]
        points = _POINTS_OF_PLACE if "degC" in places else None
        if places and len(effect.parameters) > 1:
            points = _POINTS_OF_TWO
        moved = _Moved(self, effect) if effect.moves_abscissa else None
        return Candidate(
            name=name,
            columns=moved or _Terms(self, effect),
            effect=effect.name,
            kind="abscissa" if effect.moves_abscissa else "term",
            parameters=effect.parameters,
            change_point=bool(places),
            points=points,
            rarity=effect.rarity,
            shift=moved.shift if moved else None,
            anew=moved.anew if moved else None,
            still=self.still.columns(self.prepared(effect)) if alike and self.still else None,
        )

    def probes(self) -> list[Probe]:
        """Where to look for misfit: temperature by direction, time, rate of change, channels."""
        time = np.concatenate(self.rows.time)
        channels = {name: self.stacked([record.channel(name) for record in self.rows.records]) for name in self.further}
        moving = {name: values for name, values in channels.items() if np.ptp(values) > 0.0}
        return usual(time, self.temperature, self.slope, moving)

    @property
    def slope(self) -> FloatArray:
        """Rate of change of the temperature at the rows [degC/min]."""
        return np.nan_to_num(self.stacked([record.dT_dt for record in self.rows.records]))

    @property
    def further(self) -> tuple[str, ...]:
        """Channels beside the temperature that have a value in every row."""
        return tuple(
            name
            for name in CHANNELS
            if all(name in r.channels and np.all(np.isfinite(r.channels[name][m])) for r, m in self._pairs)
        )

    @property
    def temperature(self) -> FloatArray:
        """Temperature of the rows [degC]."""
        return self.stacked([record.channel("temperature") for record in self.rows.records])

    def beyond(self, values: FloatArray) -> FloatArray:
        """The part of values (n,) that the model's columns cannot follow."""
        return outside(orthonormal(self.problem.base), values)

    def stacked(self, columns: Sequence[FloatArray]) -> FloatArray:
        """Values of whole records at the rows of the problem."""
        return np.concatenate([c[m] for c, m in zip(columns, self.rows.masks, strict=True)])

    @cached_property
    def _bound(self) -> tuple[design.Bound, FloatArray]:
        """The model's effects prepared to the rows at these parameters, and their columns."""
        return self.rows.bind(self.theta, trial=True)

    @cached_property
    def seen(self) -> tuple[Dataset, ...]:
        """The records with the temperature that the model's terms see."""
        return tuple(_moved(self._bound[0], record) for record in self.rows.records)

    def _terms_of(self, record: Dataset) -> Iterator[FloatArray]:
        """What each term of the fitted model is in another record (n,) [deg/h], as far as it has the channels."""
        bound, moved = self._fitted, _moved(self._bound[0], record)
        for key, effect in zip(bound.keys, bound.effects, strict=True):
            if all(name in record.channels for name in effect.needs):
                yield effect.columns(moved, bound.theta[key]) @ self._beta[bound.slices[key]]

    def curve(self, seen: Sequence[Dataset]) -> FloatArray:
        """The fitted curve (n,) [deg/h] at the temperatures of these records, which all terms see."""
        return self.stacked(self.curves(seen))

    def curves(self, seen: Sequence[Dataset]) -> list[FloatArray]:
        """The same of all rows of each record."""
        return [self._fitted.columns(record) @ self._beta for record in seen]

    @cached_property
    def unmoved(self) -> FloatArray:
        """The same where the model's terms see it."""
        return self.curve(self.seen)

    @property
    def steepness(self) -> list[FloatArray]:
        """Slope of the fitted curve over temperature (n,) [deg/h/degC] of all rows of each record."""
        ends = [
            self.curves([r.with_channel("temperature", r.channel("temperature") + shift) for r in self.seen])
            for shift in (-0.5, 0.5)
        ]
        return [after - before for before, after in zip(*ends, strict=True)]

    @cached_property
    def _fitted(self) -> design.Bound:
        """The model's terms alone, prepared to what they see."""
        bound = self._bound[0]
        kept = [i for i, effect in enumerate(bound.effects) if not effect.moves_abscissa]
        return replace(bound, keys=tuple(bound.keys[i] for i in kept), effects=tuple(bound.effects[i] for i in kept))

    @cached_property
    def _beta(self) -> FloatArray:
        return solve(self._bound[1], self.rows.y, self.rows.weights).beta

    @property
    def _pairs(self) -> list[tuple[Dataset, BoolArray]]:
        return list(zip(self.rows.records, self.rows.masks, strict=True))

    @cached_property
    def _linear(self) -> FloatArray:
        """The model's columns and constants of the runs after the first."""
        sizes = [len(t) for t in self.rows.time]
        run = np.repeat(np.arange(len(sizes)), sizes)
        constants = [(run == i).astype(np.float64) for i in range(1, len(sizes)) if sizes[i]]
        return np.column_stack([self._bound[1], *constants])

    @cached_property
    def _others(self) -> FloatArray:
        """Constants of the runs after the first, and the slopes of the fitted curve along the model's parameters."""
        return np.column_stack([self._linear[:, self._bound[1].shape[1] :], self.slopes, *self._rounding])

    @property
    def _rounding(self) -> list[FloatArray]:
        """What the steps of the output add to it (n, k), where they matter."""
        if not self.resolution.rate_step_dph:
            return []
        return [self.resolution.rounding(self.stacked(self.outputs))]

    @property
    def outputs(self) -> list[FloatArray]:
        """Fitted output (n,) [deg/h] of all rows of each record, whatever turned included."""
        turned = [record.channel("rate") - record.bias for record in self.rows.records]
        return [own + by for own, by in zip(self.curves(self.seen), turned, strict=True)]

    @property
    def slopes(self) -> FloatArray:
        """Slopes (n, m) of the fitted curve along those of the model's parameters that move it.

        One on an end of its range is not free: its slope would take in what lies beyond that end.
        """
        return self._slopes_of(len(self.theta))

    def fixed(self, free: int) -> FloatArray:
        """The model's columns (n, k) as in `problem`, with slopes along its first `free` parameters alone."""
        return np.hstack([self._linear, self._slopes_of(free), *self._rounding])

    def _slopes_of(self, free: int) -> FloatArray:
        slopes, known = self._slopes
        pairs = enumerate(zip(self.rows.parameters, self.theta.tolist(), strict=True))
        return slopes[:, known & np.array([i < free and not p.on_bound(value) for i, (p, value) in pairs], dtype=bool)]

    @cached_property
    def _slopes(self) -> tuple[FloatArray, BoolArray]:
        """Slopes (n, m) of the fitted curve along the model's parameters, and which of them (m,) move it."""

        def curve(theta: FloatArray) -> FloatArray:
            return np.asarray(self.rows.bind(theta, trial=True)[1] @ self._beta)

        slopes = np.column_stack([np.zeros((self.rows.y.size, 0)), *self.rows.slopes(self.theta, curve)])
        return slopes, np.isfinite(slopes).all(axis=0) & (slopes != 0.0).any(axis=0)


def _moved(bound: design.Bound, record: Dataset) -> Dataset:
    """The record with the temperature that the terms of a model see."""
    for key, effect in zip(bound.keys, bound.effects, strict=True):
        if effect.moves_abscissa:
            record = record.with_channel("temperature", effect.abscissa(record, bound.theta[key]))
    return record


def resolved(layout: Layout, floor_dph: float) -> Layout:
    """The layout with the steps of its thermometer and output, where they cause more than a share of the floor."""
    if "temperature" not in layout.rows.records[0].channels:
        return layout
    found = resolution(layout.rows.records, layout.outputs, layout.steepness)
    return replace(layout, resolution=found) if found.matters(floor_dph) else layout


class _Terms:
    """Columns of an effect that adds terms, at the temperature that all terms of the model see."""

    def __init__(self, layout: Layout, effect: Effect) -> None:
        self._layout = layout
        self._names = [p.name for p in effect.parameters]
        self._effect = layout.prepared(effect)

    def __call__(self, theta: Theta) -> FloatArray:
        named = dict(zip(self._names, theta, strict=True))
        return self._layout.stacked([self._effect.columns(record, named) for record in self._layout.seen])


class _Moved:
    """The model's columns at the temperature that an effect moves them to."""

    def __init__(self, layout: Layout, effect: Effect) -> None:
        self._layout, self._effect = layout, effect
        self._rows = layout.adding(effect, ()).rows
        start = np.array([p.start for p in effect.parameters])
        bound, _ = self._rows.bind(np.concatenate([layout.theta, start]), trial=True)
        self._effect = bound.effects[-1]

    def __call__(self, theta: Theta) -> FloatArray:
        try:
            _, columns = self._rows.bind(np.concatenate([self._layout.theta, np.array(theta)]), trial=True)
        except InputError:  # a lag so long that the moved temperature stands still
            return self._layout.problem.base
        return np.hstack([columns, self._layout._others])

    def shift(self, theta: Theta) -> FloatArray:
        """What the moved temperature changes in the fitted curve (n, 1)."""
        moved = [r.with_channel("temperature", own) for r, own in zip(self._layout.seen, self._at(theta), strict=True)]
        return (self._layout.curve(moved) - self._layout.unmoved)[:, None]

    def anew(self, theta: Theta) -> bool:
        """Whether the moved temperature is far from the one that was fitted, and comes back often enough that a curve
        over it is not a curve over time.
        """
        moved, seen = self._at(theta), [record.channel("temperature") for record in self._layout.seen]
        apart = self._layout.stacked([own - was for own, was in zip(moved, seen, strict=True)])
        far = _FAR * float(np.ptp(self._layout.stacked(seen)))
        return (
            float(np.sqrt(np.mean(apart**2))) > far and sum(int(legs_of(own)[-1]) + 1 for own in moved) >= _LEAST_LEGS
        )

    def _at(self, theta: Theta) -> list[FloatArray]:
        """The moved temperature [degC] of all rows of each record."""
        named = dict(zip([p.name for p in self._effect.parameters], theta, strict=True))
        return [self._effect.abscissa(record, named) for record in self._layout.seen]
