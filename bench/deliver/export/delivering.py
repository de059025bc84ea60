"""Export of a run folder: checks the calibration, builds the delivery, measures each form, makes the files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis import Fit, Source, source_of
from bench.base import DPH_PER_DPS, InputError, IntArray
from bench.deliver.export.building import deliver
from bench.deliver.export.delivery import INPUTS, Delivery
from bench.deliver.export.exact import correction
from bench.deliver.export.formats import FORMATS, Files, Package
from bench.deliver.export.forms import FORMS
from bench.deliver.export.image import read, words_of
from bench.deliver.export.measure import best_form, raw_id, worst_errors
from bench.deliver.export.measured import MEASURED
from bench.deliver.export.signals import to_counts
from bench.record import Dataset, Manifest, prove


@dataclass(frozen=True)
class ExportOptions:
    """Choices of the caller; None leaves the choice to the bench. `force` delivers despite all objections."""

    model: str | None = None
    form: str | None = None
    serial: int | None = None
    sample_hz: float = 500.0
    name: str = "calibration"
    address: int = 0
    force: bool = False


@dataclass(frozen=True, eq=False)
class Delivered:
    """A package, and the greatest difference of the delivered from the fitted model on the run's rows [deg/h]."""

    package: Package
    source: Source
    apart_dph: float


def prepare(folder: Path, options: ExportOptions) -> Delivered:
    """The calibration of a run, ready for any format.

    Raises InputError, one line, if it must not be delivered or its files are not proven and `force` is not set, or if
    the form does not exist.
    """
    if options.form is not None and options.form not in FORMS:
        raise InputError(f"form is {options.form!r}, allowed are {', '.join(FORMS)}")
    source = source_of(folder, options.model)
    if not options.force:
        prove(folder)
    if source.objections and not options.force:
        more = f" (and {len(source.objections) - 1} more)" if len(source.objections) > 1 else ""
        raise InputError(f"not delivered: {source.objections[0]}{more}; --force delivers it anyway", folder)
    serial = options.serial if options.serial is not None else source.serial
    if serial is None:
        raise InputError(f"unit '{source.unit}' has no number in its serial number; give one with --serial", folder)
    delivery = replace(deliver(source.fit, [source.dataset], options.sample_hz), created=_created(folder))
    rows = worst_errors(delivery)
    form = options.form or best_form(rows).form
    words = words_of(delivery, form, serial, calibration_id(source))
    package = Package(
        options.name, words, read(words, serial), delivery, source.fit.coefficients, rows, source.unit, options.address
    )
    return Delivered(package, source, apart(delivery, source.fit, source.dataset))


def refuse_format(format_: str) -> None:
    """InputError that lists the formats where it is none of them."""
    if format_ not in FORMATS and format_ not in MEASURED:
        raise InputError(f"format is {format_!r}, allowed are {', '.join((*FORMATS, *MEASURED))}")


def files_of(package: Package, format_: str) -> Files:
    """Files of one format of a calibration; InputError that lists the formats."""
    refuse_format(format_)
    return FORMATS[format_](package)


def calibration_id(source: Source) -> int:
    """First 32 bits of the SHA-256 of unit, model and numbers, so that calibrations differ in their ids."""
    fit = source.fit
    return id_of([source.unit, fit.model.to_yaml(), fit.beta.tolist(), fit.theta, list(fit.runs)])


def id_of(content: Sequence[Any]) -> int:
    """First 32 bits of the SHA-256 of what a calibration is."""
    return int(hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:8], 16)


def counts_of(dataset: Dataset) -> dict[int, IntArray]:
    """Channels of a record in the counts of the unit; those without any value are none."""
    return {INPUTS[name].id: to_counts(name, dataset.channel(name)) for name in INPUTS if dataset.has(name)}


def apart(delivery: Delivery, fit: Fit, dataset: Dataset) -> float:
    """Greatest difference between delivered and fitted model on the fitted rows [deg/h].

    A filter for the unit's samples is compared at the interval of the record.
    """
    here = delivery if not delivery.period_ns else deliver(fit, [dataset], 1.0 / dataset.interval_s)
    counts = counts_of(dataset)
    counts.setdefault(raw_id(delivery), np.zeros(len(dataset), dtype=np.int64))
    rows = np.isfinite(fit.residuals[0])
    off = DPH_PER_DPS * correction(here, counts) - fit.predict(dataset).bias
    return float(np.max(np.abs(off[rows]), initial=0.0))


def _created(folder: Path) -> int:
    """Time in the run's manifest [s since 1970], 0 without one, so that the same run makes the same image."""
    try:
        return int(datetime.fromisoformat(Manifest.read(folder).created).timestamp())
    except ValueError:
        return 0
