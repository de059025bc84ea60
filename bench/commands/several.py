"""Every unit that went through one run, analysed."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from pathlib import Path

from bench import acquisition, analysis
from bench.base import BenchError, InputError
from bench.commands.analysis import of_one, of_outputs, report_on
from bench.commands.results.analyse import NotAnalysed, Reported, UnitReport, UnitsReported
from bench.record import MANIFEST, RunFolder, apart


def report_on_units(
    result: acquisition.RunResult, models: Sequence[analysis.Model], limits: analysis.Limits | None = None
) -> Reported | UnitsReported:
    """Analyse what a run left: that of its unit, or those of all its units."""
    if len(result.units) > 1:
        return report_on_all(result.units, models, limits)
    if result.error is not None and not (result.run.path / MANIFEST).exists():
        raise result.error  # no tables: there is nothing to analyse
    return report_on_outputs(result.run, models, result.error, limits=limits)


def report_on_outputs(  # noqa: PLR0913, PLR0917 - options of one command
    run: RunFolder,
    models: Sequence[analysis.Model],
    error: BenchError | None,
    check: Sequence[Path] = (),
    static: Path | None = None,
    limits: analysis.Limits | None = None,
    sisters: Sequence[Path] = (),
) -> Reported | UnitsReported:
    """Analyse each rate of a unit by itself, with the same rate of the further runs."""
    runs = _apart(run)
    if len(runs) == 1:
        return report_on(run, models, error, check, static, limits, sisters)
    reports = []
    for each in runs:
        manifest = each.manifest()
        checks, others = (of_outputs(paths, manifest.output) for paths in (check, sisters))
        still = None if static is None else of_one(static, manifest.output)
        result = _report_on(each, models, error, checks, still, limits, others)
        reports.append(UnitReport(manifest.unit, result, error, manifest.output))
    return UnitsReported(tuple(reports))


def report_on_all(
    units: Sequence[acquisition.UnitResult], models: Sequence[analysis.Model], limits: analysis.Limits | None = None
) -> UnitsReported:
    """Analyse each rate of each unit and write its report; one that fails does not take those of the others with it."""
    reports = []
    for unit in units:
        runs = _apart(unit.run)
        for each in runs:
            output = each.manifest().output if len(runs) > 1 else "rate"
            result = _report_on(each, models, unit.error, limits=limits)
            reports.append(UnitReport(unit.serial, result, unit.error, output))
    return UnitsReported(tuple(reports))


def _apart(run: RunFolder) -> list[RunFolder]:
    """The run of each rate; the run itself where they cannot be told apart, and its analysis says why.

    A run through attitudes belongs to the whole unit: gravity, Earth and table are in all its rates.
    """
    try:
        if any(segment.attitude is not None for segment in run.manifest().segments):
            return [run]
        return apart(run)
    except (InputError, OSError):
        return [run]


def _report_on(  # noqa: PLR0913, PLR0917 - options of one command
    run: RunFolder,
    models: Sequence[analysis.Model],
    ended: BenchError | None,
    check: Sequence[Path] = (),
    static: Path | None = None,
    limits: analysis.Limits | None = None,
    sisters: Sequence[Path] = (),
) -> Reported | NotAnalysed:
    try:
        return report_on(run, models, ended, check, static, limits, sisters)
    except BenchError as error:
        return _not_analysed(run, ended, str(error), error.exit_code)
    except Exception as bug:
        traceback.print_exc()
        return _not_analysed(run, ended, f"internal error: {type(bug).__name__}: {bug}", 4)


def _not_analysed(run: RunFolder, ended: BenchError | None, text: str, code: int) -> NotAnalysed:
    if ended is not None:
        text, code = f"{ended}; not analysed: {text}", max(code, ended.exit_code)
    return NotAnalysed(run.path, text, code)
