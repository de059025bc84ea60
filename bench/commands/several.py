"""The answer for several units that went through one run: the worst verdict, and a line for each."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bench.base import BenchError
from bench.commands.analysis import report_on
from bench.commands.answer import Answer

if TYPE_CHECKING:
    from bench.acquisition import UnitResult
    from bench.analysis import Limits, Model

WORST_FIRST = ("no_data", "partial", "unproven", "model_error", "unknown_effect", "missing_effect", "adequate")


def report_on_all(units: Sequence[UnitResult], models: Sequence[Model], limits: Limits | None = None) -> Answer:
    """Analyse the run of each unit and write its report; one that fails does not take those of the others with it."""
    answers = [_report_on(unit, models, limits) for unit in units]
    contents = [{"unit": unit.serial, **answer.content} for unit, answer in zip(units, answers, strict=True)]
    worst = min((str(content["verdict"]) for content in contents), key=WORST_FIRST.index)
    width = max(len(unit.serial) for unit in units)
    lines: list[str] = []
    for unit, content in zip(units, contents, strict=True):
        judged = f"{content['limits']['verdict']}, " if content.get("limits") else ""
        lines.append(f"{unit.serial:<{width}}  {judged}{content['verdict']}: {content['sentence']}")
        lines.append(f"{'':<{width}}  {content.get('report') or content['run']}")
    shared = {str(unit.error) for unit in units if unit.error is not None}
    lines += [f"bench: {text}" for text in sorted(shared)]
    code = max(answer.exit_code for answer in answers)
    return Answer({"verdict": worst, "units": contents}, "\n".join(lines), code)


def _report_on(unit: UnitResult, models: Sequence[Model], limits: Limits | None) -> Answer:
    try:
        return report_on(unit.run, models, unit.error, limits=limits)
    except BenchError as error:
        return _unproven(unit, str(error), error.exit_code)
    except Exception as bug:
        traceback.print_exc()
        return _unproven(unit, f"internal error: {type(bug).__name__}: {bug}", 4)


def _unproven(unit: UnitResult, text: str, code: int) -> Answer:
    """What is left to say of a unit whose run could not be analysed."""
    if unit.error is not None:
        text, code = f"{unit.error}; not analysed: {text}", max(code, unit.error.exit_code)
    content = {"run": str(unit.run.path), "verdict": "unproven", "sentence": f"not analysed: {text}", "rms_dph": None}
    return Answer({**content, "error": text}, text, code)
