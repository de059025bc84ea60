"""Where groups are refitted: on this computer or on a Dask cluster. The answer is the same, bit for bit.

A few groups per worker are in work at a time, and the answers come back in order, so memory does not grow with the
fleet. (Bit for bit holds among computers of one kind: another processor may round a sum differently in the last place.)
"""

from __future__ import annotations

import logging
import multiprocessing
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from importlib import import_module
from typing import Any

from bench.analysis import Model
from bench.archive.fleet.moments_file import Group
from bench.archive.fleet.refit import Record, refit_group
from bench.base import InputError, __version__

WINDOW = 3
"""Groups per worker that are in work or waiting."""

Engine = Callable[[Model, Iterable[Group]], Iterator[list[Record]]]


def local_engine(workers: int) -> Engine:
    """On this computer: in this process for one worker, else in `workers` processes.

    A group that kills its process is tried once more alone; the second time it is recorded as failed.
    """

    def run(model: Model, groups: Iterable[Group]) -> Iterator[list[Record]]:
        work = partial(refit_group, model)
        if workers == 1:
            yield from map(work, groups)
            return
        executor = _executor(workers)

        def submit(group: Group) -> Future[list[Record]]:
            nonlocal executor
            try:
                return executor.submit(work, group)
            except BrokenProcessPool:
                executor = _executor(workers)
                return executor.submit(work, group)

        try:
            for group, future in _ahead(submit, groups, WINDOW * workers):
                try:
                    yield future.result()
                except BrokenProcessPool:
                    yield _alone(work, group)
        finally:
            executor.shutdown(cancel_futures=True)

    return run


def dask_engine(workers: int, scheduler: str | None) -> Engine:
    """The Dask cluster at `scheduler` (tcp://…), else one of `workers` processes on this computer.

    A group whose worker died three times is recorded as failed. InputError: Dask is not installed, no scheduler answers
    at the address, or its workers have another version of the bench.
    """

    def run(model: Model, groups: Iterable[Group]) -> Iterator[list[Record]]:
        work = partial(refit_group, model)
        with _client(workers, scheduler) as client:
            _require_same_version(client)
            threads = max(1, sum(client.nthreads().values()))
            # Not pure: equal moments of two units are two tasks.
            submit = partial(client.submit, work, pure=False, retries=2)
            for group, future in _ahead(submit, groups, WINDOW * threads):
                error = future.exception()
                yield future.result() if error is None else _failed(group, f"{type(error).__name__}: {error}")
                future.release()

    return run


def _ahead(submit: Callable[[Group], Any], groups: Iterable[Group], window: int) -> Iterator[tuple[Group, Any]]:
    """Every group with its future, in order; up to `window` groups are submitted ahead."""
    waiting: deque[tuple[Group, Any]] = deque()
    source = iter(groups)
    while True:
        while len(waiting) < window and (group := next(source, None)) is not None:
            waiting.append((group, submit(group)))
        if not waiting:
            return
        yield waiting.popleft()


def _executor(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def _alone(work: Callable[[Group], list[Record]], group: Group) -> list[Record]:
    with _executor(1) as executor:
        try:
            return executor.submit(work, group).result()
        except BrokenProcessPool:
            return _failed(group, "its worker process died")


def _client(workers: int, scheduler: str | None) -> Any:
    """A client of the cluster; it ends a cluster that it started itself."""
    try:
        distributed: Any = import_module("distributed")
    except ModuleNotFoundError:
        raise InputError("Dask is not installed: pip install 'gyro-thermal-bench[fleet]', or --engine pool") from None
    if scheduler is None:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        return distributed.Client(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=None,
            host="127.0.0.1",
            silence_logs=logging.ERROR,
        )
    try:
        return distributed.Client(scheduler, timeout="15s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no Dask scheduler: {error}; start one with `dask scheduler`", scheduler) from None


def _require_same_version(client: Any) -> None:
    found = set(client.run(_version).values())
    if found - {__version__}:
        raise InputError(
            f"the workers have bench {', '.join(sorted(found))}, this one is {__version__}; install the same"
        )
    if not found:
        raise InputError("the Dask scheduler has no workers; start some with `dask worker`")


def _version() -> str:
    return __version__


def _failed(group: Group, why: str) -> list[Record]:
    text = f"not refitted: {why}".partition("\n")[0]
    return [Record(unit, run, text) for unit, run in zip(group.units, group.runs, strict=True)]
