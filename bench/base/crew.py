"""Work shared with copies of this process: a copy has all data already, only answers are sent back.

A copy (fork) needs neither a pool nor inputs that can be sent, inherits priority and limits, and works in a niced or
daemonic process, too. Work of a copy that was lost is done here again: it costs time, not the answer. With one
worker, beside other threads (a copy would inherit their locks) or without fork, everything is done here, in order.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

T = TypeVar("T")
VARIABLE = "BENCH_WORKERS"
_USUAL = 2
_MOST_TASKS = 256


def usual_workers() -> int:
    """Workers of a diagnosis: BENCH_WORKERS, by default two where there are two processors."""
    wanted = os.environ.get(VARIABLE, "")
    if wanted.isdecimal():
        return max(1, int(wanted))
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(_USUAL, processors)


class Aside(Generic[T]):
    """One piece of work begun in a copy of this process; without workers to spare it is done when it is asked for."""

    def __init__(self, work: Callable[[], T], workers: int) -> None:
        """Begin the work."""
        self._work = work
        self._pid = self._pipe = 0
        if workers > 1 and hasattr(os, "fork") and threading.active_count() == 1:
            self._begin()

    def answer(self) -> T:
        """What the work gives, or raises; the copy has ended then."""
        answers = self._received()
        return answers[0] if answers else self._work()

    def close(self) -> None:
        """End the copy at once."""
        if self._pid:
            os.close(self._pipe)
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
            os.waitpid(self._pid, 0)
            self._pid = 0

    def _begin(self) -> None:
        self._pipe, back = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads of libraries: the copy only computes
            try:
                self._pid = os.fork()
            except OSError:  # no process or memory to spare
                os.close(self._pipe)
                os.close(back)
                return
        if self._pid:
            os.close(back)
            return
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one that asks ends it
            os.close(self._pipe)
            with os.fdopen(back, "wb") as pipe:
                pickle.dump(self._work(), pipe, protocol=pickle.HIGHEST_PROTOCOL)
        except BaseException:  # told by doing it again in the process that asks
            os._exit(1)
        os._exit(0)

    def _received(self) -> list[T]:
        """The answer, or nothing if there is no copy or it was lost."""
        if not self._pid:
            return []
        try:
            with os.fdopen(os.dup(self._pipe), "rb") as pipe:
                return [pickle.load(pipe)]
        except (EOFError, pickle.UnpicklingError):
            return []
        finally:
            self.close()


def shared(tasks: Sequence[Callable[[], T]], workers: int) -> list[T]:
    """Answers of tasks that do not depend on each other, in their order; whoever is free takes the next."""
    if workers < 2 or not 2 <= len(tasks) <= _MOST_TASKS:
        return [task() for task in tasks]
    queue, fill = os.pipe()
    os.write(fill, bytes(range(len(tasks))))
    os.close(fill)

    def taken() -> dict[int, T]:
        done = {}
        while number := os.read(queue, 1):
            done[number[0]] = tasks[number[0]]()
        return done

    others = [Aside(taken, workers) for _ in range(min(workers, len(tasks)) - 1)]
    try:
        answers = taken()
        for other in others:
            answers |= other.answer()
    finally:
        for other in others:
            other.close()
        os.close(queue)
    return [answers[number] if number in answers else task() for number, task in enumerate(tasks)]
