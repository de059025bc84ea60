"""`bench resume` of a run whose bench was killed: recover, go back to where it was, and go on."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from bench.base import InputError, load_config, read_text
from bench.commands.analysis import DEFAULT_MODELS, report_on
from bench.commands.answer import Answer
from bench.commands.several import report_on_all
from bench.record import RunFolder

if TYPE_CHECKING:
    from bench.acquisition import Job, RunResult

QUIET_S = 3.0
"""A bench that runs writes its journals at least once a second."""


def go_on(run: RunFolder, station_path: Path | None, quiet: bool) -> Answer:
    """Append what is left of a recovered run as a new part, and analyse it."""
    from bench.analysis import load_model

    job = _rest(run, station_path)
    files = sorted(run.path.glob("model*.yaml"), key=lambda file: (len(file.name), file.name))
    models = [load_model(model) for model in files or DEFAULT_MODELS]
    result = _carry_out(job, quiet)
    if len(result.units) > 1:
        return report_on_all(result.units, models)
    return report_on(result.run, models, result.error)


def continued(run: RunFolder, station_path: Path | None, quiet: bool) -> RunResult:
    """Append what is left of a recovered run as a new part; InputError when there is nothing to go on with."""
    return _carry_out(_rest(run, station_path), quiet)


def _rest(run: RunFolder, station_path: Path | None) -> Job:
    """What is left to do; InputError when there is nothing to go on with."""
    from bench.acquisition import Job, StationSettings, check_profile, load_profile, plan, refuse_errors

    profile_path, own_station = run.path / "profile.yaml", run.path / "station.yaml"
    if not any(run.journal.glob("*.gtbj")):
        raise InputError("this run has no journals (it was imported): nothing to resume", run.path)
    profile = load_profile(profile_path)
    station = load_config(station_path or own_station, StationSettings)
    refuse_errors(check_profile(profile, station.limits()))
    continuation = plan(run, profile, station)
    if not station.simulated:
        _refuse_growing(run)
    return Job(
        profile=profile,
        profile_text=read_text(profile_path),
        station=continuation.units(station).remembering(run.path.parent.parent),
        station_text=read_text(station_path or own_station),
        model_texts={},
        serials=continuation.serials,
        compensation="on" if run.manifest().get("purpose") == "verification" else "off",
        continuation=continuation,
    )


def _carry_out(job: Job, quiet: bool) -> RunResult:
    from bench.acquisition import Desk, run_job
    from bench.commands.terminal.following import Following
    from bench.commands.terminal.keyboard import Keyboard
    from bench.commands.terminal.progress import Progress

    desk = Desk()
    with Keyboard(desk) as keyboard, Progress(job.profile, quiet, lambda: keyboard.notice) as progress:
        return run_job(job, Following(job.profile, desk, progress), desk)


def _refuse_growing(run: RunFolder) -> None:
    """Two benches must never command one chamber: a run that is still written is live, whatever its files say."""

    def size() -> int:
        return sum(file.stat().st_size for part in run.parts() for file in part.journal.iterdir())

    newest_s = max(file.stat().st_mtime for part in run.parts() for file in part.journal.iterdir())
    if time.time() - newest_s > QUIET_S:
        return
    before = size()
    time.sleep(QUIET_S)
    if size() != before:
        raise InputError("this run is still being written by a bench that does not answer; end that first", run.path)
