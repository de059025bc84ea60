"""Diagnosis of a whole fleet: what the model of each unit lacks, by the newest judged run of its profile.

A diagnosis that a run folder has serves where it is of the same model. The others are made by an engine; each is
written into its run folder as it comes, so that the next start goes on there.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import scipy

from bench.analysis import NEXT_PROFILE, Model, diagnosed, noise_floor, one_blas_thread, set_aside
from bench.archive.fleet.drift import SIGNIFICANT
from bench.archive.fleet.engines import Engine, Work
from bench.archive.fleet.selection import Selection, lot_of
from bench.archive.fleet.units import as_shown, standing
from bench.archive.registry.asking import runs
from bench.archive.registry.ledger import Ledger
from bench.archive.registry.opening import Registry
from bench.archive.registry.writing import register_all
from bench.base import BenchError, InputError
from bench.record import DEFAULT_INTERVAL_S, MANIFEST, DiagnosisRecord, RunFolder, averaged, put, seconds_of

_BATCH = 100
"""Diagnoses that are written into the registry together."""


@dataclass(frozen=True)
class Answer:
    """Of a run folder: its diagnosis and the profile of the next experiment, as texts, or why there is none."""

    folder: str
    record: str = ""
    profile: str = ""
    error: str = ""


@dataclass(frozen=True)
class Told:
    """What is known of a unit: its lot, the word of its diagnosis, and the effects that its model lacks."""

    unit: str
    lot: str
    verdict: str
    lacks: tuple[str, ...]


@dataclass
class FleetDiagnosis:
    """Result of `diagnose_fleet`: what is known of each unit, what was made anew, and what could not be."""

    told: list[Told] = field(default_factory=list)
    made: int = 0
    failed: list[str] = field(default_factory=list)
    left_out: tuple[str, ...] = ()


def diagnose_folder(model: Model, folder: str) -> Answer:
    """Diagnose a run by its own rows; any error ends in its answer and stops nothing."""
    try:
        seconds = seconds_of(Path(folder))
        data = averaged(seconds, DEFAULT_INTERVAL_S)
        floor = noise_floor([averaged(seconds, 1.0)], DEFAULT_INTERVAL_S, intervals=False)
        plan = Path(folder) / NEXT_PROFILE
        found = diagnosed(data, model, (), None, floor.floor_dph, plan, workers=1)
    except BenchError as error:
        return Answer(folder, error=str(error))
    except Exception as bug:
        return Answer(folder, error=f"internal error: {type(bug).__name__}: {bug}")
    if found.answer is None:
        return Answer(folder, error=found.reason)
    return Answer(folder, DiagnosisRecord.model_validate(found.answer.to_json()).text(), found.profile_yaml)


def diagnose_folders(model: Model, folders: Sequence[str]) -> list[Answer]:
    """Answers of several runs, in their order."""
    with one_blas_thread():
        return [diagnose_folder(model, folder) for folder in folders]


def _lost(folders: Sequence[str], why: str) -> list[Answer]:
    return [Answer(folder, error=f"not diagnosed: {why}") for folder in folders]


def diagnose_fleet(  # noqa: PLR0913 - options of one command, by keyword
    registry: Registry,
    ledger: Ledger,
    model: Model,
    engine: Callable[[int], Engine],
    selection: Selection | None = None,
    *,
    part: str = "",
    again: bool = False,
) -> FleetDiagnosis:
    """Diagnose the newest judged run of each unit, of those selected, where that is not done yet.

    `engine` is made for so many runs; `part`: of units with this in their serial number.
    """
    found = [run for run in runs(registry, archive=ledger.id) if part in run["unit"]]
    chosen, left_out = as_shown(registry, selection, _having(part)).of(found)
    waiting = [
        str(ledger.root / run["path"]) for run in standing(chosen) if again or run["diagnosed_model"] != model.name
    ]
    written = [] if again else [folder for folder in waiting if _there(Path(folder), model)]
    waiting = sorted(set(waiting) - set(written))
    done = FleetDiagnosis(left_out=left_out)
    try:
        for (answer,) in engine(len(waiting))(_work(model, ledger), [(one,) for one in waiting]) if waiting else ():
            if why := answer.error or _written(answer):
                done.failed.append(f"{Path(answer.folder).parent.name}: {why}")
                continue
            done.made += 1
            written.append(answer.folder)
            if len(written) >= _BATCH:
                _register(registry, ledger, written)
    finally:
        _register(registry, ledger, written)
    done.told = known_lacks(registry, selection, model.name, ledger.id, part).told
    return done


def _having(part: str) -> str | None:
    """Pattern of serial numbers with this in them."""
    return f".*{re.escape(part)}.*" if part else None


@dataclass(frozen=True)
class KnownLacks:
    """What is known of the fleet by a model: of these units; `models`: how many units each model was diagnosed on."""

    model: str
    models: dict[str, int]
    told: list[Told]


def known_lacks(
    registry: Registry,
    selection: Selection | None = None,
    model: str | None = None,
    archive: str | None = None,
    part: str = "",
) -> KnownLacks:
    """The diagnoses of the newest judged run of each unit, of those selected, by `model`, or by that of most units.

    `part`: of units with this in their serial number.
    """
    selection = as_shown(registry, selection, _having(part))
    found = runs(registry, archive=archive, among=selection.among())
    chosen, _ = selection.of([run for run in found if part in run["unit"]])
    newest = standing(chosen)
    models = Counter(run["diagnosed_model"] for run in newest if run["diagnosed_model"])
    model = model or next((name for name, _ in models.most_common(1)), "")
    told = [
        Told(unit, lot_of(unit, run["lot"]), run["diagnosis"], tuple(filter(None, run["lacks"].split(","))))
        for unit, run in ((run["unit"], run) for run in newest)
        if model and run["diagnosed_model"] == model
    ]
    return KnownLacks(model, dict(models), told)


def _work(model: Model, ledger: Ledger) -> Work[tuple[str, ...], Answer]:
    return Work(partial(diagnose_folders, model), _lost, ledger.root.resolve())


def _there(folder: Path, model: Model) -> bool:
    """Whether a folder has a diagnosis of this model that the registry does not know yet."""
    with suppress(InputError):  # one that is damaged is made anew
        record = DiagnosisRecord.find(folder)
        return record is not None and record.model == model.name
    return False


def _written(answer: Answer) -> str:
    """Write an answer into its folder; why that failed, else ''."""
    folder = Path(answer.folder)
    files = {DiagnosisRecord.FILE: answer.record.encode()}
    try:
        record = DiagnosisRecord.parse(files[DiagnosisRecord.FILE], folder / DiagnosisRecord.FILE)
        set_aside(folder, record)
        put(folder, files | ({NEXT_PROFILE: answer.profile.encode()} if answer.profile else {}), [MANIFEST])
    except (InputError, OSError) as error:
        return str(error)
    return ""


def _register(registry: Registry, ledger: Ledger, folders: list[str]) -> None:
    """Write the rows of run folders into the registry, and empty the list."""
    if folders:
        register_all(registry, [RunFolder(Path(folder)) for folder in folders], ledger)
        folders.clear()


def by_lot(told: Sequence[Told]) -> dict[str, Lot]:
    """The table of lots, by name."""
    found: dict[str, Lot] = {}
    for one in sorted(told, key=lambda one: one.lot):
        lot = found.setdefault(one.lot, Lot())
        lot.units += 1
        lot.verdicts[one.verdict] += 1
        lot.lacks.update(one.lacks)
    return found


@dataclass
class Lot:
    """Of a lot: its units, how many have which word of the diagnosis, and how many lack which effect."""

    units: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    lacks: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class Common:
    """An effect that units of a lot lack more often than others: how many of how many, in the lot and elsewhere."""

    effect: str
    lot: str
    lacking: int
    units: int
    elsewhere: int
    of_elsewhere: int
    p: float
    """Chance of so many by drawing without regard to lots (hypergeometric), times the number of pairs looked at."""


def in_common(told: Sequence[Told]) -> list[Common]:
    """What a lot has in common: effects with p < 1 %, the least first."""
    lots = Counter(one.lot for one in told)
    lacking = Counter((effect, one.lot) for one in told for effect in one.lacks)
    effects = Counter(effect for one in told for effect in one.lacks)
    found = []
    for (effect, lot), count in lacking.items():
        chance = float(scipy.stats.hypergeom.sf(count - 1, len(told), effects[effect], lots[lot]))
        p = min(1.0, chance * len(effects) * len(lots))
        if p < SIGNIFICANT:
            rest = effects[effect] - count, len(told) - lots[lot]
            found.append(Common(effect, lot, count, lots[lot], *rest, p))
    return sorted(found, key=lambda one: (one.p, one.effect, one.lot))
