"""Conversion of a fit to a delivery: each effect becomes signals and blocks of docs/eeprom.md.

Every part of a model without memory is a polynomial or a smooth curve of one or two channels. It is sampled over the
range in which the unit evaluates it and expanded in Chebyshev polynomials, so that formulas are not duplicated.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import Effect, Fit, Model, Theta, load_model, model_files, options_of
from bench.base import DPH_PER_DPS, BenchError, FloatArray, InputError
from bench.deliver.export import chebyshev
from bench.deliver.export.delivery import (
    INPUTS,
    MOST_BLOCKS,
    MOST_ORDER,
    MOST_SIGNALS,
    Block,
    Delivery,
    Kind,
    Shape,
    Signal,
)
from bench.deliver.export.exact import value_of
from bench.deliver.export.inverse import over_output, static_over
from bench.deliver.export.parts import Part, UndeliverableError, channels_of, parts_of
from bench.deliver.export.signals import box_of, channel_signal, lag_signal, parabola_signal, play_signal
from bench.record import Dataset

_SAME = 5e-3
"""A block holds a formula that it follows to this share of the greatest value."""
_EXACT = 2e-5
"""Share to which more pieces, or a higher order, are of no use."""
_FEWER_PIECES = (5, 10, 20, 50, 100)
"""Numbers of pieces that are tried for a formula of one channel before the most."""
_LOOKED_AT = {Shape.SPLINE: 2003, Shape.SURFACE: 61}
"""Points on each axis where that is looked at."""
STATIC = {"polynomial", "regression", "spline", "surface"}


def deliver(fit: Fit, datasets: Sequence[Dataset], sample_hz: float = 500.0) -> Delivery:
    """The model of `fit` as the unit evaluates it at its sample rate; `datasets` are the runs it was fitted to.

    Raises InputError, one line, for an effect that a unit cannot evaluate (it needs a clock, the chamber, later data).
    """
    refuse_undeliverable(fit.model, fit.bound.effects)
    builder = _Builder(fit, tuple(datasets), sample_hz)
    for key, effect in zip(fit.bound.keys, fit.bound.effects, strict=True):
        if effect.moves_abscissa:
            builder.move(key, effect)
    pairs = [(k, e) for k, e in zip(fit.bound.keys, fit.bound.effects, strict=True) if not e.moves_abscissa]
    turning = [pair for pair in pairs if "applied_rate" in channels_of(pair[1])]
    for key, effect in pairs:
        if (key, effect) not in turning:
            builder.add(key, effect)
    if turning:
        builder.add_turning(turning)
    return builder.finished()


def refuse_undeliverable(
    model: Model, effects: Sequence[Effect] | None = None, channels: Collection[str] | None = None
) -> None:
    """InputError, one line, for a model (of which these `effects` are left) that no unit can evaluate, on any data.

    `channels` are those of the unit that is to evaluate it; None: it has every one that a unit may have.
    """
    if model.rows.startswith("soaks"):
        raise InputError(f"model '{model.name}' is a baseline fitted to soaks only; deliver one fitted to all rows")
    for effect in model.effects if effects is None else effects:
        if lacking := [name for name in effect.needs if channels is not None and name in {*INPUTS} - {*channels}]:
            why = f"this unit has no channel {', '.join(lacking)}"
            raise UndeliverableError(effect.name, why)
        if effect.moves_abscissa:
            if effect.name != "resonance_frequency" and (effect.name != "thermal_lag" or options_of(effect)):
                raise InputError(
                    f"{effect.name}: a unit cannot evaluate this effect; leave it out of the delivered model"
                )
        elif effect.name == "hysteresis":
            if getattr(effect, "shape", "") != "play":
                raise InputError(
                    "hysteresis: shape bouc_wen needs an exponential at each step, which the image cannot contain; fit "
                    "shape play (count 3 to 5 follows a smooth loop)"
                )
        elif effect.name in {"temperature_rate", "creep"}:
            _refuse_behind(effect)
        else:
            parts_of(effect)


def undeliverable(model: Model, project: Path = Path(), channels: Collection[str] | None = None) -> str:
    """Why no unit, or none with these `channels`, can evaluate a model, with the named models that one can at rest;
    empty where one can.
    """
    try:
        refuse_undeliverable(model, channels=channels)
    except InputError as error:
        return f"{error}; models that a unit can hold: {', '.join(_deliverable(project, channels)) or 'none'}"
    return ""


def unheld(model: Model, effects: Sequence[Effect], channels: Collection[str]) -> str:
    """Why no unit with these `channels` can evaluate these `effects` of a model; empty where one can."""
    try:
        refuse_undeliverable(model, effects, channels)
    except UndeliverableError as error:
        return error.why
    except InputError as error:
        return str(error)
    return ""


def _deliverable(project: Path, channels: Collection[str] | None) -> Iterator[str]:
    for name, path in model_files(project).items():
        with contextlib.suppress(BenchError):  # who names a broken one is told why it cannot be read
            model = load_model(path)
            refuse_undeliverable(model, channels=channels)
            if not any("applied_rate" in effect.needs for effect in model.effects):
                yield name


@dataclass
class _Builder:
    """The signals and blocks so far; `moved` are the runs with the temperature that the terms use."""

    fit: Fit
    moved: tuple[Dataset, ...]
    sample_hz: float
    signals: list[Signal] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    boxes: list[tuple[float, float]] = field(default_factory=list)
    named: dict[str, int] = field(default_factory=dict)

    @property
    def period_s(self) -> float:
        return 1.0 / self.sample_hz

    def signal(self, channel: str) -> int:
        """Number of the signal of a channel; the first call for a channel makes the signal."""
        if channel not in self.named:
            low, high = self._range(channel)
            made = channel_signal(channel, low, high)
            self.named[channel] = self._append(made, box_of(made, channel))
        return self.named[channel]

    def move(self, key: str, effect: Effect) -> None:
        """Replace the temperature that all later terms use."""
        theta = self.fit.bound.theta[key]
        if effect.name == "thermal_lag":
            source = self.signal("temperature")
            self._advance(effect, theta)
            box = self._range("temperature")
            made = lag_signal(source, self.boxes[source], box, theta["tau_s"], self.period_s)
        else:
            source = self.signal("frequency")
            self._advance(effect, theta)
            box = self._range("temperature")
            low, high = self.boxes[source]
            made = parabola_signal(
                source, chebyshev.series(lambda f: self._abscissa(effect, theta, f), low, high, 2), box
            )
        self.named["temperature"] = self._append(made, box)

    def _abscissa(self, effect: Effect, theta: Theta, frequency: FloatArray) -> FloatArray:
        return effect.abscissa(record(frequency=frequency, temperature=np.zeros_like(frequency)), theta)

    def _advance(self, effect: Effect, theta: Theta) -> None:
        self.moved = tuple(r.with_channel("temperature", effect.abscissa(r, theta)) for r in self.moved)

    def add(self, key: str, effect: Effect) -> None:
        """Blocks of an effect that does not need the table's rate."""
        theta, amplitudes = self.fit.bound.theta[key], self.fit.beta[self.fit.bound.slices[key]]
        if effect.name == "hysteresis":
            self._loops(effect, theta, amplitudes)
        elif effect.name in {"temperature_rate", "creep"}:
            self._behind(effect, theta, amplitudes)
        else:
            for i, part in enumerate(parts_of(effect)):
                self._static(effect, theta, amplitudes, part, first=i == 0)

    def _static(self, effect: Effect, theta: Theta, amplitudes: FloatArray, part: Part, first: bool) -> None:
        if part.terms:
            amplitudes = np.where(np.isin(np.arange(amplitudes.size), part.terms), amplitudes, 0.0)
        centres = {channel: 0.5 * sum(self.boxes[self.signal(channel)]) for channel in channels_of(effect)}
        still = 0.0 if first or part.terms else float(_value(effect, theta, amplitudes, centres)[0])

        def value(*at: FloatArray) -> FloatArray:
            points = {**centres, **dict(zip(part.channels, at, strict=True))}
            return _value(effect, theta, amplitudes, points) - still

        if part.terms:
            self._least(part, value)
        else:
            self._expanded(part, value, part.n)

    def _expanded(self, part: Part, value: chebyshev.Curve, n: int) -> None:
        """The block of a part with so many pieces, or of this order."""
        numbers = [self.signal(channel) for channel in part.channels]
        boxes = [self.boxes[number] for number in numbers]
        if part.shape is Shape.SURFACE:
            coefficients = chebyshev.surface(value, *boxes[0], *boxes[1], n)
        elif part.shape is Shape.SPLINE:
            coefficients = chebyshev.pieces(value, *boxes[0], n)
        else:
            coefficients = chebyshev.series(value, *boxes[0], n)
        self._block(part.shape, numbers, n, coefficients)

    def _least(self, part: Part, value: chebyshev.Curve) -> None:
        """The smallest block that follows the terms of a formula, also between its own points, for a unit's memory is
        small; InputError where none does.
        """
        numbers = [self.signal(channel) for channel in part.channels]
        axis = np.linspace(-1.0, 1.0, _LOOKED_AT[part.shape])
        z = np.zeros((len(self.signals), axis.size ** len(numbers)))
        z[numbers] = [one.ravel() for one in np.meshgrid(*[axis] * len(numbers))]
        boxes = [self.boxes[number] for number in numbers]
        wanted = value(
            *(0.5 * (low + high) + 0.5 * (high - low) * z[n] for n, (low, high) in zip(numbers, boxes, strict=True))
        )
        most = float(np.max(np.abs(wanted)))
        for n in (*_FEWER_PIECES, part.n) if part.shape is Shape.SPLINE else range(1, part.n + 1):
            self._expanded(part, value, n)
            off = float(np.max(np.abs(DPH_PER_DPS * value_of(self.blocks[-1], z) - wanted)))
            if off <= (_SAME if n == part.n else _EXACT) * most:
                return
            self.blocks.pop()
        terms = f"the terms of {', '.join(part.channels)}, which change too fast for it"
        raise UndeliverableError("expression", f"the image is up to {off:.2g} deg/h from {terms}")

    def _loops(self, effect: Effect, theta: Theta, amplitudes: FloatArray) -> None:
        source = self.signal("temperature")
        low, high = self.boxes[source]
        for i, amplitude in enumerate(amplitudes):
            width = theta["width_degc"] * (i + 1) / amplitudes.size
            made = play_signal(source, width / (0.5 * (high - low)))
            self._block(Shape.SERIES, [self._append(made, (-width, width))], 1, np.array([0.0, amplitude]))

    def _behind(self, effect: Effect, theta: Theta, amplitudes: FloatArray) -> None:
        """Terms in the difference from a filtered temperature: creep, and a filtered temperature rate."""
        tau_s, per_degc = _behind_of(effect, theta)
        source = self.signal("temperature")
        values = np.concatenate([effect.columns(r, theta)[:, 0] for r in self.moved]) / per_degc
        extent = 1.05 * float(np.nanmax(np.abs(values)))
        made = lag_signal(source, self.boxes[source], (-extent, extent), tau_s, self.period_s, behind=True)
        number = self._append(made, (-extent, extent))
        slope = amplitudes[0] * per_degc * extent
        if amplitudes.size == 1:
            self._block(Shape.SERIES, [number], 1, np.array([0.0, slope]))
            return
        low, high = self.boxes[source]
        product = amplitudes[1] * per_degc * extent
        middle, half = 0.5 * (low + high) - 25.0, 0.5 * (high - low)
        coefficients = np.array([0.0, slope + product * middle, 0.0, 0.0, product * half, 0.0])
        self._block(Shape.SURFACE, [number, source], 2, coefficients)

    def add_turning(self, pairs: Sequence[tuple[str, Effect]]) -> None:
        """One surface over the unit's output for all effects over the table's rate, which a unit cannot measure."""
        own, order = self.fit.bound, max(part.n for _, effect in pairs for part in parts_of(effect))
        temperature, output = self.signal("temperature"), self.signal("rate")

        def turning(rate: FloatArray, degc: FloatArray) -> FloatArray:
            at = {"applied_rate": rate, "temperature": degc}
            added = (_value(e, own.theta[k], self.fit.beta[own.slices[k]], at) for k, e in pairs)
            return sum(added, np.zeros(rate.size))

        # The polynomial itself: the effects' tangents outside the table's rates have a corner where the output ends.
        rates, degrees = self._range("applied_rate"), self.boxes[temperature]
        smooth = chebyshev.polynomial(chebyshev.surface(turning, *rates, *degrees, order), rates, degrees)
        settled = replace(self._delivery(), blocks=tuple(self.blocks))
        settled_dph = static_over(settled, temperature, self.boxes[temperature], float(self.fit.beta[0]))
        order, coefficients = over_output(smooth, settled_dph, self.boxes[output], self.boxes[temperature], MOST_ORDER)
        self._block(Shape.SURFACE, [output, temperature], order, coefficients)

    def finished(self) -> Delivery:
        """The delivery, the constant in its first block."""
        if not self.blocks:
            self._block(Shape.SERIES, [self.signal("temperature")], 0, np.zeros(1))
        first = self.blocks[0]
        step = 4 if first.shape is Shape.SPLINE else first.coefficients.size
        constant = np.zeros(first.coefficients.size)
        constant[::step] = self.fit.beta[0] / DPH_PER_DPS
        self.blocks[0] = replace(first, coefficients=first.coefficients + constant)
        if len(self.signals) > MOST_SIGNALS or len(self.blocks) > MOST_BLOCKS:
            raise InputError(
                f"model '{self.fit.model.name}' needs {len(self.signals)} signals and {len(self.blocks)} blocks, the "
                f"image holds {MOST_SIGNALS} and {MOST_BLOCKS}; fewer loops or effects are needed"
            )
        return self._delivery()

    def _delivery(self) -> Delivery:
        names = {effect.name for effect in self.fit.model.effects}
        only = next(iter(names)) if len(names) == 1 and names <= STATIC else "composed"
        filters = any(signal.kind in {Kind.LAG, Kind.BEHIND} for signal in self.signals)
        period_ns = round(1e9 * self.period_s) if filters else 0
        return Delivery(only, tuple(self.signals), tuple(self.blocks), period_ns=period_ns)

    def _block(self, shape: Shape, numbers: Sequence[int], n: int, coefficients: FloatArray) -> None:
        b = numbers[1] if len(numbers) > 1 else 0
        self.blocks.append(Block(shape, numbers[0], b, n, coefficients / DPH_PER_DPS))

    def _append(self, signal: Signal, box: tuple[float, float]) -> int:
        self.signals.append(signal)
        self.boxes.append(box)
        return len(self.signals) - 1

    def _range(self, channel: str) -> tuple[float, float]:
        """Range of a channel over the fitted rows, after `move`."""
        pairs = zip(self.moved, self.fit.residuals, strict=True)
        rows = np.concatenate([r.channel(channel)[np.isfinite(left)] for r, left in pairs])
        return float(np.nanmin(rows)), float(np.nanmax(rows))


