"""`bench fleet`: statistics of all units that the registry knows."""

from __future__ import annotations

from pathlib import Path

from bench.analysis import load_limits
from bench.base import InputError, number
from bench.commands.answer import Answer
from bench.record import write_atomically


def fleet(
    root: Path, where: str | None, pattern: str | None, limits: Path | None, html: Path | None, csv: Path | None
) -> Answer:
    """Yield, capability, charts, drifts, odd units; exit code 1 where a judged unit is outside its limits."""
    from bench.archive import Statistics, render, sentence, statistics, to_csv
    from bench.archive import fleet_of as read
    from bench.commands.registering import existing, table

    bounds = load_limits(limits) if limits else None
    with existing(root, where) as registry:
        units = read(registry, pattern)
    found: Statistics = statistics(units, bounds)
    passes = found.passes
    lines = [f"{len(units.newest)} units. {sentence(found)}"]
    if passes.judged:
        share = 100 * passes.first / passes.judged
        low, high = (100 * end for end in passes.interval)
        lines.append(f"first-pass yield {share:.1f} % ({low:.1f} to {high:.1f}), {passes.first} of {passes.judged}")
    able = [(one, one.capability) for one in found.measured if one.capability is not None]
    if able:
        rows = [
            {"quantity": one.name, "mean": number(own.mean), "lower": number(one.lower), "upper": number(one.upper),
             "Cpk": number(own.cpk), "Ppk": number(own.ppk), "outside": own.outside}
            for one, own in able
        ]  # fmt: skip
        lines += ["", table(rows)]
    for path, made in ((html, render), (csv, to_csv)):
        if path is not None:
            _write(path, made(found))
            lines.append(f"wrote   {path}")
    files = {"html": str(html) if html else None, "csv": str(csv) if csv else None}
    return Answer({**found.to_json(), **files}, "\n".join(lines), 1 if passes.final < passes.judged else 0)


def _write(path: Path, text: str) -> None:
    try:
        write_atomically(path, text.encode())
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", path) from None
