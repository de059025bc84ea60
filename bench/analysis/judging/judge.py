"""A run folder judged: floor, ladder of models, diagnosis of the best, verdict; written as JSON beside the data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.analysis.diagnosis.compare import beside_rotation, compare, ladder
from bench.analysis.diagnosis.diagnose import SISTERS_ALONE
from bench.analysis.diagnosis.scores import Score
from bench.analysis.effects.model import Model
from bench.analysis.judging.analysis import NEXT_PROFILE, Analysis
from bench.analysis.judging.calibration import calibration
from bench.analysis.judging.cautions import cautions
from bench.analysis.judging.change import Figures
from bench.analysis.judging.completeness import completeness
from bench.analysis.judging.diagnosed import diagnosed
from bench.analysis.judging.earlier import set_aside
from bench.analysis.judging.expressed import Measurements
from bench.analysis.judging.joints import joints
from bench.analysis.judging.limits import Limits, judge_limits
from bench.analysis.judging.quantities import quantities, standing
from bench.analysis.judging.validity import OF_ALL_ROWS, refusals
from bench.analysis.judging.verdict import RunVerdict, judge, with_diagnosis
from bench.analysis.noise.floor import Floor, noise_floor
from bench.base import RATES, InputError
from bench.record import (
    DEFAULT_INTERVAL_S,
    CalibrationRecord,
    ComparisonRecord,
    Dataset,
    LimitsRecord,
    Manifest,
    Record,
    RunFolder,
    averaged,
    load,
    put,
    refuse_twice,
    seconds_of,
    use,
)

BASELINES = 3
"""Models at the start of the ladder that every comparison shows: what is common practice."""
_FREE = frozenset({"spline", "surface"})
_PENDING = RunVerdict("unproven", "not judged yet")


def analyse(  # noqa: PLR0913 - options of one command, by keyword
    run_folder: Path | str,
    models: Sequence[Model] = (),
    check: Sequence[Path | str] = (),
    interval_s: float = DEFAULT_INTERVAL_S,
    *,
    static: Path | str | None = None,
    sisters: Sequence[Path | str] = (),
    diagnose: bool = True,
) -> Analysis:
    """Analyse a run with `models` (default: those of the source papers) beside the baselines.

    With `check` runs of the same unit the held-out error is measured on them; an isothermal run `static` of it tells
    the noise, `sisters`, such runs of units like it, tell the diagnosis how it drifts. An aborted or empty run raises
    no error: the analysis says so. Raises InputError when the folder is not a run or one of the other runs cannot be
    read, for `sisters` without `static`, and where one recording is given twice.
    `diagnose` asks which effect the best model lacks, in some ten seconds. Writes compare.json, calibration.json and,
    with a diagnosis, diagnosis.json into the run folder; one that knew more runs is kept under another name.
    """
    run = RunFolder(Path(run_folder))
    manifest = run.manifest()
    use(run.path, run.means.name, run.data.name)
    checks = [load(_of_unit(folder, manifest, "check"), interval_s) for folder in check]
    if sisters and static is None:
        raise InputError(SISTERS_ALONE)
    kin = [load(RunFolder(Path(folder)).path, interval_s) for folder in sisters]
    isothermal = None if static is None else _of_unit(static, manifest, "isothermal")
    calm = None if isothermal is None else seconds_of(isothermal)
    still, fine = (None if calm is None else averaged(calm, s) for s in (interval_s, 1.0))
    others = tuple(_lacking((*check, *([] if static is None else [static]), *sisters)))
    seconds, data, reason, inertial = _means(run, interval_s)
    interval_s = interval_s if data is None else data.interval_s
    refuse_twice((*kin, *([] if still is None else [still])))
    refuse_twice(one for one in (data, *checks, still) if one is not None)
    done = completeness(run, manifest, None if seconds is None else averaged(seconds, 1.0, whole=True))
    if seconds is None or data is None:
        floor, verdict = Floor(reason=reason), judge(done, None, np.nan, reason, elsewhere=seconds is not None)
        gaps = joints(manifest, None, np.nan)
        warnings = (*cautions(done, None, None, None, gaps), *others)
        result = Analysis(run, manifest, interval_s, done, floor, verdict, gaps=gaps, warnings=warnings, others=others,
                          inertial=inertial)  # fmt: skip
    else:
        floor = noise_floor([averaged(seconds, 1.0)], interval_s, fine)
        name = None if isothermal is None else isothermal.name
        known = Analysis(run, manifest, interval_s, done, floor, _PENDING, data, static=name, others=others)
        result = _judged(known, data, models, checks)
        result = _diagnosed(result, data, checks, still, kin) if diagnose else result
    _write(result, diagnose)
    return result


def judged_by(analysis: Analysis, limits: Limits) -> Analysis:
    """The analysis with the limits' verdict, written as limits.json beside the data."""
    measured = None
    if analysis.dataset is not None:
        measured = Measurements(analysis.dataset, None if analysis.best is None else analysis.best.fit)
    judgement = judge_limits(limits, quantities(analysis), refusals(analysis, limits), measured)
    judged = replace(analysis, judgement=judgement)
    if judged.judgement is not None:
        LimitsRecord.model_validate(judged.judgement.to_json()).write(analysis.run.path)
    return judged


def _of_unit(folder: Path | str, manifest: Manifest, what: str) -> Path:
    """A further run; InputError where it is of another unit: that would prove nothing."""
    run = RunFolder(Path(folder))
    mine, theirs = manifest.unit, run.manifest().unit
    if mine and theirs and mine != theirs:
        raise InputError(f"{what} run is of unit {theirs}, the run to be judged is of {mine}", run.path)
    return run.path


