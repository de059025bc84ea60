"""`bench decide`: diagnose, make the run that is proposed, and diagnose all together, until it is decided."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from bench.analysis import Diagnosis
from bench.base import InputError
from bench.commands.acquisition import Task, conduct, load_station, refuse_wrong
from bench.commands.diagnosis import diagnose
from bench.commands.results.analyse import Decided, Round
from bench.record import Manifest, RunFolder


def decide(  # noqa: PLR0913, PLR0917 - options of one command
    runs: Sequence[Path],
    check: Sequence[Path],
    static: Path | None,
    model: str,
    station: Path | None,
    most: int,
    out: Path,
    quiet: bool,
    sisters: Sequence[Path] = (),
) -> Decided:
    """Diagnose and run what is proposed, at most `most` times.

    Raises InputError: before any diagnosis, a folder that cannot be written, and a station that is named and is not
    there, has not the unit, or simulates while the runs are of real equipment; runs that cannot be diagnosed; a profile
    that the station cannot run. Ends with the error of a run that was not completed.
    """
    manifest = RunFolder(runs[0]).manifest()
    _refuse_unwritable((runs[0], out))
    if station is not None:  # the runs alone may decide, and then need none
        _refuse_station(manifest, station)
    known = {"run": list(runs), "check": list(check), "static": [] if static is None else [static]}
    rounds: list[Round] = []
    while True:
        plan = runs[0] / f"decide_{len(rounds) + 1}.yaml"
        still = next(iter(known["static"]), None)
        found = diagnose(known["run"], known["check"], still, model, plan, sisters=sisters).diagnosis
        proposed = found.next_experiment
        if proposed is None:
            return Decided(found, True, _settled(found, rounds), tuple(rounds))
        use, why = str(proposed["use"]), str(proposed["why"])
        reason = _no_more(use, bool(proposed["decides"]), len(rounds), most)
        if reason:
            return Decided(found, False, reason, (*rounds, Round(plan, use, why)))
        _refuse_station(manifest, station)
        result = conduct(plan, station, Task((manifest.unit,), {}, out), quiet)
        if result.error is not None:
            raise result.error
        rounds.append(Round(plan, use, why, result.run.path))
        known[use].append(result.run.path)


def _refuse_station(manifest: Manifest, station: Path | None) -> None:
    """A station that cannot make the run that is proposed."""
    settings = load_station(station)
    if manifest.simulated is False and settings.simulated:
        text = f"{manifest.run} is of real equipment, and the proposed run would be simulated"
        how = "name the station that has the unit with --station, or run what `bench diagnose` proposes there"
        raise InputError(f"{text}: {how}", station)
    settings.chosen([manifest.unit])
    refuse_wrong(settings)


def _refuse_unwritable(written: Sequence[Path]) -> None:
    """Folders that what is proposed, and its run, cannot be written to."""
    for folder in written:
        there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
        if not (there.is_dir() and os.access(there, os.W_OK)):
            raise InputError("cannot be written: it is no folder, or it is read-only; choose another place", there)


def _settled(found: Diagnosis, rounds: Sequence[Round]) -> str:
    how = f"with {len(rounds)} further run{'s' * (len(rounds) != 1)}" if rounds else "by the runs given"
    return f"decided {how}: nothing is left that another profile would tell apart ({found.verdict})"


def _no_more(use: str, decides: bool, made: int, most: int) -> str:
    """Why the proposed run is not made; empty where it is."""
    if not decides:
        return "not decided: no profile within the limits of the chamber would tell these causes apart"
    if use == "by_hand":
        return (
            "not decided: the proposed run needs somebody who moves what the chamber does not; run it, and diagnose all"
        )
    if made >= most:
        return f"not decided after {made} further run{'s' * (made != 1)}; --most allows no more"
    return ""
