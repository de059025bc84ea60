"""Results of `bench status`, `hold`, `pause`, `resume` and `abort`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bench import acquisition
from bench.base import clock, in_own, say
from bench.cli.rendering.printing import content, lines, table
from bench.commands import REACHED, Aborted, Asked, LiveRuns, Queue, Recovered

if TYPE_CHECKING:
    from rich.table import Table


@lines.register(LiveRuns)
def _(result: LiveRuns) -> Iterator[str]:
    if not result.states:
        yield say("live.none", place=result.place)
    for i, state in enumerate(result.states):
        yield from [""] if i else []
        yield from live_run(state)


@content.register(LiveRuns)
def _(result: LiveRuns) -> dict[str, Any]:
    return {"runs": list(result.states)}


@lines.register(Queue)
def _(result: Queue) -> Iterator[str | Table]:
    if not result.waiting:
        yield say("queue.none", server=result.server)
        return
    titles = [say("queue.units"), say("queue.plan"), say("queue.station"), say("queue.who"), say("queue.not_before")]
    yield table(
        ["", *titles, say("queue.start")], [_waiting(place, one) for place, one in enumerate(result.waiting, 1)]
    )
    yield from (f"{one['start']}: {one['message']}" for one in result.waiting if one["message"])


def _waiting(place: int, one: Mapping[str, Any]) -> list[object]:
    units = ", ".join(one["units"]) or None
    return [place, units, one["plan"], one["station"], one["who"].get("name"), one["not_before"], one["start"]]


@content.register(Queue)
def _(result: Queue) -> dict[str, Any]:
    return {"waiting": list(result.waiting)}


@lines.register(Asked)
def _(result: Asked) -> Iterator[str]:
    state = result.state
    if result.reached:
        yield f"{result.run}: {REACHED[result.action][1]}"
    else:
        guards = f": {'; '.join(state['holding'])}" if state.get("holding") else ""
        yield say("live.requested", run=result.run, action=result.action, state=state["state"], guards=guards)
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
        yield say("live.unsafe")
    elif not end["safe_state"]:
        yield say("live.untouched")
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
    yield f"{run['run']}  {run['state']}"
    if "error" in run:
        yield f"  {run['error']}"
    if "segment" in run:
        segment, chamber = run["segment"], run["chamber"]
        left = clock(segment["left_s"])
        yield say("live.segment", n=segment["index"] + 1, of=segment["of"], name=segment["name"], left=left)
        yield say("live.time", time=clock(run["t_s"]), left=clock(run["left_s"]))
        yield say("live.chamber", now=_two(chamber["temperature_degc"]), set=_two(chamber["setpoint_degc"]))
        for unit in run["units"]:
            dropped = say("live.dropped", reason=in_own(unit["dropped"])) if unit["dropped"] else ""
            degc, losses = _two(unit["temperature_degc"]), unit["losses"]
            known = {"serial": unit["serial"], "received": losses["received"], "lost": losses["lost"]}
            yield say("live.unit", degc=degc, dropped=dropped, **known)
        for bus in run.get("buses", ()):
            late = {"behind": f"{bus['behind_s']:.2f}", "most": f"{bus['most_behind_s']:.2f}"}
            yield say("live.bus", bus=bus["bus"], state=bus["state"], frames=bus["frames"], **late)
        yield from (_fits(serial, fit) for serial, fit in run.get("fits", {}).items())
        yield from (say("live.hold", cause=in_own(cause)) for cause in run["holding"])
    if run.get("age_s", 0.0) > acquisition.ANSWER_S:
        yield say("live.stuck", age=f"{run['age_s']:.0f}")


def _fits(serial: str, fit: Mapping[str, Any]) -> str:
    scores = ", ".join(
        f"{model['name']} {_two(model['rms_dph'])} (held out {_two(model['held_out_rms_dph'])})"
        for model in fit["models"]
    )
    data = f"{fit['from_degc']:.1f} to {fit['to_degc']:.1f} degC, {clock(fit['seconds'])}"
    return f"  model    {serial}: {scores} deg/h RMS of 1 s means, {data}"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
