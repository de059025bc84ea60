"""The analysis of a run made again on its remade tables, with the models and the further runs of the first time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.analysis import (
    BASELINES,
    BEFORE,
    LIMITS_JSON,
    LIMITS_YAML,
    SAVED,
    Model,
    analyse,
    diagnose,
    judged_by,
    ladder,
    load_limits,
    load_model,
    model_from,
)
from bench.base import InputError
from bench.commands.replay.changes import Change, trees
from bench.record import RunFolder, load

_SKIPPED = {
    "compare.json": (),
    # Hashes are compared file by file; versions are told, not compared.
    "calibration.json": ("data", "software"),
    SAVED: ("profile",),
    LIMITS_JSON: (),
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
    diagnosis: Mapping[str, Any] | None
    """diagnosis.json, where it was made by a command of its own, with other runs or another model."""

    @classmethod
    def of(cls, run: RunFolder, models: Sequence[str], others: Sequence[Path]) -> Circumstances:
        """Read from the results; runs are looked for in `others` and beside the run. InputError: one is not there."""
        compared, calibrated = (_json(run.path / name) for name in ("compare.json", "calibration.json"))
        diagnosed = _json(run.path / SAVED)
        check = tuple(_found(run, str(name), others) for name in compared.get("check", ()))
        own = [str(name) for name in diagnosed.get("check", ())] == [path.resolve().name for path in check]
        own = own and diagnosed.get("model") in {entry["name"] for entry in compared.get("models", ())}
        static = diagnosed.get("static")
        warned = (calibrated.get("verdict") or {}).get("warnings", ())
        return cls(
            models=tuple(_models(run, compared, calibrated.get("calibration"), models)),
            check=check,
            static=None if static is None else _found(run, str(static), others),
            interval_s=float(calibrated.get("averaging_s") or 30.0),
            diagnosed=(bool(diagnosed) and own) or any("not diagnosed" in text for text in warned),
            diagnosis=diagnosed if diagnosed and not own else None,
        )


def numbers(run: RunFolder, made: RunFolder, how: Circumstances, others: Sequence[Path]) -> Iterator[Change]:
    """What differs between the results of a run and those of the remade one."""
    analysis = analyse(made.path, how.models, how.check, how.interval_s, static=how.static, diagnose=how.diagnosed)
    if (run.path / LIMITS_JSON).is_file() and (made.path / LIMITS_YAML).is_file():
        judged_by(analysis, load_limits(made.path / LIMITS_YAML))
    if how.diagnosis is not None:
        _write(made.path / SAVED, _rediagnosed(run, made, how, others))
    for name, skip in _SKIPPED.items():
        then, now = _json(run.path / name), _json(made.path / name)
        if then or name != LIMITS_JSON:
            yield from trees(name, _plain(then), _plain(now), skip=skip)


def _rediagnosed(run: RunFolder, made: RunFolder, how: Circumstances, others: Sequence[Path]) -> dict[str, Any]:
    """A diagnosis of `bench diagnose` made again."""
    from bench.analysis import noise_floor

    known = how.diagnosis or {}
    paths = [made.path if name == made.path.name else _found(run, str(name), others) for name in known["runs"]]
    fine = [load(path, 1.0) for path in paths]
    model = next((m for m in how.models if m.name == known["model"]), None) or load_model(str(known["model"]))
    still = None if how.static is None else load(how.static, 1.0)
    found = diagnose(
        [load(path, how.interval_s) for path in paths],
        model,
        check=[load(_found(run, str(name), others), how.interval_s) for name in known["check"]],
        static=None if how.static is None else load(how.static, how.interval_s),
        floor_dph=noise_floor(fine, how.interval_s, still).floor_dph,
    )
    content = found.to_json()
    return {**content, "next_experiment": known.get("next_experiment")}


def _models(run: RunFolder, compared: Mapping[str, Any], calibration: Any, wanted: Sequence[str]) -> Iterator[Model]:
    """The models of the comparison: those given, those that the run keeps, that of the calibration, or by name."""
    listed = [str(entry["name"]) for entry in (*compared.get("models", ()), *compared.get("refused", ()))]
    baselines = {model.name for model in ladder()[:BASELINES]}
    files = sorted(run.path.glob("model*.yaml"), key=lambda file: (len(file.name), file.name))
    kept = [*map(load_model, files), *map(load_model, wanted)]
    known = {model.name: model for model in kept}
    if isinstance(calibration, Mapping):
        described = calibration["model"]
        entries = [{entry["effect"]: entry["options"]} for entry in described["effects"]]
        content = {"name": described["name"], "rows": described["rows"], "effects": entries}
        known.setdefault(described["name"], model_from(content))
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


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")


def _json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"not readable as JSON ({error}); make it anew with `bench report`", path) from error
    return content if isinstance(content, dict) else {}
