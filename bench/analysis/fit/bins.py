"""Models that are fitted to bins of the rows: a surface over rate and temperature, an interpolating spline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.effects.model import Model
from bench.analysis.effects.spline import Spline, refuse_unvisited
from bench.analysis.fit.rate_surface import binned_record
from bench.base import InputError
from bench.record import Dataset


def in_bins(model: Model, records: tuple[Dataset, ...]) -> tuple[Model, tuple[Dataset, ...]]:
    """The model with the bins as its rows. An effect with memory needs rows in time: InputError."""
    if all(effect.name == "surface" for effect in model.effects):
        return model, tuple(map(binned_record, records))
    (effect, *others) = model.effects
    if not isinstance(effect, Spline) or others:
        names = ", ".join(effect.name for effect in model.effects if effect.name != "surface")
        raise InputError(f"model '{model.name}': rows: bins is for a surface or a spline alone, not for {names}")
    return replace(model, effects=(replace(effect, interpolating=True),)), (_at_knots(effect, records),)


def _at_knots(spline: Spline, records: tuple[Dataset, ...]) -> Dataset:
    """The mean bias of m + 1 bins of equal width, at their middles: the knots of the spline through them."""
    if not isinstance(spline.intervals, int) or spline.ends == "free":
        raise InputError(
            "spline: rows: bins is the spline through the means of bins, which needs a number of intervals and "
            f"natural, parabolic or periodic ends, not intervals {spline.intervals} and ends {spline.ends}"
        )
    temperature = np.concatenate([record.channel("temperature") for record in records])
    bias = np.concatenate([record.bias for record in records])
    rows = np.flatnonzero(np.isfinite(temperature) & np.isfinite(bias))
    if rows.size == 0:
        raise InputError("zero rows to fit: no row has both temperature and rate")
    edges = np.linspace(temperature[rows].min(), temperature[rows].max(), spline.intervals + 2)
    cell = np.clip(np.searchsorted(edges, temperature[rows], side="right") - 1, 0, spline.intervals)
    count = np.bincount(cell, minlength=spline.intervals + 1)
    refuse_unvisited(count.astype(np.float64), (float(edges[0]), float(edges[-1])))
    means = np.bincount(cell, bias[rows]) / count
    first = records[0]
    return Dataset(
        first.name,
        np.arange(means.size, dtype=np.float64),
        {"rate": means, "temperature": 0.5 * (edges[1:] + edges[:-1])},
        np.zeros(means.size, dtype=np.int64),
        interval_s=first.interval_s,
        corrected=first.corrected,
        unit=first.unit,
    )
