"""Figures for the workbench, made in the computing process: those of the report, of any stretch of any run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import ladder as usual_models
from bench.base import CHANNELS, BoolArray, FloatArray, InputError, finite, listed, number
from bench.deliver import (
    DIRECTIONS,
    HOUR_S,
    allan_figure,
    channels_figure,
    columns,
    compensation,
    described,
    floor_words,
    has_channel,
    loop_figure,
    measured_figure,
    over_temperature,
    residual_map,
    residuals_figure,
    side_by_side,
)
from bench.record import DEFAULT_INTERVAL_S, Dataset
from bench.web.workbench import computing
from bench.web.workbench.asking import ModelJson, model_json
from bench.web.workbench.computing import FINE_S, Run, Runs
from bench.web.workbench.zoom import View, view

WIDTH = 1000
"""Bins of a view that says nothing else: its pixels."""
_MOST_ROWS = 1800
Figure = dict[str, Any]


@dataclass(frozen=True)
class Wish:
    """What is to be drawn."""

    runs: Runs
    check: Runs
    static: Run | None
    of: Run
    """The run that is drawn; the model is fitted to all `runs`."""
    model: str | None
    name: str
    span_s: tuple[float | None, float | None]
    span_degc: tuple[float | None, float | None]
    width: int

    @classmethod
    def read(cls, wanted: Mapping[str, Any]) -> Wish:
        """From a request."""
        model, runs = wanted["model"], computing.runs_of(wanted["runs"])
        return cls(
            runs=runs,
            check=computing.runs_of(wanted["check"]),
            static=computing.static_of(wanted),
            of=computing.runs_of([wanted["of"]])[0] if wanted.get("of") else runs[0],
            model=None if model is None else computing.model_text(model),
            name="" if model is None else str(model["name"]),
            span_s=(wanted.get("from_s"), wanted.get("to_s")),
            span_degc=(wanted.get("from_degc"), wanted.get("to_degc")),
            width=int(wanted.get("width") or WIDTH),
        )

    def data(self, interval_s: float = DEFAULT_INTERVAL_S) -> Dataset:
        """Means of the run that is drawn."""
        return computing.dataset(self.of, interval_s)

    def fitted(self, interval_s: float = DEFAULT_INTERVAL_S) -> FloatArray:
        """The model on them (n,) [deg/h]; InputError without a model."""
        if self.model is None:
            raise InputError("this figure needs a model: choose one")
        computing.refuse_mixed(self.runs)
        return computing.predicted(self.runs, self.model, self.of, interval_s)

    def floor_dph(self, interval_s: float = DEFAULT_INTERVAL_S) -> float:
        """Noise floor of such means of the run that is drawn; NaN where it is not known."""
        found = computing.floor(self.runs, self.static)
        if interval_s == DEFAULT_INTERVAL_S or found.noise is None:
            return found.floor_dph
        if interval_s < FINE_S:  # only white noise is as fast
            return found.noise.white / float(np.sqrt(interval_s / HOUR_S))
        return found.noise.std_of_means(interval_s, float(np.ptp(self.data().time)))


def draw(wanted: dict[str, Any]) -> Figure:
    """The figure of a request with its words and its table."""
    return FIGURES[wanted["kind"]](Wish.read(wanted))


def time(wish: Wish) -> Figure:
    """Model against measurement over time, or only the measurement; as fine as the stretch allows."""
    fitted = None if wish.model is None else wish.fitted(FINE_S)
    shown = view(wish.data(FINE_S), Path(wish.of.path) / "data.parquet", wish.span_s, wish.width, fitted)
    data, extremes = shown.dataset(wish.of.id), (shown.low, shown.high)
    # The floor of means over the same time.
    floor_dph = float("nan") if fitted is None else wish.floor_dph(shown.interval_s)
    if shown.fitted is None:
        plot = measured_figure(data, extremes)
    else:
        plot = compensation(data, shown.fitted, wish.name, finite(floor_dph), extremes)
    table = columns({
        "time [s]": shown.time, "bias [deg/h]": shown.bias, "lowest [deg/h]": shown.low, "highest [deg/h]": shown.high,
        "model [deg/h]": shown.fitted, "temperature [degC]": shown.temperature,
    })  # fmt: skip
    facts = {"from_s": float(shown.time[0]), "to_s": float(shown.time[-1]), "interval_s": shown.interval_s}
    return {**described(plot, _time_words(wish, shown, floor_dph), table), **facts, "of": shown.of}


def _time_words(wish: Wish, shown: View, floor_dph: float) -> str:
    ends = [f"{t / 3600:.2f} h" if np.ptp(shown.time) > 600 else f"{t:.3f} s" for t in shown.time[[0, -1]].tolist()]
    words = (
        f"Run {wish.of.id} from {ends[0]} to {ends[1]} in means over {number(shown.interval_s)} s: bias "
        f"{_range(shown.bias)} deg/h, temperature {_range(shown.temperature)} °C; the band spans lowest and highest of "
        f"the {shown.of}, {_range(np.concatenate([shown.low, shown.high]))} deg/h."
    )
    if shown.fitted is None:
        return words
    left = shown.bias - shown.fitted
    worst = int(np.nanargmax(np.abs(left))) if np.any(np.isfinite(left)) else 0
    return (
        f"{words} Model {wish.name} leaves {_rms(left)} deg/h RMS, most at {shown.time[worst]:.0f} s: "
        f"{number(float(left[worst]))} deg/h. {floor_words(floor_dph)}"
    )


def temperature(wish: Wish) -> Figure:
    """Model against measurement over temperature; without a model the runs side by side."""
    if wish.model is None:
        return _side_by_side(wish)
    data, shown = wish.data(), None
    for interval_s in _intervals(wish):
        data = wish.data(interval_s)
        shown = _inside(data, wish)
        if shown.sum() >= min(wish.width, _MOST_ROWS) / 2:
            break
    if shown is None or not shown.any():
        raise InputError(f"{wish.of.id}: nothing was captured in this range of temperature and time")
    fitted = wish.fitted(data.interval_s)
    floor_dph = wish.floor_dph(data.interval_s)
    plot = over_temperature(data, fitted, wish.name, finite(floor_dph), shown)
    left = data.bias - fitted
    told = []
    for sign, (text, _) in DIRECTIONS.items():
        own = shown & (data.direction == sign) & np.isfinite(left)
        if own.any():
            told.append(f"{text} {_rms(left[own])} RMS about a mean of {number(float(left[own].mean()))}")
    words = (
        f"Run {wish.of.id} over {_range(data.channel('temperature')[shown])} °C in means over "
        f"{data.interval_s:g} s; model {wish.name} leaves, in deg/h: {'; '.join(told)}. {floor_words(floor_dph)}"
    )
    table = columns({
        "time [s]": data.time[shown], "temperature [degC]": data.channel("temperature")[shown],
        "dT/dt [degC/min]": data.dT_dt[shown], "bias [deg/h]": data.bias[shown], "model [deg/h]": fitted[shown],
    })  # fmt: skip
    return {**described(plot, words, table), "interval_s": data.interval_s}


def _intervals(wish: Wish) -> tuple[float, ...]:
    """Means to try, coarsest first: a narrow range is worth finer ones."""
    narrow = any(end is not None for end in (*wish.span_degc, *wish.span_s))
    return (DEFAULT_INTERVAL_S, 10.0, 3.0, FINE_S) if narrow else (DEFAULT_INTERVAL_S,)


def _inside(data: Dataset, wish: Wish) -> BoolArray:
    low, high = (np.inf * sign if end is None else end for end, sign in zip(wish.span_degc, (-1, 1), strict=True))
    begin, end = (np.inf * sign if t is None else t for t, sign in zip(wish.span_s, (-1, 1), strict=True))
    degc = data.channel("temperature")
    inside: BoolArray = (degc >= low) & (degc <= high) & (data.time >= begin) & (data.time <= end)
    return inside


def _side_by_side(wish: Wish) -> Figure:
    pairs = [(run.id, computing.dataset(run)) for run in dict.fromkeys((*wish.runs, *wish.check))]
    spans = [f"{name} {_range(data.bias - np.nanmean(data.bias))}" for name, data in pairs]
    words = f"Bias over temperature, each run less its own mean, in deg/h: {'; '.join(spans)}."
    return described(side_by_side(pairs), words)


def map_(wish: Wish) -> Figure:
    """Mean residual over temperature and its rate of change."""
    data = wish.data()
    left = data.bias - (wish.fitted() if wish.model else np.full(len(data), np.nanmean(data.bias)))
    floor_dph = wish.floor_dph()
    plot = residual_map(data, left, None, finite(floor_dph))
    what = f"what model {wish.name} leaves" if wish.model else "the bias less its mean"
    unit = "floors" if np.isfinite(floor_dph) else "deg/h"
    cells = [
        (z, x, y)
        for y, line in zip(plot["data"][0]["y"], plot["data"][0]["z"], strict=True)
        for x, z in zip(plot["data"][0]["x"], line, strict=True)
        if z is not None
    ]
    worst = max(cells, key=lambda cell: abs(cell[0]), default=(float("nan"),) * 3)
    words = (
        f"Mean of {what} in run {wish.of.id} by temperature and its rate of change; worst {number(worst[0])} {unit} at "
        f"{number(worst[1])} °C and {number(worst[2])} °C/min. {floor_words(floor_dph)}"
    )
    return described(plot, words)


def loop(wish: Wish) -> Figure:
    """Bias over temperature coloured by time; with a model, what it leaves."""
    data = wish.data()
    shown = _inside(data, wish)
    if not shown.any():
        raise InputError(f"{wish.of.id}: nothing was captured in this range of temperature and time")
    if wish.model is None:
        plot, values, what = loop_figure(data.select(shown)), data.bias[shown], "Bias"
    else:
        values = (data.bias - wish.fitted())[shown]
        plot = residuals_figure(data.select(shown), values, finite(wish.floor_dph()))
        what = f"What model {wish.name} leaves"
    table = columns({
        "time [s]": data.time[shown], "temperature [degC]": data.channel("temperature")[shown], "deg/h": values,
    })  # fmt: skip
    degc = _range(data.channel("temperature")[shown])
    words = f"{what} over temperature in run {wish.of.id}, in order of time: {_range(values)} deg/h over {degc} °C."
    return described(plot, words, table)


def allan(wish: Wish) -> Figure:
    """Allan deviation of what stands still, and the floor that it gives."""
    found = computing.floor(wish.runs, wish.static)
    if not found.curves:
        raise InputError(f"no Allan deviation: {found.reason}; name an isothermal run of the unit as the static run")
    plot = allan_figure(found.curves, found.noise)
    parts = [] if found.noise is None else [
        f"white {number(found.noise.white)} deg/√h", f"flicker {number(found.noise.flicker)} deg/h",
        f"random walk {number(found.noise.walk)} deg/h/√h",
    ]  # fmt: skip
    names = listed([name for name, _ in found.curves])
    words = f"Allan deviation of {names}: {', '.join(parts)}; for 30 s means: {floor_words(found.floor_dph)}"
    return described(plot, words)


def ladder(wish: Wish) -> Figure:
    """The usual models and the chosen one, in-sample and held out."""
    usual = [ModelJson(**model_json(model)).content() for model in usual_models()]
    texts = [computing.model_text(content) for content in usual if content["name"] != wish.name]
    texts += [wish.model] if wish.model else []
    computing.refuse_mixed([*wish.runs, *wish.check])
    parts = [computing.scored(wish.runs, wish.check, wish.static, text) for text in texts]
    scores = tuple(score for part in parts for score in part.scores)
    if not scores:
        raise InputError(parts[0].refused[0][1])
    return computing.ladder(replace(parts[0], scores=scores))


def channels(wish: Wish) -> Figure:
    """The other channels over temperature."""
    data = wish.data()
    plot = channels_figure(data)
    if plot is None:
        raise InputError(f"{wish.of.id} has no channel beside rate and temperature")
    names = [name for name in ("frequency", "drive", "quadrature", "supply") if has_channel(data, name)]
    spans = [f"{name} {_range(data.channels[name])}" for name in names]
    words = f"Channels of run {wish.of.id} over temperature, heating and cooling apart: {'; '.join(spans)}."
    table = columns({
        "temperature [degC]": data.channel("temperature"),
        **{f"{name} [{CHANNELS[name].unit}]": data.channels[name] for name in names},
    })  # fmt: skip
    return described(plot, words, table)


def _range(values: FloatArray) -> str:
    known = values[np.isfinite(values)]
    return f"{number(float(known.min()), 4)} to {number(float(known.max()), 4)}" if known.size else "–"


def _rms(values: FloatArray) -> str:
    known = values[np.isfinite(values)]
    return number(float(np.sqrt(np.mean(known**2)))) if known.size else "–"


FIGURES: Mapping[str, Callable[[Wish], Figure]] = {
    "time": time, "temperature": temperature, "map": map_, "loop": loop, "allan": allan, "ladder": ladder,
    "channels": channels,
}  # fmt: skip
