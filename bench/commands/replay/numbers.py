"""The analysis of a run made again on its remade tables, with the models and the further runs of the first time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import analysis
from bench.analysis import (
    BASELINES,
    BEFORE,
    LIMITS_YAML,
    ROTATION,
    Model,
    analyse,
    diagnose,
    judged_by,
    ladder,
    load_limits,
    load_model,
    model_from,
    plain_name,
)
from bench.base import InputError
from bench.commands.replay.changes import Change, trees
from bench.record import (
    CalibrationRecord,
    ComparisonRecord,
    DiagnosisRecord,
    LimitsRecord,
    Record,
    RunFolder,
    StoredFit,
    load,
)

_SKIPPED: dict[type[Record], tuple[str, ...]] = {
    ComparisonRecord: (),
    # Hashes are compared file by file; versions are told, not compared.
    CalibrationRecord: ("data", "software"),
    DiagnosisRecord: ("profile",),
    LimitsRecord: (),
}


@dataclass(frozen=True)
class Circumstances:
    """With what the analysis of a run was made."""

    models: tuple[Model, ...]
    check: tuple[Path, ...]
    static: Path | None
    interval_s: float
    diagnosed: bool
    """The analysis asked for a diagnosis, made or not."""
    diagnosis: DiagnosisRecord | None
    """diagnosis.json, where it was made by a command of its own, with other runs or another model."""

    @classmethod
    def of(cls, run: RunFolder, models: Sequence[str], others: Sequence[Path]) -> Circumstances:
        """Read from the results; runs are looked for in `others` and beside the run. InputError: one is not there."""
        compared, calibrated = ComparisonRecord.find(run.path) or ComparisonRecord(), CalibrationRecord.read(run.path)
        diagnosed = DiagnosisRecord.find(run.path)
        check = tuple(_found(run, name, others) for name in compared.check)
        own = diagnosed is not None and list(diagnosed.check) == [path.resolve().name for path in check]
        own = own and diagnosed is not None and diagnosed.model in {model.name for model in compared.models}
        static, asked = compared.static, compared.diagnosed
        if "diagnosed" not in compared.model_fields_set:  # a comparison of an older bench does not say either
            static = diagnosed.static if diagnosed else None
            asked = own or any("not diagnosed" in text for text in calibrated.verdict.warnings)
        return cls(
            models=tuple(_models(run, compared, calibrated.calibration, models)),
            check=check,
            static=None if static is None else _found(run, static, others),
            interval_s=calibrated.averaging_s,
            diagnosed=asked,
            diagnosis=None if own else diagnosed,
        )


def numbers(run: RunFolder, made: RunFolder, how: Circumstances, others: Sequence[Path]) -> Iterator[Change]:
    """What differs between the results of a run and those of the remade one."""
    analysis = analyse(made.path, how.models, how.check, how.interval_s, static=how.static, diagnose=how.diagnosed)
    if (run.path / LimitsRecord.FILE).is_file() and (made.path / LIMITS_YAML).is_file():
        judged_by(analysis, load_limits(made.path / LIMITS_YAML))
    if how.diagnosis is not None:
        _rediagnosed(run, made, how.diagnosis, how, others).write(made.path)
    for kind, skip in _SKIPPED.items():
        then, now = (record.content() if (record := kind.find(at.path)) else {} for at in (run, made))
        if then or kind is not LimitsRecord:
            yield from trees(kind.FILE, _plain(then), _plain(now), skip=skip)


def _rediagnosed(
    run: RunFolder, made: RunFolder, known: DiagnosisRecord, how: Circumstances, others: Sequence[Path]
) -> DiagnosisRecord:
    """A diagnosis of `bench diagnose` made again."""
    paths = [made.path if name == made.path.name else _found(run, name, others) for name in known.runs]
    fine = [load(path, 1.0) for path in paths]
    model = next((m for m in how.models if m.name == known.model), None) or load_model(known.model)
    static = None if known.static is None else _found(run, known.static, others)
    still = None if static is None else load(static, 1.0)
    found = diagnose(
        [load(path, how.interval_s) for path in paths],
        model,
        check=[load(_found(run, name, others), how.interval_s) for name in known.check],
        static=None if static is None else load(static, how.interval_s),
        floor_dph=analysis.noise_floor(fine, how.interval_s, still).floor_dph,
    )
    return DiagnosisRecord.model_validate({**found.to_json(), "next_experiment": known.next_experiment})


def _models(
    run: RunFolder, compared: ComparisonRecord, calibration: StoredFit | None, wanted: Sequence[str]
) -> Iterator[Model]:
    """The models of the comparison: those given, those that the run keeps, that of the calibration, or by name."""
    named = [*(model.name for model in compared.models), *(model.name for model in compared.refused)]
    listed = dict.fromkeys(map(plain_name, named))
    baselines = {model.name for model in ladder()[:BASELINES]} | {ROTATION}
    files = sorted(run.path.glob("model*.yaml"), key=lambda file: (len(file.name), file.name))
    kept = [*map(load_model, files), *map(load_model, wanted)]
    known = {model.name: model for model in kept}
    if calibration is not None:
        known.setdefault(plain_name(calibration.model.name), model_from(calibration.model.description()))
    order = {name: i for i, name in enumerate(known)}
    for name in sorted(filter(lambda name: name not in baselines, listed), key=lambda name: order.get(name, 99)):
        yield known[name] if name in known else _named(run, name)


def _named(run: RunFolder, name: str) -> Model:
    try:
        return load_model(name)
    except InputError:
        raise InputError(f"was analysed with the model '{name}', which it does not keep; give it with --model",
                         run.path) from None  # fmt: skip


def _found(run: RunFolder, name: str, others: Sequence[Path]) -> Path:
    """A further run of the analysis, by name."""
    for path in (*others, run.path.resolve().parent / name):
        if path.resolve().name == name and path.is_dir():
            return path
    raise InputError(f"was analysed with the run '{name}', which is not beside it; name it with --with", run.path)


def _plain(content: dict[str, Any]) -> dict[str, Any]:
    """Without the remark that an earlier diagnosis was kept: that happened, it was not computed."""
    verdict = content.get("verdict")
    if not isinstance(verdict, dict):
        return content
    kept = [text for text in verdict.get("warnings", ()) if BEFORE not in text]
    return {**content, "verdict": {**verdict, "warnings": kept}}