def _refuse_behind(effect: Effect) -> None:
    """InputError for an option of such an effect with which it is no difference from a filtered temperature."""
    if effect.name == "creep" and getattr(effect, "initial", "settled") != "settled":
        raise InputError("creep: a free initial state is specific to one run; fit `initial: settled`")
    if effect.name == "temperature_rate" and not getattr(effect, "filter_s", 0.0):
        raise InputError(
            "temperature_rate: its central slope needs data of the next half minute, which a unit does not have; "
            "fit it with filter_s: 30"
        )


def _behind_of(effect: Effect, theta: Theta) -> tuple[float, float]:
    """Time constant [s] and the column's value per degC that the filter is above the temperature."""
    if effect.name == "creep":
        return 3600.0 * theta["tau_h"], 1.0
    filter_s = float(getattr(effect, "filter_s", 0.0))
    return filter_s, -60.0 / filter_s


def record(**channels: FloatArray) -> Dataset:
    """Points as rows of a record, one per second: for effects without memory."""
    size = max(np.size(values) for values in channels.values())
    full = {
        name: np.broadcast_to(np.asarray(values, dtype=np.float64), size).copy() for name, values in channels.items()
    }
    time: FloatArray = np.arange(size, dtype=np.float64)
    return Dataset("points", time, {"rate": np.zeros(size), **full}, np.zeros(size, dtype=np.int64))


def _value(effect: Effect, theta: Theta, amplitudes: FloatArray, at: Mapping[str, Any]) -> FloatArray:
    """Contribution of the effect at these points (n,) [deg/h]."""
    points = record(**{name: np.atleast_1d(np.asarray(values)) for name, values in at.items()})
    added: FloatArray = effect.columns(points, theta) @ amplitudes
    return added
