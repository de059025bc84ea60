"""Runs driven from Python: check a profile, execute it on a station, get the record."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import acquisition, commands
from bench.api.runs import Run, open_folder
from bench.base import InputError

if TYPE_CHECKING:
    from bench.acquisition import Station, Status


def run(
    profile: str | Path,
    station: str | Path | None = None,
    *,
    unit: str | None = None,
    onlooker: Callable[[Status], object] | None = None,
    out: str | Path = "reports",
) -> Run:
    """Check a profile, execute it on a station and return the record; `bench run` without its report.

    `station` is a YAML file, the embedded simulator without; `unit` is the serial number of one of its units and may be
    left out where it has one. `onlooker` is called once a second of bench time with the status: `t_s` [s], `leg`,
    `reading` of the chamber, `unit_degc`, what `holding` it. The run folder is made below `out`.

    Raises InputError before anything moves, RunAborted where an operator or a guard ended the run, EquipmentError where
    equipment failed; the safe state is reached first, or its failure is said. A run that was ended keeps its data: the
    exception's note names the folder, which `bench.open` opens.
    """
    job = commands.job_of(Path(profile), _path(station), commands.Task([] if unit is None else [unit], {}, Path(out)))
    serials = [own.serial for own in job.station.units]
    if unit is None and len(serials) > 1:
        raise InputError(
            f"station '{job.station.name}' has {len(serials)} units: give unit=, one of {', '.join(serials)}"
        )

    def look(_: Station, status: Status) -> None:
        if onlooker is not None:
            onlooker(status)

    ended = acquisition.run_job(job, look)
    if ended.error is not None:
        ended.error.add_note(f"what was recorded until then: {ended.run.path}")
        raise ended.error
    return open_folder(ended.run.path)


def check(profile: str | Path, station: str | Path | None = None, limits: str | Path | None = None) -> dict[str, Any]:
    """Everything about a profile that can be known before anything moves, as `bench check --json` gives it.

    `duration_s` [s] and `segments` are those of a rehearsal on the chamber's model, `disk_bytes` what a run will need,
    `findings` what is doubtful, also of `limits` that the run is to be judged by. Raises InputError where the station
    cannot run the profile.
    """
    return commands.check(Path(profile), _path(station), _path(limits)).to_json()


def _path(file: str | Path | None) -> Path | None:
    return None if file is None else Path(file)
