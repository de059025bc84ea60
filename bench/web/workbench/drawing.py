"""Figures for the workbench, made in the computing process: those of the report, for any part of any run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import Noise, error_of, undisturbed
from bench.analysis import ladder as usual_models
from bench.base import CHANNELS, BoolArray, FloatArray, InputError, finite
from bench.deliver import (
    DIRECTIONS,
    allan_figure,
    channels_figure,
    columns,
    compensation,
    coordinate_over,
    drawable_coordinates,
    further_channels,
    loop_figure,
    measured_figure,
    over_axis,
    over_temperature,
    overlaid,
    residual_map,
    residuals_figure,
    side_by_side,
    zeros_of,
)
from bench.record import DEFAULT_INTERVAL_S, Dataset
from bench.web.workbench import computing
from bench.web.workbench.asking import ModelJson, model_json
from bench.web.workbench.captions import Said, captioned, floor_said, said, span
from bench.web.workbench.computing import FINE_S, Run, Runs
from bench.web.workbench.zoom import View, view

WIDTH = 1000
"""Default number of bins of a view, as many as its pixels."""
_MOST_ROWS = 1800
Figure = dict[str, Any]


@dataclass(frozen=True)
class Drawing:
    """A figure to draw: runs, model and range."""

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
    over: str
    """Abscissa of `axes`."""
    every: bool
    """`axes` of all runs and check runs."""

    @classmethod
    def read(cls, inputs: Mapping[str, Any]) -> Drawing:
        """The figure of a request."""
        model, runs = inputs["model"], computing.runs_of(inputs["runs"])
        return cls(
            runs=runs,
            check=computing.runs_of(inputs["check"]),
            static=computing.static_of(inputs),
            of=computing.runs_of([inputs["of"]])[0] if inputs.get("of") else runs[0],
            model=None if model is None else computing.model_text(model),
            name="" if model is None else str(model["name"]),
            span_s=(inputs.get("from_s"), inputs.get("to_s")),
            span_degc=(inputs.get("from_degc"), inputs.get("to_degc")),
            width=int(inputs.get("width") or WIDTH),
            over=inputs["over"],
            every=inputs["every"],
        )

    def data(self, interval_s: float = DEFAULT_INTERVAL_S) -> Dataset:
        """Means of the drawn run."""
        return computing.dataset(self.of, interval_s)

    def fitted(self, interval_s: float = DEFAULT_INTERVAL_S) -> FloatArray:
        """The model for these means (n,) [deg/h]; InputError without a model."""
        if self.model is None:
            raise InputError("this figure needs a model: choose one")
        computing.refuse_mixed(self.runs)
        return computing.predicted(self.runs, self.model, self.of, interval_s)

    def floor_dph(self) -> float:
        """Noise floor of 30 s means, as every command says it, whatever is shown; NaN if it is unknown."""
        return computing.floor(self.runs, self.static).floor_dph

    def left(self) -> FloatArray:
        """Errors of the model (n,) in the whole drawn run in 30 s means [deg/h], NaN where it was disturbed."""
        return np.asarray(undisturbed(self.data()).bias - self.fitted())

    def rms_dph(self) -> float:
        """Error of the model in the whole drawn run in 30 s means, as `bench compare` counts it [deg/h]."""
        return error_of("run", (self.data(),), (self.left(),)).rms_dph


class EmptyRangeError(InputError):
    """The drawn run has nothing in the selected range: no other figure may stand for it."""


def draw(inputs: dict[str, Any]) -> Figure:
    """The figure of a request with its description and its table.

    Where the model cannot be fitted, the data alone are drawn, and `note` says why.
    """
    drawing, make = Drawing.read(inputs), FIGURES[inputs["kind"]]
    try:
        answer = make(drawing)
    except InputError as error:
        if isinstance(error, EmptyRangeError) or drawing.model is None or inputs["kind"] not in BARE:
            raise
        drawing = replace(drawing, model=None)
        answer = {**make(drawing), "note": str(error)}
    if over := {**RANGED, "axes": drawing.over}.get(inputs["kind"]):
        answer["figure"]["layout"]["meta"] = {"whole": _whole(drawing, over, inputs["kind"])}
    return answer


def _whole(drawing: Drawing, over: str, kind: str) -> list[float]:
    """First and last abscissa of the runs in a figure, of which a range may be drawn."""
    several = drawing.every or (kind == "temperature" and drawing.model is None)
    each = [computing.dataset(run) for run in ((*drawing.runs, *drawing.check) if several else (drawing.of,))]
    known = [coordinate_over(data, over).values for data in each if over in drawable_coordinates(data)]
    values = np.concatenate(known)
    return [float(np.nanmin(values)), float(np.nanmax(values))]


def time(drawing: Drawing) -> Figure:
    """Model and measurement over time, or only the measurement; the shorter the range, the finer."""
    fitted = None if drawing.model is None else drawing.fitted(FINE_S)
    shown = view(drawing.data(FINE_S), Path(drawing.of.path) / "data.parquet", drawing.span_s, drawing.width, fitted)
    data, extremes = shown.dataset(drawing.of.id), (shown.low, shown.high)
    floor_dph = float("nan") if fitted is None else drawing.floor_dph()
    if shown.fitted is None:
        plot = measured_figure(data, extremes)
    else:
        plot = compensation(data, shown.fitted, drawing.name, finite(floor_dph), extremes)
    table = columns({
        "time [s]": shown.time, "bias [deg/h]": shown.bias, "lowest [deg/h]": shown.low, "highest [deg/h]": shown.high,
        "model [deg/h]": shown.fitted, "temperature [degC]": shown.temperature,
    })  # fmt: skip
    facts = {"from_s": float(shown.time[0]), "to_s": float(shown.time[-1]), "interval_s": shown.interval_s}
    return {**captioned(plot, _time_caption(drawing, shown, floor_dph), table), **facts, "of": shown.of}


def _time_caption(drawing: Drawing, shown: View, floor_dph: float) -> list[Said]:
    hours = np.ptp(shown.time) > 600
    begin, end = (
        {"number": t / 3600, "decimals": 2} if hours else {"number": t, "decimals": 3}
        for t in shown.time[[0, -1]].tolist()
    )
    measured = said(
        "time_h" if hours else "time_s", run=drawing.of.id, begin=begin, end=end, interval=shown.interval_s,
        bias=span(shown.bias), temperature=span(shown.temperature),
        of=said("samples" if shown.of == "samples" else "means"), band=span(np.concatenate([shown.low, shown.high])),
    )  # fmt: skip
    if shown.fitted is None:
        return [measured]
    left = shown.bias - shown.fitted
    worst = int(np.nanargmax(np.abs(left))) if np.any(np.isfinite(left)) else 0
    residual = said(
        "time_residual", model=drawing.name, rms=drawing.rms_dph(),
        interval={"number": drawing.data().interval_s, "digits": 2}, largest=float(left[worst]),
        at={"number": float(shown.time[worst]) / (3600 if hours else 1), "decimals": 2 if hours else 1},
        unit={"unit": "h" if hours else "s"},
    )  # fmt: skip
    return [measured, residual, floor_said(floor_dph)]


def temperature(drawing: Drawing) -> Figure:
    """Model and measurement over temperature; without a model the runs side by side."""
    if drawing.model is None:
        return _side_by_side(drawing)
    data, shown = drawing.data(), None
    for interval_s in _intervals(drawing):
        data = drawing.data(interval_s)
        shown = _inside(data, drawing)
        if shown.sum() >= min(drawing.width, _MOST_ROWS) / 2:
            break
    if shown is None or not shown.any():
        raise EmptyRangeError(f"{drawing.of.id}: nothing was captured in this range of temperature and time")
    fitted = drawing.fitted(data.interval_s)
    floor_dph = drawing.floor_dph()
    plot = over_temperature(data, fitted, drawing.name, finite(floor_dph), shown)
    parts, whole, left = [], drawing.data(), drawing.left()
    for sign, (text, _) in DIRECTIONS.items():
        own = _inside(whole, drawing) & (whole.direction == sign) & np.isfinite(left)
        if own.any():
            rms, mean = float(np.sqrt(np.mean(left[own] ** 2))), float(left[own].mean())
            parts.append(said("direction", direction={"label": text}, rms=rms, mean=mean))
    caption = said(
        "temperature", run=drawing.of.id, temperature=span(data.channel("temperature")[shown]), model=drawing.name,
        interval={"number": data.interval_s, "digits": 2}, means={"number": drawing.data().interval_s, "digits": 2},
        parts=parts,
    )  # fmt: skip
    table = columns({
        "time [s]": data.time[shown], "temperature [degC]": data.channel("temperature")[shown],
        "dT/dt [degC/min]": data.dT_dt[shown], "bias [deg/h]": data.bias[shown], "model [deg/h]": fitted[shown],
    })  # fmt: skip
    return {**captioned(plot, [caption, floor_said(floor_dph)], table), "interval_s": data.interval_s}


def _intervals(drawing: Drawing) -> tuple[float, ...]:
    """Intervals of means to try, coarsest first: a narrow range needs finer ones."""
    narrow = any(end is not None for end in (*drawing.span_degc, *drawing.span_s))
    return (DEFAULT_INTERVAL_S, 10.0, 3.0, FINE_S) if narrow else (DEFAULT_INTERVAL_S,)


def _inside(data: Dataset, drawing: Drawing) -> BoolArray:
    low, high = (np.inf * sign if end is None else end for end, sign in zip(drawing.span_degc, (-1, 1), strict=True))
    begin, end = (np.inf * sign if t is None else t for t, sign in zip(drawing.span_s, (-1, 1), strict=True))
    degc = data.channel("temperature")
    inside: BoolArray = (degc >= low) & (degc <= high) & (data.time >= begin) & (data.time <= end)
    return inside


def _side_by_side(drawing: Drawing) -> Figure:
    pairs = [(run.id, computing.dataset(run)) for run in dict.fromkeys((*drawing.runs, *drawing.check))]
    zeros = zeros_of([data for _, data in pairs])
    spans = [
        said("of", name=name, span=span(data.bias - zero)) for (name, data), zero in zip(pairs, zeros, strict=True)
    ]
    rows = [
        [name, *row]
        for (name, data), zero in zip(pairs, zeros, strict=True)
        for row in columns({"t": data.time, "x": data.channel("temperature"), "y": data.bias - zero})[1:]
    ]
    table = [["run", "time [s]", "temperature [degC]", "bias [deg/h], minus its mean"], *rows]
    return captioned(side_by_side(pairs), [said("side_by_side", spans=spans)], table)


def map_(drawing: Drawing) -> Figure:
    """Mean residual over temperature and its rate of change."""
    data = drawing.data()
    left = drawing.left() if drawing.model else data.bias - np.nanmean(data.bias)
    floor_dph = drawing.floor_dph()
    plot = residual_map(data, left, None, finite(floor_dph))
    what = said("map_residual", model=drawing.name) if drawing.model else said("map_bias")
    unit = "floors" if np.isfinite(floor_dph) else "dph"
    cells = [
        (z, x, y)
        for y, line in zip(plot["data"][0]["y"], plot["data"][0]["z"], strict=True)
        for x, z in zip(plot["data"][0]["x"], line, strict=True)
        if z is not None
    ]
    worst = max(cells, key=lambda cell: abs(cell[0]), default=(float("nan"),) * 3)
    z, degc, slope = (float(at) for at in worst)
    caption = said(f"map_{unit}", what=what, run=drawing.of.id, worst=z, temperature=degc, slope=slope)
    return captioned(plot, [caption, floor_said(floor_dph)])


def loop(drawing: Drawing) -> Figure:
    """Bias over temperature coloured by time; with a model, its residual."""
    data = drawing.data()
    shown = _inside(data, drawing)
    if not shown.any():
        raise EmptyRangeError(f"{drawing.of.id}: nothing was captured in this range of temperature and time")
    if drawing.model is None:
        plot, values, what = loop_figure(data.select(shown)), data.bias[shown], said("bias")
    else:
        values = (data.bias - drawing.fitted())[shown]
        plot = residuals_figure(data.select(shown), values, finite(drawing.floor_dph()))
        what = said("residual", model=drawing.name)
    table = columns({
        "time [s]": data.time[shown], "temperature [degC]": data.channel("temperature")[shown], "deg/h": values,
    })  # fmt: skip
    degc = span(data.channel("temperature")[shown])
    caption = said("loop", what=what, run=drawing.of.id, values=span(values), temperature=degc)
    return captioned(plot, [caption], table)


def axes(drawing: Drawing) -> Figure:
    """Residual, or without a model the bias, over any quantity of the run."""
    data = drawing.data()
    known = sorted(drawable_coordinates(data) - {"rate"})
    if drawing.over not in known:
        raise InputError(f"{drawing.of.id} has no channel '{drawing.over}': choose one of {', '.join(known)}")
    if drawing.every:
        return {**_axes_of_all(drawing), "axes": known}
    x, fitted = coordinate_over(data, drawing.over), drawing.model is not None
    shown = _inside(data, drawing) & np.isfinite(x.values)
    if not shown.any():
        raise EmptyRangeError(f"{drawing.of.id}: nothing was captured in this range of temperature and time")
    data, x = data.select(shown), replace(x, values=x.values[shown])
    y = data.bias - drawing.fitted()[shown] if fitted else data.bias
    floor_dph = drawing.floor_dph()
    what = "residual" if fitted else "bias"
    caption = said(
        "axes", what=said("residual", model=drawing.name) if fitted else said("bias"), over={"label": x.title},
        run=drawing.of.id, values=span(y), range=span(x.values), interval={"number": data.interval_s, "digits": 2},
    )  # fmt: skip
    plot = over_axis(data, x, y, finite(floor_dph), fitted)
    table = columns({"time [s]": data.time, x.title: x.values, f"{what} [deg/h]": y})
    return {**captioned(plot, [caption, floor_said(floor_dph)], table), "axes": known}


def _axes_of_all(drawing: Drawing) -> Figure:
    """Residuals, or without a model biases on one zero, of all runs that have the quantity, in one figure."""
    each = [replace(drawing, of=run) for run in dict.fromkeys((*drawing.runs, *drawing.check))]
    own = [one for one in each if drawing.over in drawable_coordinates(one.data())]
    zeros = [0.0] * len(own) if drawing.model else zeros_of([one.data() for one in own])
    values, spans, rows = [], [], []
    for one, zero in zip(own, zeros, strict=True):
        data = one.data()
        x, y = coordinate_over(data, drawing.over), data.bias - (one.fitted() if drawing.model else zero)
        shown = _inside(data, one) & np.isfinite(x.values)
        if shown.any():
            values.append((one.of.id, x.values[shown], y[shown]))
            spans.append(said("of", name=one.of.id, span=span(y[shown])))
            _, *cells = columns({"time": data.time[shown], "x": x.values[shown], "y": y[shown]})
            rows += [[one.of.id, *row] for row in cells]
    if not values:
        raise EmptyRangeError("nothing was captured in this range of temperature and time")
    what = said("residual", model=drawing.name) if drawing.model else said("bias")
    drawn = {id_ for id_, *_ in values}
    left_out = [one.of.id for one in each if one.of.id not in drawn]
    told = [said("axes_all", what=what, over={"label": x.title}, spans=spans)]
    told += [said("left_out", runs=left_out)] if left_out else []
    title = "residual [deg/h]" if drawing.model else "bias [deg/h], minus its mean"
    table = [["run", "time [s]", x.title, title], *rows]
    return captioned(overlaid(values, x.title, title), [*told, floor_said(drawing.floor_dph())], table)


def allan(drawing: Drawing) -> Figure:
    """Allan deviation of the isothermal data, and the noise floor from it."""
    floor = computing.floor(drawing.runs, drawing.static, intervals=True)
    if not floor.curves:
        raise InputError(f"no Allan deviation: {floor.reason}; name an isothermal run of the unit as the static run")
    plot = allan_figure(floor.curves, floor.noise)
    sizes = ("white", "flicker", "walk")
    parts = [] if floor.noise is None else [said("noise", **{name: _size(floor.noise, name) for name in sizes})]
    caption = said("allan", names=[name for name, _ in floor.curves])
    return captioned(plot, [caption, *parts, floor_said(floor.floor_dph)])


def _size(noise: Noise, name: str) -> float | Said:
    """A coefficient of the noise; where the data cannot tell it from zero, what it is below, as the report says it."""
    if name not in noise.undetermined:
        return float(getattr(noise, name))
    return said("below", value=noise.intervals.get(name, (np.nan, np.nan))[1])


def ladder(drawing: Drawing) -> Figure:
    """The usual models and the chosen one, in-sample and held out."""
    usual = [ModelJson(**model_json(model)).content() for model in usual_models()]
    texts = [computing.model_text(content) for content in usual if content["name"] != drawing.name]
    texts += [drawing.model] if drawing.model else []
    computing.refuse_mixed([*drawing.runs, *drawing.check])
    parts = [computing.scored(drawing.runs, drawing.check, drawing.static, text) for text in texts]
    scores = tuple(score for part in parts for score in part.scores)
    if not scores:
        raise InputError(parts[0].refused[0][1])
    return computing.ladder(replace(parts[0], scores=scores))


def channels(drawing: Drawing) -> Figure:
    """The other channels over temperature."""
    data = drawing.data()
    plot = channels_figure(data)
    if plot is None:
        raise InputError("this run has no channels other than rate and temperature")
    names = further_channels(data)
    spans = [
        said("of", name={"label": f"{name} [{CHANNELS[name].unit}]"}, span=span(data.channels[name])) for name in names
    ]
    caption = said("channels", run=drawing.of.id, spans=spans)
    table = columns({
        "temperature [degC]": data.channel("temperature"),
        **{f"{name} [{CHANNELS[name].unit}]": data.channels[name] for name in names},
    })  # fmt: skip
    return captioned(plot, [caption], table)


BARE = {"time", "temperature", "map", "loop", "axes"}
"""Figures that there are without a model, too."""
RANGED = {"time": "time", "temperature": "temperature", "loop": "temperature"}
"""Figures of which a range of x may be drawn, and their abscissae."""
FIGURES: Mapping[str, Callable[[Drawing], Figure]] = {
    "time": time, "temperature": temperature, "map": map_, "loop": loop, "axes": axes, "allan": allan, "ladder": ladder,
    "channels": channels,
}  # fmt: skip
