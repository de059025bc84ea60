"""A model fitted to runs: coefficients with their uncertainties, predictions, errors beside the noise floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from bench import analysis, deliver
from bench.analysis import Coefficient, Effect, HeldOut, Model, Prediction, Score
from bench.analysis import Fit as Estimate
from bench.api.models import ModelLike, add, fitted_model
from bench.api.runs import Over, Run, Runs, floor_of, several
from bench.api.words import errors_text, figure, html, text_table
from bench.base import CHANNELS, InputError, ends, finite, in_print, with_uncertainty
from bench.record import Dataset, refuse_mixed

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from bench.analysis import Floor

_MOST = 24
"""Coefficients that a summary shows."""


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A model fitted to one run or several of one unit; `Run.fit` and `bench.fit` make it."""

    estimate: Estimate
    """Everything that the fit found: scaled amplitudes, covariance, noise, condition, residuals."""
    runs: tuple[Run, ...]
    check: tuple[Run, ...] = ()
    static: Run | None = None
    _scored: Score | None = None

    @property
    def model(self) -> Model:
        """The model, its automatic options settled."""
        return self.estimate.model

    @property
    def rms_dph(self) -> float:
        """Error in the fitted rows [deg/h]; it proves nothing alone, see `held_out` and `floor`."""
        return self.estimate.rms_dph

    @property
    def validity(self) -> Mapping[str, tuple[float, float]]:
        """Range of each channel that the model was fitted over, in the channel's unit."""
        return self.estimate.validity

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is to be known before the numbers are used."""
        return self.estimate.warnings

    @cached_property
    def coefficients(self) -> Mapping[str, Coefficient]:
        """Coefficients, then nonlinear parameters, by effect.name: each with `value`, `std` and `unit`.

        `std` is one standard deviation under the coloured noise that the fit found.
        """
        units = {
            f"{key}.{parameter.name}": parameter.unit
            for key, effect in zip(self.model.keys, self.model.effects, strict=True)
            for parameter in effect.parameters
        }
        std = self.estimate.theta_std
        further = [Coefficient(key, units[key], value, std[key]) for key, value in self.estimate.theta.items()]
        return MappingProxyType({c.key: c for c in (*self.estimate.coefficients, *further)})

    @cached_property
    def floor(self) -> Floor:
        """Noise floor of the means that were fitted, see `Run.floor`."""
        return floor_of(self.runs, self.static)

    @cached_property
    def score(self) -> Score:
        """The same model as `bench.compare` scores it: on blocks and segments left out, and segment by segment."""
        if self._scored is not None:
            return self._scored
        datasets, checks = [run.dataset for run in self.runs], [run.dataset for run in self.check]
        return analysis.compare(datasets, [self.model], self.floor.floor_dph, checks or None).scores[0]

    @property
    def held_out(self) -> HeldOut:
        """Error on rows that the fit did not see: of the check runs, without them of blocks left out in turn."""
        return self.score.held_out

    def predict(
        self,
        of: Run | pd.DataFrame | None = None,
        /,
        *,
        time: npt.ArrayLike | None = None,
        **channels: npt.ArrayLike,
    ) -> Prediction:
        """Modelled bias [deg/h] of a run, of a DataFrame in the bench's channels and units, or of channels (n,).

        `fit.predict(temperature=[-40.0, 25.0, 85.0])` is enough for a model of temperature alone. A model with memory
        (a lag, hysteresis, ageing) depends on the course of time and needs `time` [s], too. The answer has `bias` (n,),
        its standard deviation `std` (n,), and `out_of_range` (n,), true where a channel is outside the fitted range.

        Raises InputError: a channel that the model needs is missing, or time where it is needed.
        """
        if isinstance(of, Run):
            return self.estimate.predict(of.dataset)
        given = dict(channels)
        if of is not None:
            given = {str(name): of[name].to_numpy() for name in of.columns if name in CHANNELS} | given
            if time is None:
                time = given.get("time", of.index.to_numpy() if of.index.name == "time" else None)
        given.pop("time", None)
        return self.estimate.predict(_record(self.model, given, time, self.estimate.interval_s))

    def add(self, effect: str | Effect, **options: object) -> Fit:
        """The model with one more effect, fitted to the same runs; see `bench.add`."""
        return fit(self.runs, add(effect, self.model, **options), check=self.check, static=self.static)

    def to_dataframe(self) -> pd.DataFrame:
        """Rows of the fitted runs: `run`, `time` [s], channels, and `bias`, `model`, `std`, `residual` [deg/h]."""
        import pandas as pd

        frames = []
        for run in self.runs:
            predicted, frame = self.estimate.predict(run.dataset), run.to_dataframe().reset_index()
            frame.insert(0, "run", run.name)
            frame = frame.assign(model=predicted.bias, std=predicted.std, residual=frame["bias"] - predicted.bias)
            frames.append(frame)
        together = pd.concat(frames, ignore_index=True)
        more = dict.fromkeys(("model", "std", "residual"), "deg/h")
        together.attrs["units"] = {**frames[0].attrs.get("units", {}), **more}
        return together

    def plot(self, run: Run | None = None, over: Over = "temperature") -> go.Figure:
        """Measured and modelled bias and what is left [deg/h], of this run (default: the first that was fitted).

        The band around zero is the noise floor.
        """
        shown = self.runs[0] if run is None else run
        data, floor_dph = shown.dataset, finite(self.floor.floor_dph)
        modelled = self.estimate.predict(data).bias
        if over == "time":
            return figure(deliver.compensation(data, modelled, self.model.name, floor_dph))
        rows = np.ones(len(data), dtype=bool)
        return figure(deliver.over_temperature(data, modelled, self.model.name, floor_dph, rows))

    def summary(self) -> str:
        """Effects, errors beside the noise floor, coefficients with standard deviations, validity and warnings."""
        lines = [self._headline(), self._errors(), ""]
        lines += text_table(("coefficient", "value", "std", "unit"), self._rows())
        return "\n".join([*lines, "", *self._notes()])

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._headline()}>"

    def _repr_html_(self) -> str:
        rows = [(key, value, std, in_print(unit)) for key, value, std, unit in self._rows()]
        head = ("coefficient", "value", "std", "unit")
        return html(self._headline(), "Coefficients", head, rows, self._errors(), *self._notes())

    def _errors(self) -> str:
        unseen = self.held_out
        return errors_text(self.rms_dph, unseen.rms_dph, unseen.by, self.floor, unseen.reason)

    def _headline(self) -> str:
        names = " + ".join(effect.name for effect in self.model.effects)
        name = names if names == self.model.name else f"{self.model.name} ({names})"
        of = ", ".join(self.estimate.runs)
        return f"{name}: {self.estimate.rows} means over {self.estimate.interval_s:g} s of {of}"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        """The coefficients; only the first of a long list, as of a spline with many pieces."""
        shown = list(self.coefficients.values())[:_MOST]
        rows = [(c.key, *with_uncertainty(c.value, c.std), c.unit) for c in shown]
        left_out = len(self.coefficients) - len(shown)
        return [*rows, (f"and {left_out} more in .coefficients", "", "", "")] if left_out else rows

    def _notes(self) -> list[str]:
        ranges = [f"{n} {' to '.join(ends(*span))} {CHANNELS[n].unit}" for n, span in self.validity.items()]
        return [*([f"valid for {', '.join(ranges)}"] if ranges else []), *(f"warning: {w}" for w in self.warnings)]


def fit(runs: Runs, model: ModelLike, *, check: Runs = (), static: Run | None = None) -> Fit:
    """Fit a model to one run, or to several of one unit together; `Run.fit` says what the arguments are.

    >>> import bench, numpy as np, pandas as pd
    >>> t = np.arange(0.0, 7200.0, 30.0)
    >>> temperature = 25.0 + 20.0 * np.sin(t / 1000.0)
    >>> run = bench.open(pd.DataFrame({"time": t, "rate": 3.0 + 0.5 * temperature, "temperature": temperature}))
    >>> straight = bench.fit(run, bench.load_model("polynomial"))
    >>> round(straight.coefficients["polynomial.a1"].value, 3)  # [deg/h/degC]
    0.5
    """
    chosen = several(runs)
    if not chosen:
        raise InputError("no run to fit a model to")
    datasets = [run.dataset for run in chosen]
    refuse_mixed(datasets)
    estimate = analysis.fit_model(fitted_model(model), datasets)
    return Fit(estimate, chosen, several(check), static)


def _record(
    model: Model, channels: Mapping[str, npt.ArrayLike], time: npt.ArrayLike | None, interval_s: float
) -> Dataset:
    """Channels (n,) as the record of a run."""
    columns = {name: np.atleast_1d(np.asarray(values, dtype=np.float64)) for name, values in channels.items()}
    unknown = [name for name in columns if name not in CHANNELS]
    if unknown:
        raise InputError(f"'{unknown[0]}' is not a channel; known are {', '.join(CHANNELS)}")
    rows = next((column.size for column in columns.values()), 0)
    if time is None:
        lasting = [effect.name for effect in model.effects if effect.family != "static"]
        if lasting:
            text = f"model '{model.name}' has '{lasting[0]}', which may depend on the course of time"
            raise InputError(f"{text}: give time= [s], one value a row")
        time = interval_s * np.arange(rows, dtype=np.float64)
    at = np.atleast_1d(np.asarray(time, dtype=np.float64))
    step = float(np.median(np.diff(at))) if at.size > 1 else interval_s
    return Dataset("prediction", at, columns, np.zeros(at.size, dtype=np.int64), interval_s=step)
