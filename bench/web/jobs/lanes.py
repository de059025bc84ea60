"""Jobs: bounded, each computed once for everybody who asks the same, kept by content, dropped when nobody waits."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from bench.web.jobs.workers import GivenUp, Refused, Worker

State = Literal["waiting", "running", "done", "failed"]
Lane = Literal["quick", "slow"]

MOST_WAITING = 16
"""Jobs in a lane; whoever comes later is told to come again."""
PATIENCE_S = 60.0
"""A job that nobody has asked for so long is nobody's: its page is gone [s]."""
KEPT_BYTES = 96 << 20
KEPT_JOBS = 400
"""What of ended jobs is kept: an Undo, a second look, a second browser find their answer at once."""
IDLE_S = 900.0
"""A computing process without work ends after this long and gives its memory back [s]."""
_log = logging.getLogger("bench.web")
CANCELLED = "cancelled: nobody waits for it any more"


class Full(Exception):  # noqa: N818 - a state, not an error
    """Too many jobs wait."""


@dataclass(eq=False)
class Job:
    """One computation; fields are written by its lane's thread alone, `asked` and `wanted_by` under the lock."""

    kind: str
    target: str
    wanted: Mapping[str, Any]
    key: str | None
    lane: Lane
    began: float
    asked: float
    wanted_by: int = 1
    id: str = field(default_factory=lambda: secrets.token_urlsafe(12))
    state: State = "waiting"
    result: bytes = b"null"
    detail: str = ""
    elapsed_s: float = 0.0
    listeners: list[Callable[[], None]] = field(default_factory=list)

    @property
    def ended(self) -> bool:
        """Done or failed."""
        return self.state in {"done", "failed"}


def key_of(target: str, wanted: Mapping[str, Any]) -> str:
    """Same key, same answer: everything that a result rests on is in the request, runs by the hashes of their data."""
    return hashlib.sha256(json.dumps([target, wanted], sort_keys=True).encode()).hexdigest()


class Jobs:
    """All jobs of a server. Two lanes, so that a zoom does not wait for a diagnosis; each has one process."""

    def __init__(self, now: Callable[[], float] = time.monotonic, workers: Callable[[], Worker] = Worker) -> None:
        """Starts threads and processes with the first job."""
        self._now, self._workers = now, workers
        self._changed = threading.Condition()
        self._jobs: dict[str, Job] = {}
        self._by_key: dict[str, Job] = {}
        self._waiting: dict[Lane, deque[Job]] = {"quick": deque(), "slow": deque()}
        self._threads: dict[Lane, threading.Thread] = {}
        self._warm: set[Lane] = set()
        self._closed = False

    def submit(
        self, kind: str, target: str, wanted: Mapping[str, Any], *, key: str | None = None, lane: Lane = "quick"
    ) -> Job:
        """The job for this request, or the one that somebody asked for already under the same key; raises Full."""
        with self._changed:
            known = self._by_key.get(key) if key else None
            if known is not None and known.state != "failed":
                known.wanted_by += 1
                known.asked = self._now()
                self._keep(known)
                return known
            queue = self._waiting[lane]
            if len(queue) >= MOST_WAITING:
                raise Full(f"{len(queue)} jobs wait already: try again in a minute")
            job = Job(kind, target, wanted, key, lane, self._now(), self._now())
            self._jobs[job.id] = job
            if key:
                self._by_key[key] = job
            queue.append(job)
            self._start(lane)
            self._changed.notify_all()
            return job

    def find(self, id_: str) -> Job | None:
        """A job by its id; asking keeps it alive."""
        with self._changed:
            job = self._jobs.get(id_)
            if job is not None:
                job.asked = self._now()
            return job

    def release(self, job: Job) -> None:
        """One page less waits for it; the last one's going cancels it."""
        with self._changed:
            job.wanted_by -= 1
            if job.wanted_by <= 0 and job.state == "waiting":
                self._waiting[job.lane].remove(job)
                self._end(job, "failed", detail=CANCELLED)

    def age_s(self, job: Job) -> float:
        """How long ago it was asked for [s]."""
        return self._now() - job.began

    def listen(self, job: Job, call: Callable[[], None]) -> None:
        """Have `call` called, from another thread, when the job has ended; at once where it has."""
        with self._changed:
            if not job.ended:
                job.listeners.append(call)
                return
        call()

    def warm(self) -> None:
        """Have the processes ready soon."""
        with self._changed:
            for lane in self._waiting:
                self._warm.add(lane)
                self._start(lane)
            self._changed.notify_all()

    def close(self) -> None:
        """End all; waits for the threads, not for the work."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads.values():
            thread.join()

    def _start(self, lane: Lane) -> None:
        if lane not in self._threads and not self._closed:
            self._threads[lane] = threading.Thread(target=self._serve, args=(lane,), name=f"jobs {lane}", daemon=True)
            self._threads[lane].start()

    def _serve(self, lane: Lane) -> None:
        worker = self._workers()
        try:
            while (job := self._next(lane, worker)) is not None:
                self._do(job, worker)
        finally:
            worker.close()

    def _next(self, lane: Lane, worker: Worker) -> Job | None:
        """The next job that somebody still waits for; None at the end."""
        while True:
            with self._changed:
                ready = self._changed.wait_for(
                    lambda: self._closed or self._waiting[lane] or lane in self._warm, timeout=IDLE_S
                )
                if self._closed:
                    return None
                warm = lane in self._warm
                self._warm.discard(lane)
                while self._waiting[lane]:
                    job = self._waiting[lane].popleft()
                    if self._wanted(job):
                        job.state = "running"
                        return job
                    self._end(job, "failed", detail=CANCELLED)
            if warm:
                with contextlib.suppress(OSError):  # no memory for a process just now: whoever asks next tries again
                    worker.warm()
            elif not ready:
                worker.close()

    def _do(self, job: Job, worker: Worker) -> None:
        try:
            result = worker.compute(job.target, job.wanted, lambda: self._wanted(job))
        except Refused as error:
            outcome: tuple[State, bytes, str] = ("failed", b"null", str(error))
        except GivenUp:
            outcome = ("failed", b"null", CANCELLED)
        except Exception as error:  # a lane without its thread would let everybody wait for ever
            _log.exception("computing %s", job.target)
            outcome = ("failed", b"null", f"the computation could not be asked for ({type(error).__name__}: {error})")
        else:
            outcome = ("done", result, "")
        with self._changed:
            self._end(job, *outcome)

    def _wanted(self, job: Job) -> bool:
        return not self._closed and job.wanted_by > 0 and self._now() - job.asked < PATIENCE_S

    def _end(self, job: Job, state: State, result: bytes = b"null", detail: str = "") -> None:
        job.result, job.detail, job.elapsed_s = result, detail, self._now() - job.began
        job.state = state
        if state == "failed" and job.key and self._by_key.get(job.key) is job:
            del self._by_key[job.key]
        listeners, job.listeners = job.listeners, []
        for call in listeners:
            call()
        self._keep(job)

    def _keep(self, job: Job) -> None:
        """Make it the youngest, forget the oldest that have ended until the rest fits."""
        self._jobs[job.id] = self._jobs.pop(job.id, job)
        ended = [one for one in self._jobs.values() if one.ended]
        size = sum(len(one.result) for one in ended)
        for old in ended[:-1]:
            if size <= KEPT_BYTES and len(ended) <= KEPT_JOBS:
                return
            size -= len(old.result)
            ended.remove(old)
            del self._jobs[old.id]
            if old.key and self._by_key.get(old.key) is old:
                del self._by_key[old.key]
