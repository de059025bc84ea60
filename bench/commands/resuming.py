"""`bench resume` of a run whose bench was killed: recover, go back to where it was, and go on."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from bench import acquisition
from bench.base import Document, InputError, NotResumableError, load_config, read_yaml
from bench.commands.acquisition import carry_out, station_of
from bench.commands.analysis import kept_models
from bench.commands.registering import see_again
from bench.commands.several import report_on_units
from bench.record import RunFolder, use

if TYPE_CHECKING:
    from bench.commands.results.analyse import Reported, UnitsReported

QUIET_S = 3.0
"""A bench that runs writes its journals at least once a second."""


def go_on(run: RunFolder, station: Path | None, quiet: bool) -> Reported | UnitsReported:
    """Append what is left of a recovered run as a new part, and analyse it."""
    job, models = _rest(run, station), kept_models(run.path)
    return report_on_units(carry_out(job, quiet), models)


def continued(run: RunFolder, station: Path | Document | None, quiet: bool) -> acquisition.RunResult:
    """Append what is left of a recovered run as a new part; NotResumableError when there is nothing to go on with."""
    result = carry_out(_rest(run, station), quiet)
    for unit in result.units:
        see_again(unit.run.path)
    return result


def _rest(run: RunFolder, given: Path | Document | None) -> acquisition.Job:
    """What is left to do; NotResumableError when there is nothing to go on with."""
    if not any(run.journal.glob("*.gtbj")):
        raise NotResumableError("this run has no journals (it was imported): nothing to resume", run.path)
    use(run.path, "profile.yaml", "station.yaml")
    profile_file = read_yaml(run.path / "profile.yaml")
    station_file = given if isinstance(given, Document) else read_yaml(given or run.path / "station.yaml")
    profile = acquisition.load_profile(profile_file)
    station = station_of(station_file) if given else _unmoved(load_config(station_file, acquisition.StationSettings))
    acquisition.refuse_errors(acquisition.check_profile(profile, station.limits()))
    continuation = acquisition.plan(run, profile, station)
    if not station.simulated:
        _refuse_growing(run)
    return acquisition.Job(
        profile=profile,
        profile_text=profile_file.text,
        station=continuation.units(station).remembering(run.path.parent.parent),
        station_text=station_file.text,
        model_texts={},
        serials=continuation.serials,
        compensation="on" if run.manifest().purpose == "verification" else "off",
        continuation=continuation,
    )


def _unmoved(station: acquisition.StationSettings) -> acquisition.StationSettings:
    """A station by its copy in the run folder: what the station file names beside itself is not beside the copy."""
    if station.notify is None or Path(station.notify).is_file():
        return station
    text = f"{station.notify} is not found from here: nobody is told how this run ends; --station FILE finds it"
    print(f"bench: {text}", file=sys.stderr)
    return station.model_copy(update={"notify": None})


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
