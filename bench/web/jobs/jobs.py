"""`/jobs`: computations requested by a page."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Mapping
from typing import Annotated, Any, Literal

from fastapi import APIRouter, FastAPI, HTTPException, Query, Request, Response
from pydantic import BaseModel

from bench.web.ground.problems import within
from bench.web.jobs.lanes import Full, Job, Jobs, Lane, key_of

__all__ = ["Asked", "Jobs", "jobs_of", "key_of", "lifespan", "router", "submit"]

LONGEST_WAIT_S = 25.0

router = APIRouter(tags=["jobs"])


class Asked(BaseModel):
    """A job that was accepted; `GET /jobs/{job}` returns its result."""

    job: str
    state: Literal["waiting", "running", "done", "failed"]


class JobAnswer(BaseModel):
    """A job; `result` when it is done, `detail` (one line) when it failed."""

    job: str
    kind: str
    state: Literal["waiting", "running", "done", "failed"]
    result: Any = None
    detail: str = ""
    elapsed_s: float


@contextlib.asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Jobs of a server; their processes end with the server."""
    app.state.jobs = Jobs()
    try:
        yield
    finally:
        await asyncio.to_thread(app.state.jobs.close)


def jobs_of(request: Request) -> Jobs:
    """The jobs of this server."""
    jobs: Jobs = request.app.state.jobs
    return jobs


def submit(
    request: Request, kind: str, target: str, inputs: Mapping[str, Any], *, key: str | None = None, lane: Lane = "quick"
) -> Asked:
    """Request a computation; HTTPException 503 when too many wait."""
    try:
        job = jobs_of(request).submit(kind, target, inputs, key=key, lane=lane)
    except Full as error:
        raise HTTPException(503, str(error), {"Retry-After": "10"}) from None
    return Asked(job=job.id, state=job.state)


@router.get("/jobs/{job}", response_model=JobAnswer)
async def job(request: Request, job: str, wait_s: Annotated[float, Query(ge=0.0, le=LONGEST_WAIT_S)] = 0.0) -> Response:
    """A job; `wait_s` delays the answer until the job has ended, at most by this time [s]."""
    known = _job_of(request, job)
    if wait_s and not known.ended:
        await _ended(jobs_of(request), known, wait_s)
        _job_of(request, job)
    return _response(request, known)


@router.delete("/jobs/{job}", response_model=JobAnswer)
async def release(request: Request, job: str) -> Response:
    """Stop waiting for a job; it is cancelled when no page waits for it."""
    known = _job_of(request, job)
    jobs_of(request).release(known)
    return _response(request, known)


def _job_of(request: Request, id_: str) -> Job:
    known = jobs_of(request).find(id_)
    if known is None:
        raise HTTPException(404, "unknown or expired job: request it again")
    return known


async def _ended(jobs: Jobs, job: Job, wait_s: float) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()

    def call() -> None:
        with contextlib.suppress(RuntimeError):  # the server ends
            loop.call_soon_threadsafe(ended.set)

    jobs.listen(job, call)
    # The end of the server cancels this: the page gets the current state and asks the next server.
    with contextlib.suppress(TimeoutError, asyncio.CancelledError):
        await asyncio.wait_for(ended.wait(), wait_s)


def _response(request: Request, job: Job) -> Response:
    # The result is JSON already; parsing it here would block the server for all requests.
    state = job.state
    elapsed_s = job.elapsed_s if job.ended else jobs_of(request).age_s(job)
    here = request.app.state.settings
    detail = within(here.project, job.detail, here.out)
    head = {"job": job.id, "kind": job.kind, "state": state, "detail": detail, "elapsed_s": round(elapsed_s, 3)}
    result = job.result if state == "done" else b"null"
    return Response(json.dumps(head).encode()[:-1] + b', "result": ' + result + b"}", media_type="application/json")
