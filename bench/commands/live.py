"""Commands that meet a live run: status, hold, pause, resume, abort."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.acquisition import (
    LiveRun,
    ask_run,
    ending_of,
    live_at,
    live_below,
    only_live_run,
    wait_until,
)
from bench.base import EquipmentError, InputError
from bench.commands.results.live import REACHED, Aborted, Asked, LiveRuns, Recovered
from bench.record import LIVE, MANIFEST

if TYPE_CHECKING:
    from bench.commands.results.analyse import Reported, UnitsReported

REACTION_S = 10.0
"""A run does what it is asked at its next tick, a second; a slow controller may take a few more."""
ENDING_S = 180.0
"""The safe state is reached and read back within this time, or the operator is told that it is not known."""


def status(folder: Path | None, out: Path) -> LiveRuns:
    """`bench status`: one live run, or all of them."""
    runs = live_below(out) if folder is None else [only_live_run(folder, out)]
    return LiveRuns(f"below {out}", [_state(run) for run in runs])


def act_on_run(action: str, folder: Path | None, out: Path) -> Asked:
    """`bench hold`, `pause` and `resume` of a live run: ask, and see it done."""
    run = only_live_run(folder, out)
    ask_run(run, action)
    try:
        answer = wait_until(run, lambda answer: answer["state"] in REACHED[action][0], REACTION_S)
    except EquipmentError:
        if not (run.path / LIVE).exists():
            raise InputError("this run has ended meanwhile; `bench report` says how", run.path) from None
        raise
    return Asked(action, str(run.path), _describe(run, answer))


def resume(
    folder: Path | None, station: Path | None, out: Path, quiet: bool
) -> Asked | Recovered | Reported | UnitsReported:
    """`bench resume`: go on with a live run that holds, or with one whose bench was killed."""
    from bench.commands import analysis
    from bench.commands.resuming import go_on

    if folder is None or ((found := live_at(folder)) is not None and found.condition() != "gone"):
        return act_on_run("resume", folder, out)
    whole = (folder / MANIFEST).exists()
    run = analysis.recover(folder)
    (folder / LIVE).unlink(missing_ok=True)  # its process is gone
    if not whole and run.manifest().state == "done":
        analysis.report(folder, ())  # nothing was left to do but this
        return Recovered(folder, run.manifest())
    return go_on(run, station, quiet)


def abort(folder: Path | None, out: Path) -> Aborted:
    """`bench abort`: end a live run, and say what the safe state reached."""
    run = only_live_run(folder, out)
    ask_run(run, "abort")
    events = ending_of(run, ENDING_S)
    steps = [event for event in events if event["kind"] == "safe_state" and "ok" in event]
    end = next((event for event in events if event["kind"] == "end"), None)
    if end is None:
        raise EquipmentError(f"{run.path}: told to abort, but how it ended is not known; LOOK AT THE CHAMBER")
    return Aborted(
        {
            "run": str(run.path),
            "state": end["state"],
            "cause": end["text"],
            "safe": all(step["ok"] for step in steps),
            "safe_state": [{"text": step["text"], "ok": step["ok"]} for step in steps],
        }
    )


def _state(run: LiveRun) -> dict[str, Any]:
    try:
        return _describe(run, ask_run(run, "status"))
    except (EquipmentError, InputError) as error:
        gone = run.condition() == "gone"
        return {
            "run": str(run.path),
            "pid": run.file.pid,
            "state": "gone" if gone else "silent",
            "error": f"its process is gone; `bench resume {run.path}` goes on with it" if gone else str(error),
        }


def _describe(run: LiveRun, answer: dict[str, Any]) -> dict[str, Any]:
    known = {key: value for key, value in answer.items() if key != "ok"}
    return {"run": str(run.path), "folders": [str(folder) for folder in run.folders], **known}
