"""Where a model fails, as ranges of channels: from the probes' alarms."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bench.analysis.diagnosis.answer import Place
from bench.analysis.diagnosis.probes import SIGNS, Finding, direction_of
from bench.analysis.diagnosis.suspects import Layout
from bench.base import BoolArray, FloatArray

_PIECES = 20
_HALF = 0.5  # of the largest misfit: where the range ends


def places(layout: Layout, findings: Iterable[Finding], residual: FloatArray, floor_dph: float) -> tuple[Place, ...]:
    """One place a finding, most significant first; `residual` (n,) [deg/h] of the layout's rows."""
    return tuple(_place(layout, finding, residual, floor_dph) for finding in findings)


def steps_places(layout: Layout, residual: FloatArray, floor_dph: float) -> tuple[Place, ...]:
    """The steps of thermometer and output where they matter: the whole range, of the size of their error."""
    steps = layout.resolution
    rms = float(np.sqrt(np.mean(residual**2)))
    found = []
    for channel, values, error in (
        ("temperature", layout.temperature, steps.temperature_error_dph),
        ("rate", layout.stacked([record.channel("rate") for record in layout.rows.records]), steps.rate_error_dph),
    ):
        if error:
            low, high = float(values.min()), float(values.max())
            found.append(Place(channel, low, high, rms, rms / floor_dph, error, 0.0, "steps of the recorded values"))
    return tuple(found)


def _place(layout: Layout, finding: Finding, residual: FloatArray, floor_dph: float) -> Place:
    channel, values = _values(layout, finding.name)
    note = finding.note
    if finding.cells and finding.estimates is not None and finding.deviations is not None:
        rows, note, size = _cell(finding, values, layout.slope)
    elif finding.name == "periodic":
        rows, size = np.ones(len(values), dtype=bool), float(np.sqrt(np.mean(finding.shape**2)))
    else:
        shape = layout.beyond(finding.shape)
        rows = _around_peak(values, shape)
        size = float(np.sqrt(np.mean(shape[rows] ** 2)))
        note = "finer than the model's curve" if finding.name == "fine temperature" else note
    rms = float(np.sqrt(np.mean(residual[rows] ** 2)))
    low, high = float(values[rows].min()), float(values[rows].max())
    return Place(channel, low, high, rms, rms / floor_dph, size, finding.p, note)


def _values(layout: Layout, name: str) -> tuple[str, FloatArray]:
    if name in {"time", "periodic"}:
        return "time", np.concatenate(layout.rows.time)
    if name == "dT/dt":
        return "dT_dt", layout.slope
    if name in {"temperature x direction", "fine temperature"}:
        return "temperature", layout.temperature
    return name, layout.stacked([record.channel(name) for record in layout.rows.records])


def _cell(finding: Finding, temperature: FloatArray, slope: FloatArray) -> tuple[BoolArray, str, float]:
    """Rows of the most significant cell, its direction and mean, and its size [deg/h]."""
    estimates, deviations = np.asarray(finding.estimates), np.asarray(finding.deviations)
    score = np.abs(estimates / deviations)
    worst = int(np.nanargmax(score))
    direction, low, high = finding.cells[worst]
    turning = direction_of(slope) == SIGNS[direction]
    rows = turning & (temperature >= low) & (temperature <= high)
    note = f"{direction}: {estimates[worst]:+.3f} +- {deviations[worst]:.3f} deg/h"
    return (rows if rows.any() else turning), note, abs(float(estimates[worst]))


def _around_peak(values: FloatArray, shape: FloatArray) -> BoolArray:
    """Rows about the largest misfit where its mean over a twentieth of the rows is at least half as large."""
    order = np.argsort(values, kind="stable")
    pieces = np.array_split(order, min(_PIECES, len(order)))
    means = np.array([float(np.mean(shape[piece])) for piece in pieces])
    peak = int(np.argmax(np.abs(means)))
    inside = means * np.sign(means[peak]) >= _HALF * abs(means[peak])
    outside = np.flatnonzero(~inside)
    before, after = outside[outside < peak], outside[outside > peak]
    first = int(before[-1]) + 1 if before.size else 0
    last = int(after[0]) if after.size else len(pieces)
    rows = np.zeros(len(values), dtype=bool)
    rows[np.concatenate(pieces[first:last])] = True
    return rows