def _lacking(folders: Iterable[Path | str]) -> Iterator[str]:
    """Why nothing may rest on further runs, one line each."""
    for folder in folders:
        run = RunFolder(Path(folder))
        done = completeness(run, run.manifest(), averaged(seconds_of(run.path), 1.0, whole=True))
        reasons = [*done.lacking(), *([] if done.ended else [f"it is not complete: {done.state}"])]
        yield from (f"run {run.path.name}, on which this verdict rests: {reason}" for reason in reasons)


def _means(run: RunFolder, interval_s: float) -> tuple[Dataset | None, Dataset | None, str, bool]:
    """The 1 s means and those over `interval_s`, or why there are none to judge; the table is read once a report.

    Of several outputs the 1 s means are those of the first rate, which tell what of the run is there. The last is
    whether the unit is calibrated as a whole, by another command.
    """
    try:
        seconds = seconds_of(run.path)
        if len(seconds.outputs) > 1:
            text = f"the unit has {len(seconds.outputs)} outputs ({', '.join(seconds.outputs)})"
            stood = any(segment.attitude for segment in seconds.segments)
            way = f"`bench imu {run.path}` calibrates it as a whole, by the attitudes that it stood in"
            each = "`bench report` analyses each rate in a run folder of its own"
            one = next((name for name in seconds.outputs if name in RATES), None)
            return seconds.of(one) if one else None, None, f"{text}; {way if stood else each}", stood
    except InputError as error:
        return None, None, str(error).replace(f"{run.path}/", ""), False
    steady = averaged(seconds, 1.0)
    empty = [name for name in ("rate", "temperature") if not np.any(np.isfinite(steady.channels[name]))]
    if empty:
        return None, None, f"no value of {' and '.join(empty)} in the whole record", False
    data = averaged(seconds, interval_s)
    if not len(data):
        return None, None, f"no segment lasts half of the {interval_s:g} s of a mean", False
    return seconds, data, "", False


def _judged(known: Analysis, data: Dataset, models: Sequence[Model], checks: Sequence[Dataset]) -> Analysis:
    rungs = beside_rotation([*ladder()[:BASELINES], *(models or ladder()[BASELINES:])], data)
    comparison = compare(data, rungs, known.floor.floor_dph, checks or None, strict=False)
    best = _best(comparison.scores)
    reason = comparison.refused[-1][1] if comparison.refused else ""
    gaps = joints(known.manifest, data, known.floor.floor_dph)
    still = standing(data) if np.any(np.isfinite(standing(data).bias)) else data
    return replace(
        known,
        verdict=judge(known.done, best, known.floor.floor_dph, reason),
        comparison=comparison,
        best=best,
        bias_span_dph=float(np.nanmax(still.bias) - np.nanmin(still.bias)),
        uncompensated_dph=Figures.of(still).scatter_dph,
        gaps=gaps,
        warnings=(*cautions(known.done, known.floor, comparison, best, gaps), *known.others),
    )


def _diagnosed(
    known: Analysis, data: Dataset, checks: Sequence[Dataset], static: Dataset | None, sisters: Sequence[Dataset]
) -> Analysis:
    """Diagnose the best model of those fitted to all rows: a model of one branch lacks only the other one.

    A model with a free curve over temperature is preferred: a stiffer one lacks only the curve.
    """
    scores = known.comparison.scores if known.comparison else ()
    whole = [score for score in scores if score.model.rows == "all"]
    free = [score for score in whole if any(effect.name in _FREE for effect in score.model.effects)]
    best = _best(free or whole)
    if best is None:
        return known
    plan = known.run.path / NEXT_PROFILE
    outcome = diagnosed(data, best.model, checks, static, known.floor.floor_dph, plan, sisters)
    reasons = (
        f"not diagnosed: {outcome.reason}" if outcome.answer is None else "",
        set_aside(known.run.path, outcome.record),
    )
    known = replace(known, diagnosed=outcome, warnings=(*known.warnings, *filter(None, reasons)))
    return replace(known, verdict=with_diagnosis(known.verdict, outcome, known.floor.floor_dph))


def _best(scores: Sequence[Score]) -> Score | None:
    """Least error on unseen data; where no model has one, the least error on its own.

    A model of a part of the rows, which may not be delivered, comes after all others.
    """
    proven = [score for score in scores if np.isfinite(score.held_out.rms_dph)]
    if proven:
        return min(proven, key=lambda score: (score.model.rows not in OF_ALL_ROWS, score.held_out.rms_dph))
    return min(scores, key=lambda score: score.rms_dph, default=None)


def _write(result: Analysis, asked: bool) -> None:
    folder = result.run.path
    answer = result.to_json()
    compared = result.comparison.to_json() if result.comparison else {"runs": [folder.name], "models": []}
    compared |= {"static": result.static, "diagnosed": asked, "verdict": answer["verdict"]}
    made: list[Record] = [ComparisonRecord.model_validate(compared)]
    content = calibration(result.manifest, result.interval_s, result.best, result.floor, answer)
    content["quantities"] = [quantity.to_json() for quantity in quantities(result)]
    content["refusals"] = list(refusals(result))
    made.append(CalibrationRecord.model_validate(content))
    if (diagnosis := result.diagnosed.record) is not None:
        made.append(diagnosis)
    files = {record.FILE: record.text().encode() for record in made}
    if result.diagnosed.profile_yaml:
        files[NEXT_PROFILE] = result.diagnosed.profile_yaml.encode()
    put(folder, files, [Manifest.FILE])
