"""`/live`: state and traces of live runs, requests of operators, and a stream of all changes."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Depends, FastAPI, HTTPException, Query, Request
from fastapi import Path as Part
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from bench.acquisition import LiveFile, LiveRun, ask_run, events_of
from bench.base import InputError
from bench.commands import ENDING_S, REACHED, REACTION_S
from bench.record import MANIFEST, Manifest
from bench.web.ground.settings import Here
from bench.web.live import story
from bench.web.live.finding import folder_of, ids
from bench.web.live.picture import Asked, End, Happened, Log, Pictures, Run, TraceAnswer
from bench.web.live.starts import Starts
from bench.web.live.streaming import Stream
from bench.web.live.subject import describe
from bench.web.live.telling import Teller
from bench.web.live.watching import Watched, Watcher
from bench.web.people.access import Access, Operator, named_by

router = APIRouter(tags=["live"])

PATIENCE_S = 15.0
"""Longest wait for the outcome of a request [s]; a longer abort is `ending`, and the stream reports its end."""
ABORTS = 16
"""Aborts that may be under way at once."""
_LOOK_S = 0.1

Name = Annotated[str, Part(min_length=1, max_length=200)]


@contextlib.asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """The watcher of a server, its starts and its stream."""
    settings, loop, stream = app.state.settings, asyncio.get_running_loop(), Stream()
    starts = Starts(settings.own, settings.out, settings.project)
    teller = Teller(stream, loop)
    watcher = Watcher(settings.out, starts, teller)
    watcher.wanted = lambda: stream.listeners > 0
    app.state.starts, app.state.watcher, app.state.stream = starts, watcher, stream
    app.state.aborts = CapacityLimiter(ABORTS)
    watcher.start()
    try:
        yield
    finally:
        await asyncio.to_thread(watcher.close)


def watcher_of(request: Request) -> Watcher:
    """The watcher of this server."""
    watcher: Watcher = request.app.state.watcher
    return watcher


class _Which:
    """The run that an address names."""

    def __init__(self, unit: str, run: str, out: Path, watcher: Watcher) -> None:
        self.id = f"{unit}/{run}"
        self._unit, self._run, self._out, self._watcher = unit, run, out, watcher

    @property
    def watched(self) -> Watched | None:
        """The live run; None where it is not live."""
        return self._watcher.find(self.id)

    def folder(self) -> Path:
        """Folder of the run; HTTPException 404 without one."""
        folder = folder_of(self._out, self._unit, self._run)
        if folder is None:
            raise HTTPException(404, f"no run {self.id}; GET /api/v1/runs lists them")
        return folder

    def live(self) -> Watched:
        """The live run; HTTPException 404 for an unknown run, 409 for one that is not live."""
        watched = self.watched
        if watched is None:
            self.folder()
            raise HTTPException(409, f"{self.id} is not live; GET /api/v1/live/{self.id} says how it ended")
        if watched.condition == "gone":
            raise HTTPException(409, f"{self.id} is not live: {watched.detail}")
        return watched


async def _which(unit: Name, run: Name, request: Request, here: Here) -> _Which:
    return _Which(unit, run, here.out, watcher_of(request))


class Acting(BaseModel):
    """Who asks a live run for something."""

    operator: str = Field(default="", max_length=80)
    """Who works at the bench, where nobody has to sign in; left out: whoever started the run."""


Which = Annotated[_Which, Depends(_which)]


@router.get("/live", response_model_exclude_unset=True)
def live(request: Request) -> Pictures:
    """All live runs, with those that were killed or do not answer."""
    return Pictures(runs=[Run(**watched.told()) for watched in watcher_of(request).runs])


@router.get("/live/stream", response_class=StreamingResponse, responses={200: {"content": {"text/event-stream": {}}}})
async def stream(request: Request, events: Annotated[int, Query(ge=0, le=1_000_000)] = 0) -> StreamingResponse:
    """Server-sent events `live` and `ended`, until so many `events` were sent or the user's token or session ends.

    With `Last-Event-ID` missed ends of runs come first.
    """
    found: Stream = request.app.state.stream
    if found.full:
        raise HTTPException(503, "too many browsers watch already: close one", {"Retry-After": "10"})
    last = request.headers.get("last-event-id", "")
    since = int(last) if last.isascii() and last.isdigit() and len(last) < 16 else None
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    access: Access = request.app.state.access
    told = found.listen(since, events, lambda: access.knows_still(request))
    return StreamingResponse(told, media_type="text/event-stream", headers=headers)


@router.get("/live/{unit}/{run}", response_model_exclude_unset=True)
def one(which: Which, request: Request) -> Run:
    """One run: live, or how it ended."""
    watched = which.watched
    if watched is not None:
        return Run(**watched.told())
    folder = which.folder()
    start = request.app.state.starts.of_run(which.id)  # before the folder, so that nothing it wrote is missed
    end = watcher_of(request).ended(which.id) or _end(folder, start)
    if end is None:
        raise HTTPException(409, f"{which.id} is not live and has no end: `bench resume {which.id}` goes on with it")
    known = story.sound(Manifest, folder)
    gone = LiveRun((folder,), LiveFile(0, 0, known.created if known else "", [], ""))
    about = describe(gone, start)
    about["profile"] = about["profile"] or (known.profile if known else "")  # a lot or import has no profile.yaml
    return Run(**{**about, "runs": end["runs"], "state": end["state"], "condition": "ended", "ended": end})


@router.get("/live/{unit}/{run}/trace")
def trace(
    which: Which,
    since: Annotated[int, Query(ge=0, le=1 << 40)] = 0,
    generation: Annotated[int | None, Query(ge=-1, le=1 << 50)] = None,
) -> TraceAnswer:
    """Trace of a live run from point `since` on; the whole trace where `generation` has changed."""
    return TraceAnswer(**which.live().mirror.since(since, generation))


@router.get("/live/{unit}/{run}/events")
def events(which: Which) -> Log:
    """The newest segments, requests, guards, holds and other events of a live run, newest first."""
    return Log(events=[Happened(**event) for event in story.newest(events_of(which.live().live))])


@router.post("/live/{unit}/{run}/{action}", response_model_exclude_unset=True)
async def act(
    which: Which,
    action: Literal["hold", "pause", "resume", "abort"],
    request: Request,
    who: Operator,
    asked: Acting,
    wait_s: Annotated[float, Query(ge=0.0, le=ENDING_S)] = PATIENCE_S,
) -> Asked:
    """Send a request to a live run and wait up to `wait_s` for its effect; its events name the user.

    An abort has threads of its own, so that it never waits for what others compute, read or ask for.
    """
    threads = request.app.state.aborts if action == "abort" else None
    watched = await to_thread.run_sync(which.live, limiter=threads)
    who = named_by(who, asked.operator, request, watched.about["who"])
    try:
        await to_thread.run_sync(partial(ask_run, watched.live, action, who=str(who)), limiter=threads)
    except InputError as error:
        raise HTTPException(409, str(error)) from None
    watcher, reached = watcher_of(request), REACHED.get(action, ((), ""))[0]
    with watcher.eagerly():
        if action == "abort":
            return await _aborted(watcher, watched, wait_s)
        await _until(lambda: watched.picture["state"] in reached, min(wait_s, REACTION_S))
    state = watched.picture["state"]
    holding = watched.picture.get("holding", [])
    return Asked(run=watched.runs[0], asked=action, done=state in reached, state=state, holding=holding)


async def _aborted(watcher: Watcher, watched: Watched, wait_s: float) -> Asked:
    """Wait for the safe state, up to a limit."""
    run = watched.runs[0]
    await _until(lambda: watcher.ended(run) is not None, wait_s)
    end = watcher.ended(run)
    if end is None:
        return Asked(run=run, asked="abort", done=False, state="ending")
    known = {key: end[key] for key in ("state", "cause", "safe", "safe_state")}
    return Asked(run=run, asked="abort", done=True, ended=End(**end), **known)


async def _until(reached: Callable[[], bool], limit_s: float) -> None:
    until_s = time.monotonic() + limit_s
    while not reached() and time.monotonic() < until_s:
        await asyncio.sleep(_LOOK_S)


def _companions(folder: Path) -> list[Path]:
    """The folder, and those of the units that shared the chamber, as far as they exist here."""
    known = story.sound(Manifest, folder)
    found = [folder]
    for other in known.companions if known else ():
        unit, _, run = other.run.removeprefix("../../").partition("/")
        path = folder_of(folder.parents[1], unit, run)
        if path is not None and (path / MANIFEST).is_file():
            found.append(path)
    return found


def _end(folder: Path, start: dict[str, Any] | None) -> dict[str, Any] | None:
    """End of a run from its folder and its start; None for a run that was killed and not recovered."""
    if not (folder / MANIFEST).is_file():
        return None
    folders = _companions(folder)
    return {"run": ids(folders)[0], "runs": ids(folders), **story.of_folders(folders, start)}
