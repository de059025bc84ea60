"""Every unit that went through one run, analysed."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bench.base import BenchError
from bench.commands.analysis import report_on
from bench.commands.results.analyse import NotAnalysed, Reported, UnitReport, UnitsReported
from bench.record import MANIFEST

if TYPE_CHECKING:
    from bench.acquisition import RunResult, UnitResult
    from bench.analysis import Limits, Model


def report_on_units(
    result: RunResult, models: Sequence[Model], limits: Limits | None = None
) -> Reported | UnitsReported:
    """Analyse what a run left: that of its unit, or those of all its units."""
    if len(result.units) > 1:
        return report_on_all(result.units, models, limits)
    if result.error is not None and not (result.run.path / MANIFEST).exists():
        raise result.error  # no tables: there is nothing to analyse
    return report_on(result.run, models, result.error, limits=limits)


def report_on_all(units: Sequence[UnitResult], models: Sequence[Model], limits: Limits | None = None) -> UnitsReported:
    """Analyse the run of each unit and write its report; one that fails does not take those of the others with it."""
    return UnitsReported(tuple(UnitReport(unit.serial, _report_on(unit, models, limits), unit.error) for unit in units))


def _report_on(unit: UnitResult, models: Sequence[Model], limits: Limits | None) -> Reported | NotAnalysed:
    try:
        return report_on(unit.run, models, unit.error, limits=limits)
    except BenchError as error:
        return _not_analysed(unit, str(error), error.exit_code)
    except Exception as bug:
        traceback.print_exc()
        return _not_analysed(unit, f"internal error: {type(bug).__name__}: {bug}", 4)


def _not_analysed(unit: UnitResult, text: str, code: int) -> NotAnalysed:
    if unit.error is not None:
        text, code = f"{unit.error}; not analysed: {text}", max(code, unit.error.exit_code)
    return NotAnalysed(unit.run.path, text, code)
