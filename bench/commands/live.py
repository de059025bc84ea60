"""Commands that meet a live run: status, hold, pause, resume, abort."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.acquisition import (
    ANSWER_S,
    LIVE,
    LiveRun,
    ask_run,
    ending_of,
    live_at,
    live_below,
    only_live_run,
    wait_until,
)
from bench.base import EquipmentError, InputError
from bench.commands.answer import Answer
from bench.record import MANIFEST

REACTION_S = 10.0
"""A run does what it is asked at its next tick, a second; a slow controller may take a few more."""
ENDING_S = 180.0
"""The safe state is reached and read back within this time, or the operator is told that it is not known."""

REACHED = {
    "hold": ({"holding"}, "holding"),
    "pause": ({"pausing", "holding"}, "will hold after this segment"),
    "resume": ({"running"}, "goes on"),
}
"""What each request leads to: states, and the words for it."""


def status(folder: Path | None, out: Path) -> Answer:
    """`bench status`: one live run, or all of them."""
    runs = live_below(out) if folder is None else [only_live_run(folder, out)]
    answers = [_state(run) for run in runs]
    text = "\n\n".join(text_of(answer) for answer in answers) or f"no live run below {out}"
    silent = any(answer["state"] == "silent" for answer in answers)
    return Answer({"runs": answers}, text, 4 if silent else 0)


def act_on_run(action: str, folder: Path | None, out: Path) -> Answer:
    """`bench hold`, `pause` and `resume` of a live run: ask, and see it done."""
    run = only_live_run(folder, out)
    ask_run(run, action)
    states, words = REACHED[action]
    try:
        answer = wait_until(run, lambda answer: answer["state"] in states, REACTION_S)
    except EquipmentError:
        if not (run.path / LIVE).exists():
            raise InputError("this run has ended meanwhile; `bench report` says how", run.path) from None
        raise
    content = _describe(run, answer)
    if answer["state"] in states:
        return Answer(content, f"{words}\n{text_of(content)}")
    guards = f": {'; '.join(answer['holding'])}" if answer.get("holding") else ""
    return Answer(content, f"asked to {action}, but the run is {answer['state']}{guards}\n{text_of(content)}", 1)


def resume(folder: Path | None, station: Path | None, out: Path, quiet: bool) -> Answer:
    """`bench resume`: go on with a live run that holds, or with one whose bench was killed."""
    from bench.commands import analysis
    from bench.commands.resuming import go_on

    if folder is None or ((found := live_at(folder)) is not None and found.condition() != "gone"):
        return act_on_run("resume", folder, out)
    whole = (folder / MANIFEST).exists()
    run = analysis.recover(folder)
    (folder / LIVE).unlink(missing_ok=True)  # its process is gone
    if not whole and run.manifest()["state"] == "done":
        return analysis.resume(folder)
    return go_on(run, station, quiet)


def abort(folder: Path | None, out: Path) -> Answer:
    """`bench abort`: end a live run, and say what the safe state reached."""
    run = only_live_run(folder, out)
    ask_run(run, "abort")
    events = ending_of(run, ENDING_S)
    steps = [event for event in events if event["kind"] == "safe_state" and "ok" in event]
    end = next((event for event in events if event["kind"] == "end"), None)
    if end is None:
        raise EquipmentError(f"{run.path}: told to abort, but how it ended is not known; LOOK AT THE CHAMBER")
    content = {
        "run": str(run.path),
        "state": end["state"],
        "cause": end["text"],
        "safe": all(step["ok"] for step in steps),
        "safe_state": [{"text": step["text"], "ok": step["ok"]} for step in steps],
    }
    return how_it_ended(content)


def how_it_ended(content: dict[str, Any]) -> Answer:
    """An end (`run`, `cause`, `safe`, `safe_state`) as text, and its exit code."""
    lines = [f"{'ok  ' if step['ok'] else 'FAIL'}  {step['text']}" for step in content["safe_state"]]
    if content["safe"] and not lines:
        lines = ["nothing had moved: the chamber is as it was found"]
    if not content["safe"]:
        lines += ["SAFE STATE NOT VERIFIED: switch the chamber off by hand"]
    text = "\n".join([content["cause"], *lines, f"run     {content['run']}"])
    return Answer(content, text, 0 if content["safe"] else 4)


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


def text_of(run: dict[str, Any]) -> str:
    """A live run as lines for a terminal."""
    lines = [f"{run['run']}  {run['state']}"]
    if "error" in run:
        lines.append(f"  {run['error']}")
    if "segment" in run:
        segment, chamber = run["segment"], run["chamber"]
        lines += [
            f"  segment  {segment['index'] + 1}/{segment['of']} {segment['name']}, {_clock(segment['left_s'])} left",
            f"  time     {_clock(run['t_s'])}, {_clock(run['left_s'])} left",
            f"  chamber  {_number(chamber['temperature_degc'])} degC, "
            f"set point {_number(chamber['setpoint_degc'])} degC",
        ]
        lines += [
            f"  unit     {unit['serial']}: {_number(unit['temperature_degc'])} degC, "
            f"{unit['losses']['received']} frames, {unit['losses']['lost']} lost"
            + (f", dropped: {unit['dropped']}" if unit["dropped"] else "")
            for unit in run["units"]
        ]
        lines += [
            f"  bus      {bus['bus']}: {bus['state']}, {bus['frames']} frames, {bus['behind_s']:.2f} s behind, "
            f"at most {bus['most_behind_s']:.2f} s"
            for bus in run.get("buses", ())
        ]
        lines += [_fits(serial, found) for serial, found in run.get("fits", {}).items()]
        lines += [f"  HOLD     {cause}" for cause in run["holding"]]
    if run.get("age_s", 0.0) > ANSWER_S:
        lines.append(f"  the loop of this run has not ticked for {run['age_s']:.0f} s")
    return "\n".join(lines)


def _fits(serial: str, found: dict[str, Any]) -> str:
    scores = ", ".join(
        f"{model['name']} {_number(model['rms_dph'])} (held out {_number(model['held_out_rms_dph'])})"
        for model in found["models"]
    )
    seen = f"{found['from_degc']:.1f} to {found['to_degc']:.1f} degC, {_clock(found['seconds'])}"
    return f"  model    {serial}: {scores} deg/h RMS of 1 s means, {seen}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
