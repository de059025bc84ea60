"""`bench fleet`: statistics of all units that the registry knows."""

from __future__ import annotations

from pathlib import Path

from bench.base import InputError, nearest_or_all
from bench.commands.files import write
from bench.commands.results.stock import FleetJudged, GaugeJudged


def fleet(  # noqa: PLR0913 - options of one command, by keyword
    out: Path,
    where: str | None,
    *,
    pattern: str | None,
    profile: str | None,
    limits: Path | None,
    html: Path | None,
    csv: Path | None,
) -> FleetJudged:
    """Yield, capability, charts, drifts, odd units."""
    from bench.analysis import load_limits
    from bench.archive import Selection, fleet_of, render, safe_csv, statistics
    from bench.commands.registering import existing

    bounds = load_limits(limits) if limits else None
    with existing(out, where) as registry:
        units = fleet_of(registry, pattern, Selection(profile))
    found = statistics(units, bounds)
    for path, made in ((html, render), (csv, safe_csv)):
        if path is not None:
            write(path, made(found))
    return FleetJudged(found, html, csv)


def gauge(
    quantity: str, out: Path, where: str | None, *, pattern: str | None, profile: str | None, limits: Path | None
) -> GaugeJudged:
    """`bench fleet gauge`: repeatability and reproducibility of a quantity, from units that stations measured again.

    InputError for an unknown quantity, for runs that are no study, and for limits without a width.
    """
    import numpy as np

    from bench.analysis import load_limits
    from bench.archive import Selection, selected
    from bench.archive import gauge as study
    from bench.commands.registering import existing

    with existing(out, where) as registry:
        runs, units, left_out = selected(registry, pattern, Selection(profile))
    runs = [run for run in runs if quantity in run.values]
    if not runs:
        raise InputError(f"no run has the quantity '{quantity}'{nearest_or_all(quantity, sorted(units))}", out)
    tolerance = None
    if limits is not None:
        tolerance = next((one.room for one in load_limits(limits).limits if one.subject == quantity), np.inf)
        if not np.isfinite(tolerance):
            raise InputError(f"has no lower and upper limit of '{quantity}'; add both, or leave --limits out", limits)
    values = np.array([run.values[quantity] for run in runs])
    found = study(values, [run.unit for run in runs], [run.station for run in runs], tolerance)
    return GaugeJudged(quantity, units[quantity], found, left_out)
