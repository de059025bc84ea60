"""The calibration of a run folder as a fit again, and whether it may be delivered at all.

What is delivered is what was reported: amplitudes and time constants come from calibration.json; the run's data only
tell how the effects were scaled, and prove by the residual that they belong together.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis.effects.model import Model, load_model, model_from
from bench.analysis.fit.bins import in_bins
from bench.analysis.fit.design import FitRows, fit_rows
from bench.analysis.fit.disturbances import undisturbed
from bench.analysis.fit.fitting import Fit, fit_model
from bench.analysis.thresholds import LEAST_COVERED_DEGC, MOST_DELIVERED_CONDITION, WIDEST_HOLE
from bench.base import CHANNELS, FloatArray, InputError
from bench.record import CalibrationRecord, Dataset, Manifest, Scaled, StoredFit, load

_SAME = 1e-6
_PROVEN = {"adequate", "missing_effect", "unknown_effect", "undecided", "model_error"}


@dataclass(frozen=True, eq=False)
class Source:
    """A fit of one unit; `objections` say why it should not be delivered, worst first."""

    fit: Fit
    dataset: Dataset
    unit: str
    objections: tuple[str, ...]

    @property
    def serial(self) -> int | None:
        """Of the unit, as a number."""
        return serial_number(self.unit)


def serial_number(unit: str) -> int | None:
    """Number in a unit's serial number (its last group of digits), None where it has none."""
    groups = re.findall(r"\d+", unit)
    return int(groups[-1]) if groups else None


def source_of(folder: Path, model: str | None = None) -> Source:
    """The calibration of a run folder, or another `model` fitted to its data.

    Raises InputError: no run, no calibration.json, no model in it, or not of this data.
    """
    manifest, stored = Manifest.read(folder), CalibrationRecord.read(folder)
    path, content = folder / CalibrationRecord.FILE, stored.calibration
    if model is not None:
        dataset = undisturbed(load(folder, stored.averaging_s))
        named = load_model(model)
        dataset, wanted = _rows(dataset, named)
        fit = fit_model(wanted, dataset, covariance="sandwich" if named.rows == "bins" else "noise")
    elif content is None:
        raise InputError("holds no calibration: no model could be fitted to this run", path)
    else:
        fit, dataset = _stored(content, undisturbed(load(folder, stored.averaging_s)), path)
    objections = (*_of_run(manifest, stored), *objections_to(fit, dataset))
    return Source(fit, dataset, manifest.unit, objections)


def _rows(dataset: Dataset, model: Model) -> tuple[Dataset, Model]:
    """The rows of a model fitted to bins are the bins: from here on they are the record."""
    if model.rows != "bins":
        return dataset, model
    binned, records = in_bins(model, (dataset,))
    return records[0], replace(binned, rows="all")


def _stored(content: StoredFit, dataset: Dataset, path: Path) -> tuple[Fit, Dataset]:
    """The fit whose numbers stand in calibration.json."""
    rms_dph, condition = content.rms_dph, content.condition
    if content.scaled is None or rms_dph is None or condition is None:
        raise InputError("lacks the numbers of its fit; make it again with `bench report`", path)
    try:
        dataset, model = _rows(dataset, model_from(content.model.description()))
        rows = fit_rows(model, (dataset,))
        values = np.array(content.scaled.values, dtype=np.float64)
        size = values.size - len(rows.parameters)
        bound, columns = rows.bind(values[size:])
        residual = rows.y - columns @ values[:size]
    except (TypeError, ValueError) as error:
        raise InputError(f"is not a calibration of this bench ({error!r})", path) from error
    _check_same(rows, residual, rms_dph, path)
    covariance = _covariance(content.scaled, values.size)
    fit = Fit(
        model=rows.model, bound=bound, beta=values[:size], covariance=covariance, noise=None,
        rms_dph=rms_dph, condition=condition, rows=rows.y.size, interval_s=dataset.interval_s,
        runs=(dataset.name,), validity=rows.validity(), residuals=rows.scatter(residual),
    )  # fmt: skip
    return fit, dataset


def _covariance(scaled: Scaled, size: int) -> FloatArray:
    rows = scaled.covariance or [[None] * size] * size
    return np.array([[np.nan if value is None else value for value in row] for row in rows], dtype=np.float64)


def _check_same(rows: FitRows, residual: Any, rms_dph: float, path: Path) -> None:
    actual_dph = float(np.sqrt(np.sum(rows.weights * residual**2) / np.sum(rows.weights)))
    if not abs(actual_dph - rms_dph) <= _SAME * max(rms_dph, 1e-9):
        raise InputError(
            f"says a residual of {rms_dph:.6g} deg/h, this run's data give {actual_dph:.6g}: it belongs to other data; "
            "make a new one with `bench report`",
            path,
        )


def _of_run(manifest: Manifest, stored: CalibrationRecord) -> Iterator[str]:
    if manifest.state != "done":
        yield f"the run is '{manifest.state}' ({manifest.cause or 'no cause given'}), not complete"
    verdict = stored.verdict
    if verdict.verdict not in _PROVEN:
        yield f"the run's verdict is '{verdict.verdict}', no unseen data proves the model"
    if verdict.admissible is False:
        yield "the parts of the run do not fit together at their joints, or too much of it was left out as not valid"


def objections_to(fit: Fit, dataset: Dataset) -> Iterator[str]:
    """Why a fit to this record determines nothing that may be delivered: conditioning, coverage."""
    if fit.condition > MOST_DELIVERED_CONDITION:
        yield (
            f"the fit's condition is {fit.condition:.2g}, limit {MOST_DELIVERED_CONDITION:.0e}: two terms cannot be "
            "told apart; leave one out"
        )
    for key in fit.on_bound:
        yield f"{key} = {fit.theta[key]:g} is on its bound: the run does not determine it"
    rows = np.isfinite(fit.residuals[0])
    if rows.size != len(dataset):  # fitted to means of these rows: bins, soaks
        rows = np.isfinite(dataset.bias)
    for channel, (low, high) in fit.validity.items():
        if channel == "temperature" and high - low < LEAST_COVERED_DEGC:
            yield f"the run covers {low:.1f} to {high:.1f} degC only, at least {LEAST_COVERED_DEGC:g} degC are needed"
        values = dataset.channel(channel)[rows]
        values = np.sort(values[(values >= low) & (values <= high)])
        steps = np.diff(values)
        if steps.size and steps.max() > WIDEST_HOLE * (high - low):
            at, unit = int(steps.argmax()), CHANNELS[channel].unit
            yield (
                f"no data between {values[at]:.6g} and {values[at + 1]:.6g} {unit} of {channel}: more than "
                f"{100 * WIDEST_HOLE:.0f} % of its range is not covered"
            )
