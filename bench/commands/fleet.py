"""`bench fleet`: statistics of all units that the registry knows."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from bench import analysis, archive
from bench.base import InputError, nearest_or_all
from bench.commands.files import write
from bench.commands.registering import existing, open_in
from bench.commands.results.stock import FleetDiagnosed, FleetJudged, GaugeJudged

if TYPE_CHECKING:
    from bench.commands.refitting import RefitOptions


def fleet(  # noqa: PLR0913 - options of one command, by keyword
    out: Path,
    where: str | None,
    selection: archive.Selection,
    *,
    pattern: str | None,
    limits: Path | None,
    html: Path | None,
    csv: Path | None,
) -> FleetJudged:
    """Yield, capability, charts, drifts, odd units."""
    bounds = analysis.load_limits(limits) if limits else None
    with existing(out, where) as registry:
        units = archive.fleet_of(registry, pattern, selection, bounds)
    found = archive.statistics(units)
    for path, made in ((html, archive.render), (csv, archive.safe_csv)):
        if path is not None:
            write(path, made(found))
    return FleetJudged(found, html, csv)


def diagnose_units(
    model_name: str, out: Path, where: str | None, options: RefitOptions, *, part: str = "", again: bool = False
) -> FleetDiagnosed:
    """`bench fleet diagnose`: what the model of every unit lacks, and what a lot has in common.

    `part`: of units with this in their serial number.
    """
    from bench.commands.refitting import engine_of

    model, name = analysis.load_model(model_name), "none"

    def engine(units: int) -> archive.Engine:
        nonlocal name
        name, made = engine_of(options, units)
        return made

    if not archive.is_archive(out):
        raise InputError("no registered runs here; make the registry with `bench registry rebuild`", out)
    with open_in(out, where) as registry:
        begun = time.perf_counter()
        ledger = archive.archive(out)
        found = archive.diagnose_fleet(registry, ledger, model, engine, options.selection, part=part, again=again)
    if not found.told and not found.failed:
        raise InputError(f"no finished run to diagnose: {'; '.join(found.left_out) or 'none is registered'}", out)
    return FleetDiagnosed(model.name, found, name, time.perf_counter() - begun)


def gauge(
    quantity: str,
    out: Path,
    where: str | None,
    selection: archive.Selection,
    *,
    pattern: str | None,
    limits: Path | None,
) -> GaugeJudged:
    """`bench fleet gauge`: repeatability and reproducibility of a quantity, from units that stations measured again.

    InputError for an unknown quantity, for runs that are no study, and for limits without a width.
    """
    import numpy as np

    with existing(out, where) as registry:
        every, units, left_out = archive.selected(registry, pattern, selection)
    runs = [run for run in every if quantity in run.values]
    if not runs:
        raise InputError(f"no run has the quantity '{quantity}'{nearest_or_all(quantity, sorted(units))}", out)
    tolerance = None
    if limits is not None:
        tolerance = next((one.room for one in analysis.load_limits(limits).limits if one.subject == quantity), np.inf)
        if not np.isfinite(tolerance):
            raise InputError(f"has no lower and upper limit of '{quantity}'; add both, or leave --limits out", limits)
    values = np.array([run.values[quantity] for run in runs])
    found = archive.gauge(values, [run.unit for run in runs], [run.station for run in runs], tolerance)
    return GaugeJudged(quantity, units[quantity], found, left_out)
