"""Results of `bench status`, `hold`, `pause`, `resume` and `abort`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bench.base import clock
from bench.cli.rendering.printing import content, lines
from bench.commands import REACHED, Aborted, Asked, LiveRuns, Recovered


@lines.register(LiveRuns)
def _(result: LiveRuns) -> Iterator[str]:
    if not result.states:
        yield f"no live run {result.place}"
    for i, state in enumerate(result.states):
        yield from [""] if i else []
        yield from live_run(state)


@content.register(LiveRuns)
def _(result: LiveRuns) -> dict[str, Any]:
    return {"runs": list(result.states)}


@lines.register(Asked)
def _(result: Asked) -> Iterator[str]:
    state = result.state
    if result.reached:
        yield f"{result.run}: {REACHED[result.action][1]}"
    else:
        guards = f": {'; '.join(state['holding'])}" if state.get("holding") else ""
        yield f"{result.run}: {result.action} was requested, but the run is {state['state']}{guards}"
    if "run" in state:
        yield from live_run(state)


@content.register(Asked)
def _(result: Asked) -> dict[str, Any]:
    return dict(result.state)


@lines.register(Aborted)
def _(result: Aborted) -> Iterator[str]:
    end = result.end
    yield str(end["cause"])
    yield from (f"{'ok  ' if step['ok'] else 'FAIL'}  {step['text']}" for step in end["safe_state"])
    if not result.safe:
        yield "SAFE STATE NOT VERIFIED: switch the chamber off by hand"
    elif not end["safe_state"]:
        yield "nothing was commanded: the chamber was not changed"
    yield f"run     {end['run']}"


@content.register(Aborted)
def _(result: Aborted) -> dict[str, Any]:
    return dict(result.end)


@lines.register(Recovered)
def _(result: Recovered) -> Iterator[str]:
    manifest = result.manifest
    done = sum(segment.outcome == "done" for segment in manifest.segments)
    yield (
        f"{manifest.state}: {manifest.cause}; {manifest.rows} rows, {done} of {len(manifest.segments)} "
        f"segments complete, {manifest.losses.get('lost', 0)} samples lost"
    )
    yield f"run     {result.run}"


@content.register(Recovered)
def _(result: Recovered) -> dict[str, Any]:
    keys = ("state", "cause", "rows", "duration_s", "losses", "segments")
    content = result.manifest.content()
    return {"run": str(result.run), **{key: content.get(key) for key in keys}}


def live_run(run: Mapping[str, Any]) -> Iterator[str]:
    """The state of a live run."""
    from bench.acquisition import ANSWER_S

    yield f"{run['run']}  {run['state']}"
    if "error" in run:
        yield f"  {run['error']}"
    if "segment" in run:
        segment, chamber = run["segment"], run["chamber"]
        yield f"  segment  {segment['index'] + 1}/{segment['of']} {segment['name']}, {clock(segment['left_s'])} left"
        yield f"  time     {clock(run['t_s'])}, {clock(run['left_s'])} left"
        yield f"  chamber  {_two(chamber['temperature_degc'])} degC, set point {_two(chamber['setpoint_degc'])} degC"
        for unit in run["units"]:
            dropped = f", dropped: {unit['dropped']}" if unit["dropped"] else ""
            yield (
                f"  unit     {unit['serial']}: {_two(unit['temperature_degc'])} degC, "
                f"{unit['losses']['received']} frames, {unit['losses']['lost']} lost{dropped}"
            )
        for bus in run.get("buses", ()):
            yield (
                f"  bus      {bus['bus']}: {bus['state']}, {bus['frames']} frames, {bus['behind_s']:.2f} s behind, "
                f"at most {bus['most_behind_s']:.2f} s"
            )
        yield from (_fits(serial, fit) for serial, fit in run.get("fits", {}).items())
        yield from (f"  HOLD     {cause}" for cause in run["holding"])
    if run.get("age_s", 0.0) > ANSWER_S:
        yield f"  the loop of this run has not ticked for {run['age_s']:.0f} s"


def _fits(serial: str, fit: Mapping[str, Any]) -> str:
    scores = ", ".join(
        f"{model['name']} {_two(model['rms_dph'])} (held out {_two(model['held_out_rms_dph'])})"
        for model in fit["models"]
    )
    data = f"{fit['from_degc']:.1f} to {fit['to_degc']:.1f} degC, {clock(fit['seconds'])}"
    return f"  model    {serial}: {scores} deg/h RMS of 1 s means, {data}"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
