"""Where groups are refitted: here, in a pool of processes, or on a Dask cluster. The answer is the same, bit for bit.

Groups go out in a window of a few per worker and come back in their order, so memory does not grow with the fleet.
(Bit for bit holds among machines of one kind: another processor may round a sum differently in the last place.)
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
from typing import Any, Protocol

from bench.analysis import Model
from bench.archive.fleet.moments_file import Group
from bench.archive.fleet.refit import Record, refit_group
from bench.base import InputError, __version__

WINDOW = 3
"""Groups in work or waiting, a worker."""

Engine = Callable[[Model, Iterable[Group]], Iterator[list[Record]]]


def serial_engine(model: Model, groups: Iterable[Group]) -> Iterator[list[Record]]:
    """One group after the other, in this process."""
    for group in groups:
        yield refit_group(model, group)


def pool_engine(workers: int) -> Engine:
    """Processes of this machine. A group that kills its process is tried once more alone, then recorded as failed."""

    def run(model: Model, groups: Iterable[Group]) -> Iterator[list[Record]]:
        work = partial(refit_group, model)
        executor = _executor(workers)
        try:
            waiting: deque[tuple[Group, Future[list[Record]]]] = deque()
            source = iter(groups)
            while True:
                while len(waiting) < WINDOW * workers and (group := next(source, None)) is not None:
                    waiting.append((group, executor.submit(work, group)))
                if not waiting:
                    return
                group, future = waiting.popleft()
                try:
                    done = future.result()
                except BrokenProcessPool:
                    done = _alone(work, group)
                    executor.shutdown(cancel_futures=True)
                    executor = _executor(workers)
                    waiting = deque((other, executor.submit(work, other)) for other, _ in waiting)
                yield done
        finally:
            executor.shutdown(cancel_futures=True)

    return run


def _executor(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def _alone(work: Callable[[Group], list[Record]], group: Group) -> list[Record]:
    with _executor(1) as executor:
        try:
            return executor.submit(work, group).result()
        except BrokenProcessPool:
            return _failed(group, "its worker process died")


class _Client(Protocol):
    def submit(self, function: Any, *args: Any, **kwargs: Any) -> Any: ...

    def run(self, function: Any) -> dict[str, Any]: ...


def dask_engine(workers: int, scheduler: str | None) -> Engine:
    """A Dask cluster: the one at `scheduler` (tcp://…), or a local one of `workers` processes.

    A group of which the worker died three times is recorded as failed. InputError: Dask is not installed, no scheduler
    there, or its workers have another version of the bench.
    """

    def run(model: Model, groups: Iterable[Group]) -> Iterator[list[Record]]:
        client, cluster = _connect(workers, scheduler)
        try:
            _same_version(client)
            threads = max(1, sum(client.nthreads().values()))
            yield from _windowed(client, partial(refit_group, model), groups, WINDOW * threads)
        finally:
            client.close()
            if cluster is not None:
                cluster.close()

    return run


def _connect(workers: int, scheduler: str | None) -> tuple[Any, Any]:
    try:
        distributed: Any = import_module("distributed")
    except ModuleNotFoundError:
        raise InputError("Dask is not installed: pip install 'gyro-thermal-bench[fleet]', or --engine pool") from None
    if scheduler is None:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=None,
            host="127.0.0.1",
            silence_logs=logging.ERROR,
        )
        return distributed.Client(cluster), cluster
    try:
        return distributed.Client(scheduler, timeout="15s"), None
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no Dask scheduler: {error}; start one with `dask scheduler`", scheduler) from None


def _same_version(client: _Client) -> None:
    found = set(client.run(_version).values())
    if found - {__version__}:
        raise InputError(
            f"the workers have bench {', '.join(sorted(found))}, this one is {__version__}; install the same"
        )
    if not found:
        raise InputError("the Dask scheduler has no workers; start some with `dask worker`")


def _version() -> str:
    return __version__


def _windowed(
    client: _Client, work: Callable[[Group], list[Record]], groups: Iterable[Group], window: int
) -> Iterator[list[Record]]:
    waiting: deque[tuple[Group, Any]] = deque()
    source = iter(groups)
    while True:
        while len(waiting) < window and (group := next(source, None)) is not None:
            # Not pure: equal moments of two units are two tasks.
            waiting.append((group, client.submit(work, group, pure=False, retries=2)))
        if not waiting:
            return
        group, future = waiting.popleft()
        error = future.exception()
        yield (
            future.result() if error is None else _failed(group, f"{type(error).__name__}: {error}".partition("\n")[0])
        )
        future.release()


def _failed(group: Group, why: str) -> list[Record]:
    return [Record(unit, run, f"not refitted: {why}") for unit, run in zip(group.units, group.runs, strict=True)]
