"""The end of a run: from its journals at once, from its analysis when that is done."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from bench.acquisition import LiveRun, ending_of
from bench.base import InputError
from bench.record import EVENTS as EVENTS_FILE
from bench.record import (
    CalibrationRecord,
    LimitsRecord,
    Manifest,
    Record,
    RunFolder,
    VerificationRecord,
    read_events,
)

NO_VERDICT: dict[str, Any] = {"analysing": True, "units": [], "verdict": None, "sentence": ""}
_NOT = "not analysed: "
"""Begin of the sentence about a unit whose analysis failed."""
R = TypeVar("R", bound=Record)
EVENTS = ("request", "safe_state", "end")
UNTOLD = frozenset({"write", "rate_table", "attitude"})
"""Kinds of events that the log of a live run does not show."""
MOST_EVENTS = 200


def sound(kind: type[R], folder: Path, damaged: list[str] | None = None) -> R | None:
    """The record in a folder, None where it is missing or damaged: the rest of the run is shown all the same.

    What is wrong with a damaged one goes into `damaged`, which the run's own page shows.
    """
    try:
        return kind.find(folder)
    except InputError as error:
        if damaged is not None:
            damaged.append(str(error))
        return None


def serial_of(folder: Path) -> str:
    """Serial number of the unit of a run, with the characters that the folder's name cannot have."""
    manifest = sound(Manifest, folder)
    return manifest.unit if manifest else folder.parent.name


def ending(run: LiveRun) -> dict[str, Any] | None:
    """The end of a run; None while its process has not written it."""
    events = ending_of(run, 0.0)
    return told(events) if events else None


def told(events: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """State, cause, safe state of the equipment and requests, from the events of a run."""
    end = next((event for event in reversed(events) if _is_end(event)), None)
    # Events on the way to the safe state (warming up, another try) have no `ok`.
    said = [event for event in events if event["kind"] == "safe_state" and "ok" in event]
    steps = [{"text": str(event.get("text", "")), "ok": bool(event["ok"])} for event in said]
    asked = [
        {"request": event.get("request"), "who": event.get("who"), "utc": event.get("utc")}
        for event in events
        if event["kind"] == "request"
    ]
    return {
        "state": str(end.get("state", "aborted")) if end else "aborted",
        "cause": str(end.get("text", "")) if end else "the bench was killed",
        "safe": all(step["ok"] for step in steps) if end else None,
        "safe_state": steps,
        "requests": asked,
    }


def of_folders(folders: Sequence[Path], start: Mapping[str, Any] | None) -> dict[str, Any]:
    """The end of a run whose tables exist; the first folder with an end describes what all folders share.

    `start`: the start that made the run, with its outcome. Without one no process is known to analyse the run.
    """
    seen = [(folder, events(folder)) for folder in folders]
    speaker, said = next((one for one in seen if any(_is_end(event) for event in one[1])), seen[0])
    story = told([event for event in said if event.get("kind") in EVENTS])
    about = sound(Manifest, speaker)
    if about is not None:
        story |= {"state": about.state, "cause": about.cause}
    busy = start is not None and start["state"] in ("starting", "running")
    return {**story, **verdicts(folders, busy, start)}


def events(folder: Path) -> list[dict[str, Any]]:
    """The events in a run folder; none where they cannot be read."""
    with contextlib.suppress(OSError):
        return read_events(folder / EVENTS_FILE).sound
    return []


def newest(events: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The newest events for people, newest first: without writes to registers, which a run makes by the thousand."""
    told = [event for event in events if event["kind"] not in UNTOLD][-MOST_EVENTS:]
    return [
        {name: event.get(name) for name in ("t_s", "utc", "kind", "text")}
        | {name: event[name] for name in ("phase", "segment") if name in event}
        | {name: event[name] for name in ("units", "limit_dph") if event["kind"] == "decision" and name in event}
        for event in reversed(told)
    ]


def _is_end(event: Mapping[str, Any]) -> bool:
    """Whether an event ends the run, and not only the part of one unit."""
    return event.get("kind") == "end" and "sound_until_s" not in event


def verdicts(folders: Sequence[Path], busy: bool = True, start: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The verdict on each unit and the worst of all; `analysing` until the last report is written.

    When no process is `busy` with the analysis, units without a report get a sentence with the reason.
    """
    units = [_verdict(folder) for folder in folders]
    ready = all(unit["analysed"] for unit in units)
    if not busy:
        for unit in units:
            if not unit["analysed"]:
                unit["sentence"] = f"{_NOT}{_why(unit['run'], start)}"
    known = [unit for unit in units if unit["verdict"] is not None] if ready else []
    worst = min(known, key=_rank, default={"verdict": None, "sentence": ""})
    return {
        "analysing": busy and not ready,
        "units": units,
        "verdict": worst["verdict"],
        "sentence": worst["sentence"],
    }


def _why(run: str, start: Mapping[str, Any] | None) -> str:
    """Why a run has no report, from the outcome of its start."""
    if start is None or start["state"] != "ended":
        return "the reason is not known"
    if start["exit_code"] is None:
        return "something ended its process"
    own = next((str(one["sentence"]) for one in start["verdicts"] if one["run"] == run), "")
    return (own.removeprefix(_NOT) if own.startswith(_NOT) else str(start["message"])) or "the reason is not known"


def _rank(unit: Mapping[str, Any]) -> int:
    from bench.commands import WORST_FIRST

    return WORST_FIRST.index(unit["verdict"]) if unit["verdict"] in WORST_FIRST else 0


def _verdict(folder: Path) -> dict[str, Any]:
    calibration, verified = sound(CalibrationRecord, folder), sound(VerificationRecord, folder)
    if verified is not None:  # whatever a report on it says: nothing is fitted to a unit that corrects itself
        calibration = None
    judged = verified or sound(LimitsRecord, folder)
    return {
        "unit": serial_of(folder),
        "run": f"{folder.parent.name}/{folder.name}",
        "verdict": calibration.verdict.verdict if calibration else None,
        "sentence": calibration.verdict.sentence if calibration else verified.sentence if verified else "",
        "limits": judged.verdict if judged else None,
        "analysed": verified is not None or RunFolder(folder).report.is_file(),
        "verified": verified is not None,
    }


def state_of(content: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict on a unit from the answer of `bench run --json`."""
    limits = content.get("limits")
    run = Path(str(content.get("run", "")))
    return {
        "unit": content.get("unit") or run.parent.name,
        "run": "/".join(run.parts[-2:]),
        "analysed": bool(content.get("report")),
        "verdict": content.get("verdict"),
        "sentence": content.get("sentence", ""),
        "limits": limits.get("verdict") if isinstance(limits, dict) else None,
    }
