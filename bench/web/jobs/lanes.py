"""Jobs: bounded in number, shared between equal requests, cached by content, cancelled when no page waits."""

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
from weakref import WeakValueDictionary

from cachetools import LRUCache

from bench.web.jobs.workers import GivenUp, Refused, Worker

State = Literal["waiting", "running", "done", "failed"]
Lane = Literal["quick", "slow"]

MOST_WAITING = 16
"""Jobs that may wait in a lane; further requests are refused."""
PATIENCE_S = 60.0
"""A job is cancelled when it was not requested for this time [s]."""
KEPT_BYTES = 96 << 20
KEPT_JOBS = 400
"""Size of the cache of ended jobs, which answers an Undo or a second browser at once."""
IDLE_S = 900.0
"""A computing process without work ends after this long, which frees its memory [s]."""
_log = logging.getLogger("bench.web")
CANCELLED = "cancelled: no page waits for it"


class Full(Exception):  # noqa: N818 - a state, not an error
    """Too many jobs wait."""


@dataclass(eq=False)
class Job:
    """One computation. Only the thread of its lane writes its fields; `requested_s` and `pages` change under a lock."""

    kind: str
    target: str
    inputs: Mapping[str, Any]
    key: str | None
    lane: Lane
    began_s: float
    requested_s: float
    pages: int = 1
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


def key_of(target: str, inputs: Mapping[str, Any]) -> str:
    """Key of a request. Equal keys have equal answers: a request holds all its inputs, runs as hashes of their data."""
    return hashlib.sha256(json.dumps([target, inputs], sort_keys=True).encode()).hexdigest()


class Jobs:
    """All jobs of a server in two lanes with a process each, so that a zoom does not wait for a diagnosis."""

    def __init__(self, now: Callable[[], float] = time.monotonic, workers: Callable[[], Worker] = Worker) -> None:
        """Threads and processes start with the first job."""
        self._now, self._workers = now, workers
        self._changed = threading.Condition()
        self._open: dict[str, Job] = {}
        self._ended: LRUCache[str, Job] = LRUCache(KEPT_BYTES, _size)
        self._by_key: WeakValueDictionary[str, Job] = WeakValueDictionary()
        self._waiting: dict[Lane, deque[Job]] = {"quick": deque(), "slow": deque()}
        self._threads: dict[Lane, threading.Thread] = {}
        self._warm: set[Lane] = set()
        self._closed = False

    def submit(
        self, kind: str, target: str, inputs: Mapping[str, Any], *, key: str | None = None, lane: Lane = "quick"
    ) -> Job:
        """A new job for this request, or the existing one with the same key; raises Full."""
        with self._changed:
            known = self._by_key.get(key) if key else None
            if known is not None and known.state != "failed":
                known.pages += 1
                known.requested_s = self._now()
                if known.ended:
                    self._ended[known.id] = known
                return known
            queue = self._waiting[lane]
            if len(queue) >= MOST_WAITING:
                raise Full(f"{len(queue)} jobs wait already: try again in a minute")
            job = Job(kind, target, inputs, key, lane, self._now(), self._now())
            self._open[job.id] = job
            if key:
                self._by_key[key] = job
            queue.append(job)
            self._start(lane)
            self._changed.notify_all()
            return job

    def find(self, id_: str) -> Job | None:
        """A job by its id; this shows that its page still waits."""
        with self._changed:
            job = self._open.get(id_) or self._ended.get(id_)
            if job is not None:
                job.requested_s = self._now()
            return job

    def release(self, job: Job) -> None:
        """Record that a page no longer waits for a job; a job without pages is cancelled."""
        with self._changed:
            job.pages -= 1
            if job.key and job.pages <= 0 and not job.ended and self._by_key.get(job.key) is job:
                del self._by_key[job.key]  # who asks now gets a job of their own, not the end of this one
            if job.pages <= 0 and job.state == "waiting":
                self._waiting[job.lane].remove(job)
                self._end(job, "failed", detail=CANCELLED)

    def age_s(self, job: Job) -> float:
        """Time since the job was requested [s]."""
        return self._now() - job.began_s

    def listen(self, job: Job, call: Callable[[], None]) -> None:
        """Have another thread call `call` when the job ends; call it at once if the job has ended."""
        with self._changed:
            if not job.ended:
                job.listeners.append(call)
                return
        call()

    def warm(self) -> None:
        """Start the processes, so that they are ready for the next request."""
        with self._changed:
            for lane in self._waiting:
                self._warm.add(lane)
                self._start(lane)
            self._changed.notify_all()

    def close(self) -> None:
        """End all threads without waiting for unfinished computations."""
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
        """The next job for which a page still waits; None when the server ends."""
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
                    if self._needed(job):
                        job.state = "running"
                        return job
                    self._end(job, "failed", detail=CANCELLED)
            if warm:
                with contextlib.suppress(OSError):  # no memory for a process now: the next request tries again
                    worker.warm()
            elif not ready:
                worker.close()

    def _do(self, job: Job, worker: Worker) -> None:
        try:
            result = worker.compute(job.target, job.inputs, lambda: self._needed(job))
        except Refused as error:
            outcome: tuple[State, bytes, str] = ("failed", b"null", str(error))
        except GivenUp:
            outcome = ("failed", b"null", CANCELLED)
        except Exception as error:  # the thread must continue, or all later jobs would never start
            _log.exception("computing %s", job.target)
            outcome = ("failed", b"null", f"the computation could not be started ({type(error).__name__}: {error})")
        else:
            outcome = ("done", result, "")
        with self._changed:
            self._end(job, *outcome)

    def _needed(self, job: Job) -> bool:
        return not self._closed and job.pages > 0 and self._now() - job.requested_s < PATIENCE_S

    def _end(self, job: Job, state: State, result: bytes = b"null", detail: str = "") -> None:
        job.result, job.detail, job.elapsed_s = result, detail, self._now() - job.began_s
        job.state = state
        self._ended[job.id] = self._open.pop(job.id)
        listeners, job.listeners = job.listeners, []
        for call in listeners:
            call()


def _size(job: Job) -> int:
    """Bytes that a result counts in the cache: at least the share of one of `KEPT_JOBS`, at most the whole cache."""
    return min(max(len(job.result), KEPT_BYTES // KEPT_JOBS), KEPT_BYTES)
