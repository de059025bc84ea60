"""A thread that asks one instrument, and that nothing waits for once it is stuck in a foreign library.

Python joins the threads of `concurrent.futures` when it ends, and a library that never returns would
keep the process alive.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from concurrent.futures import TimeoutError as NotInTime
from contextlib import suppress
from queue import SimpleQueue
from typing import Any, TypeVar

from drivers.errors import DriverError, LinkError

T = TypeVar("T")


class Now(Executor):
    """Does everything at once, in the thread that asks for it."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """See Executor."""
        done: Future[T] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except DriverError as error:
            done.set_exception(error)
        return done


class Threaded(Executor):
    """Does one thing after another in a thread that does not outlive the process."""

    def __init__(self, name: str) -> None:
        self._jobs: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """See Executor."""
        job: Future[T] = Future()
        self._jobs.put((job, lambda: fn(*args, **kwargs)))
        return job

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See Executor."""
        self._jobs.put(None)
        if wait:
            self._thread.join()

    def _serve(self) -> None:
        while (given := self._jobs.get()) is not None:
            job, do = given
            if job.set_running_or_notify_cancel():
                try:
                    job.set_result(do())
                except BaseException as error:  # it belongs to whoever asked
                    job.set_exception(error)


class Worker:
    """Has things done within a time, and remembers what never came back."""

    def __init__(self, name: str, executor: Executor, patience_s: float) -> None:
        self._name, self._executor = name, executor
        self.patience_s = patience_s
        """How long anything may take until the thread counts as stuck [s]."""
        self._stuck: Future[Any] | None = None

    def submit(self, action: Callable[..., T], *given: Any) -> Future[T]:
        """Have something done later."""
        return self._executor.submit(action, *given)

    def do(self, action: Callable[..., T], *given: Any) -> T:
        """What `action` returns; DriverError, LinkError where the thread is stuck, which is not waited for twice."""
        if not self.stuck:
            job = self.submit(action, *given)
            try:
                return job.result(self.patience_s)
            except NotInTime:
                self.give_up(job)
        raise LinkError(f"{self._name}: no answer within {self.patience_s:g} s")

    @property
    def stuck(self) -> bool:
        """Whether something has not come back, in time or until now."""
        return self._stuck is not None and not self._stuck.done()

    def give_up(self, job: Future[Any]) -> None:
        """Something did not come back in time; what has not begun never will."""
        if not job.cancel():
            self._stuck = job

    def close(self, last: Callable[[], None]) -> None:
        """Do a last thing and end the thread; leave it behind where it is stuck."""
        with suppress(DriverError):
            self.do(last)
        self._executor.shutdown(wait=not self.stuck)
