"""`bench fleet`: statistics of all units that the registry knows."""

from __future__ import annotations

from pathlib import Path

from bench.commands.files import write
from bench.commands.results.stock import FleetJudged


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
