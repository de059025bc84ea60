"""`/live`: what live runs do, their traces, what operators ask of them, and the stream of all that."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, FastAPI, HTTPException, Query, Request
from fastapi import Path as Part
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse

from bench import remote
from bench.errors import InputError
from bench.remote import LiveRun
from bench.store import MANIFEST
from bench.web import story
from bench.web.access import Operator
from bench.web.finding import folder_of, ids
from bench.web.picture import Asked, Pictures, Run, TraceAnswer
from bench.web.settings import Here
from bench.web.starts import Starts
from bench.web.streaming import Stream
from bench.web.subject import describe
from bench.web.telling import Teller
from bench.web.watching import Watched, Watcher

router = APIRouter(tags=["live"])

REACTION_S = 5.0
"""A run does what it is asked at its next tick, a second."""
ENDING_S = 15.0
"""The answer to an abort waits so long for the safe state; after it the state is `ending`, and the stream goes on."""
_LOOK_S = 0.1
_DONE = {"hold": {"holding"}, "pause": {"pausing", "holding"}, "resume": {"running"}}

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
    watcher.start()
    try:
        yield
    finally:
        await asyncio.to_thread(watcher.close)


def watcher_of(request: Request) -> Watcher:
    """The watcher of the server that got this request."""
    watcher: Watcher = request.app.state.watcher
    return watcher


@router.get("/live")
def live(request: Request) -> Pictures:
    """All live runs, those that were killed or do not answer included."""
    return Pictures(runs=[Run(**watched.told()) for watched in watcher_of(request).runs])


@router.get("/live/stream", response_class=StreamingResponse, responses={200: {"content": {"text/event-stream": {}}}})
async def stream(request: Request, events: Annotated[int, Query(ge=0, le=1_000_000)] = 0) -> StreamingResponse:
    """Server-sent events `live` and `ended`; ends after so many `events`, or never.

    With `Last-Event-ID` the ends of runs that were missed come first.
    """
    found: Stream = request.app.state.stream
    if found.full:
        raise HTTPException(503, "too many browsers look already: close one", {"Retry-After": "10"})
    last = request.headers.get("last-event-id", "")
    since = int(last) if last.isascii() and last.isdigit() and len(last) < 16 else None
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(found.listen(since, events), media_type="text/event-stream", headers=headers)


@router.get("/live/{unit}/{run}")
def one(unit: Name, run: Name, request: Request, here: Here) -> Run:
    """One run: live, or how it ended."""
    watched = watcher_of(request).find(f"{unit}/{run}")
    if watched is not None:
        return Run(**watched.told())
    folder = _folder(here.out, unit, run)
    end = watcher_of(request).ended(f"{unit}/{run}") or _end(folder)
    if end is None:
        raise HTTPException(409, f"{unit}/{run} is not live and has no end: `bench resume {folder}` goes on with it")
    gone = LiveRun((folder,), remote.LiveFile(0, 0, "", [], ""))
    about = describe(gone, request.app.state.starts.of_run(f"{unit}/{run}"))
    about["started"] = str(story.manifest(folder).get("created", ""))
    runs = end.get("runs") or ids(_companions(folder))
    return Run(**{**about, "runs": runs, "state": end["state"], "condition": "ended", "ended": end})


@router.get("/live/{unit}/{run}/trace")
def trace(
    unit: Name,
    run: Name,
    request: Request,
    here: Here,
    since: Annotated[int, Query(ge=0, le=1 << 40)] = 0,
    generation: Annotated[int | None, Query(ge=-1, le=1 << 50)] = None,
) -> TraceAnswer:
    """What a live run has done so far, from point `since` on; all of it where `generation` is another one now."""
    return TraceAnswer(**_live(request, here.out, unit, run).mirror.since(since, generation))


@router.post("/live/{unit}/{run}/{action}")
async def act(
    unit: Name,
    run: Name,
    action: Literal["hold", "pause", "resume", "abort"],
    request: Request,
    here: Here,
    who: Operator,
) -> Asked:
    """Ask a live run for something, and see it done; who asked stands in its events."""
    watched = await run_in_threadpool(_live, request, here.out, unit, run)
    try:
        await run_in_threadpool(remote.ask, watched.live, action, who=str(who))
    except InputError as error:
        raise HTTPException(409, str(error)) from None
    if action == "abort":
        return await _aborted(watcher_of(request), watched)
    until_s, picture = time.monotonic() + REACTION_S, watched.picture
    while time.monotonic() < until_s:
        picture = await run_in_threadpool(remote.ask, watched.live, "status")
        if picture["state"] in _DONE[action]:
            break
        await asyncio.sleep(_LOOK_S)
    done = picture["state"] in _DONE[action]
    return Asked(
        run=watched.runs[0], asked=action, done=done, state=picture["state"], holding=picture.get("holding", [])
    )


async def _aborted(watcher: Watcher, watched: Watched) -> Asked:
    """Wait for the safe state, not for ever."""
    until_s = time.monotonic() + ENDING_S
    end = None
    while end is None and time.monotonic() < until_s:
        await asyncio.sleep(_LOOK_S)
        end = watcher.ended(watched.runs[0])
    state = end["state"] if end else "ending"
    return Asked(run=watched.runs[0], asked="abort", done=end is not None, state=state, ended=end)


def _live(request: Request, out: Path, unit: str, run: str) -> Watched:
    """The live run with this id; HTTPException 404 when there is no such run, 409 when it is not live."""
    watched = watcher_of(request).find(f"{unit}/{run}")
    if watched is None:
        _folder(out, unit, run)
        raise HTTPException(
            409, f"{unit}/{run} is not live (any more); GET /api/v1/live/{unit}/{run} says how it ended"
        )
    if watched.condition == "gone":
        raise HTTPException(409, f"{unit}/{run} is not live: {watched.detail}")
    return watched


def _folder(out: Path, unit: str, run: str) -> Path:
    folder = folder_of(out, unit, run)
    if folder is None:
        raise HTTPException(404, f"no run {unit}/{run}; GET /api/v1/runs lists them")
    return folder


def _companions(folder: Path) -> list[Path]:
    """The folder and those of the units that were in the chamber with it, as far as they are here."""
    manifest = story.manifest(folder)
    paths = (folder / str(other.get("run")) for other in manifest.get("companions", []) if isinstance(other, dict))
    return [folder, *(path.resolve() for path in paths if (path / MANIFEST).is_file())]


def _end(folder: Path) -> dict[str, Any] | None:
    """How a run ended, from its folder; None for one that was killed and not recovered."""
    if not (folder / MANIFEST).is_file():
        return None
    folders = _companions(folder)
    return {"run": ids(folders)[0], "runs": ids(folders), **story.of_folders(folders)}
