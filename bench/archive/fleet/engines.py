"""Where work on groups of units is done: on this computer or on a Dask cluster. The answer is the same, bit for bit.

A few groups per worker are in work at a time, and the answers come back in order, so memory does not grow with the
fleet. (Bit for bit holds among computers of one kind: another processor may round a sum differently in the last place.)
"""

from __future__ import annotations

import hashlib
import logging
import multiprocessing
import os
import pickle
import subprocess
import sys
import tempfile
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
import scipy

from bench.analysis import Effect, own_effects, register
from bench.base import InputError, __version__

WINDOW = 3
"""Groups per worker that are in work or waiting."""
GONE_S = 60.0
"""How long a cluster may be without any worker [s]."""
_LOOK_S = 2.0
_DIED = "its worker process died"
_ONE_TASK = """
import pickle, sys
from pathlib import Path
do, group = pickle.loads(Path(sys.argv[1]).read_bytes())
Path(sys.argv[2]).write_bytes(pickle.dumps(do(group)))
"""
_LEAST_TRIES, _MOST_TRIES = 6, 40
"""Of parts of one group: without a part that can be done, and twice what finds one or two units among 256."""


class Units(Protocol):
    """A group of units, of which a part can be taken."""

    def __len__(self) -> int:
        """Number of units."""

    def __getitem__(self, part: slice, /) -> Self:
        """The units of a part."""


G = TypeVar("G", bound=Units)
R = TypeVar("R")


@dataclass(frozen=True)
class Work(Generic[G, R]):
    """What is done with a group: an answer a unit, in their order. Both functions can be sent to other processes."""

    do: Callable[[G], list[R]]
    lost: Callable[[G, str], list[R]]
    """The answers of units that kill their process or raise an error, and why there are no others."""
    root: Path | None = None
    """Folder that the workers must see."""


class Engine(Protocol):
    """Does the work with each group; the answers come in the order of the groups."""

    def __call__(self, work: Work[G, R], groups: Iterable[G], /) -> Iterator[list[R]]:
        """Answers, group by group."""


def _portable(work: Work[G, R]) -> Callable[[G], list[R] | str]:
    """The same work, for processes that do not have the user's effects yet."""
    return partial(_contained, own_effects(), work.do)


def _contained(own: Sequence[type[Effect]], do: Callable[[G], list[R]], group: G) -> list[R] | str:
    """Answers, or the error in one line: an exception of some library may not be pickled, or not be read again."""
    try:
        for kind in own:
            if kind not in own_effects():
                register(kind, kind.__name__)
        return do(group)
    except Exception as error:
        return " ".join("".join(traceback.format_exception_only(error)).split())


def _alone(do: Callable[[G], list[R] | str], group: G) -> list[R] | str:
    """The same in a process of its own, which may die: workers of a cluster are daemons, which have no children."""
    with tempfile.TemporaryDirectory() as folder:
        task, done = Path(folder, "task"), Path(folder, "done")
        task.write_bytes(pickle.dumps((do, group)))
        command = [sys.executable, "-c", _ONE_TASK, str(task), str(done)]
        paths = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        died = subprocess.run(command, env=paths, check=False).returncode != 0
        answers: list[R] | str = _DIED if died else pickle.loads(done.read_bytes())
        return answers


def local_engine(workers: int) -> Engine:
    """On this computer: in this process for one worker, else in `workers` processes.

    A group that kills its process is halved until the unit that does it stands alone; only that one fails.
    """

    def run(work: Work[G, R], groups: Iterable[G], /) -> Iterator[list[R]]:
        if workers == 1:
            yield from map(work.do, groups)
            return
        do = _portable(work)
        executor = _executor(workers)

        def submit(group: G) -> Future[list[R] | str]:
            nonlocal executor
            try:
                return executor.submit(do, group)
            except BrokenProcessPool:
                executor = _executor(workers)
                return executor.submit(do, group)

        def result(future: Future[list[R] | str]) -> list[R] | str:
            try:
                return future.result()
            except BrokenProcessPool:
                return _DIED

        try:
            for group, future in _ahead(submit, groups, WINDOW * workers):
                found = result(future)
                yield _halved(group, partial(_alone, do), work.lost) if isinstance(found, str) else found
        finally:
            executor.shutdown(cancel_futures=True)

    return run


def dask_engine(workers: int, scheduler: str | None) -> Engine:
    """The Dask cluster at `scheduler` (tcp://…), else one of `workers` processes on this computer.

    A group whose worker died three times is halved until the unit that does it stands alone; only that one fails. The
    parts are done in processes beside the workers: a cluster gives up workers that die again and again.
    InputError: Dask is not installed, no scheduler answers at the address, it or all workers went away meanwhile, or
    the workers have other code than this computer.
    """

    def run(work: Work[G, R], groups: Iterable[G], /) -> Iterator[list[R]]:
        with _client(workers, scheduler) as client:
            _require_same_code(client, own_effects())
            do = _portable(work)
            if work.root is not None:
                _require_folder(client, work.root)
            threads = max(1, sum(client.nthreads().values()))

            def submit(group: G) -> Any:
                # Not pure: equal moments of two units are two tasks.
                return client.submit(do, group, pure=False, retries=2)

            def again(group: G) -> list[R] | str:
                found: list[R] | str = _result(client, client.submit(_alone, do, group, pure=False, retries=2))
                return found

            for done, (group, future) in enumerate(_ahead(submit, groups, WINDOW * threads)):
                try:
                    found = _result(client, future)
                    yield _halved(group, again, work.lost) if isinstance(found, str) else found
                except (OSError, CancelledError) as error:
                    text = f"the Dask scheduler went away after {done} groups ({type(error).__name__}); start it again"
                    raise InputError(f"{text}, and give the command again", scheduler) from None
                future.release()

    return run


def _result(client: Any, future: Any) -> Any:
    """What a task made, or why it failed. InputError where no worker comes back for a minute."""
    left_s = GONE_S
    while True:
        try:
            error = future.exception(timeout=_LOOK_S)
            break
        except TimeoutError:
            left_s = GONE_S if client.nthreads() else left_s - _LOOK_S
            if left_s <= 0.0:
                text = f"no Dask worker for {GONE_S:g} s; start some with `dask worker`, and give the command again"
                raise InputError(text) from None
    if isinstance(error, CancelledError):
        raise error
    return future.result() if error is None else _DIED


def _halved(group: G, again: Callable[[G], list[R] | str], lost: Callable[[G, str], list[R]]) -> list[R]:
    """Answers of a group that could not be done as one; `again` does a part, or says why it fails, too."""
    found: dict[int, R] = {}
    waiting, tries, some, why = deque([range(len(group))]), 0, False, ""
    while waiting:
        part = waiting.popleft()
        own = group[part.start : part.stop]
        hopeless = tries >= (_MOST_TRIES if some else _LEAST_TRIES)
        answers = why if hopeless else again(own)
        tries, some = tries + (not hopeless), some or not isinstance(answers, str)
        why = answers if isinstance(answers, str) else why
        if isinstance(answers, str) and len(part) > 1 and not hopeless:
            middle = (part.start + part.stop) // 2
            waiting += [range(part.start, middle), range(middle, part.stop)]
            continue
        found |= dict(zip(part, lost(own, answers) if isinstance(answers, str) else answers, strict=True))
    return [found[i] for i in range(len(group))]


def _ahead(submit: Callable[[G], Any], groups: Iterable[G], window: int) -> Iterator[tuple[G, Any]]:
    """Every group with its future, in order; up to `window` groups are submitted ahead."""
    waiting: deque[tuple[G, Any]] = deque()
    source = iter(groups)
    while True:
        while len(waiting) < window and (group := next(source, None)) is not None:
            waiting.append((group, submit(group)))
        if not waiting:
            return
        yield waiting.popleft()


def _executor(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def _client(workers: int, scheduler: str | None) -> Any:
    """A client of the cluster; it ends a cluster that it started itself."""
    try:
        distributed: Any = import_module("distributed")
    except ModuleNotFoundError:
        raise InputError("Dask is not installed: pip install 'gyro-thermal-bench[fleet]', or --engine pool") from None
    # A cluster of this process closes workers that are away for so long, although they are about to come back.
    import_module("dask").config.set({"distributed.deploy.lost-worker-timeout": "1 day"})
    if scheduler is None:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        return distributed.Client(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            host="127.0.0.1",
            silence_logs=logging.ERROR,
        )
    try:
        return distributed.Client(scheduler, timeout="15s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(f"no Dask scheduler: {error}; start one with `dask scheduler`", scheduler) from None


def _require_same_code(client: Any, effects: Sequence[type[Effect]] = ()) -> None:
    try:
        found = _asked(client, fingerprint, effects)
    except (ImportError, OSError) as error:
        raise InputError(f"a Dask worker cannot load an effect: {error}; mount its file there") from None
    if not found:
        raise InputError("the Dask scheduler has no workers; start some with `dask worker`")
    own = fingerprint(effects)
    for worker, theirs in sorted(found.items()):
        if theirs != own:
            what = next(name for name in own if theirs.get(name) != own[name])
            text = f"worker {worker} has {what} {theirs.get(what)}, this computer {own[what]}: install the same"
            raise InputError(f"{text}, or the numbers would differ")


def _asked(client: Any, function: Callable[..., Any], *given: Any) -> dict[str, Any]:
    """What each worker answers; InputError where the scheduler goes away meanwhile."""
    try:
        found: dict[str, Any] = client.run(function, *given)
        return found
    except OSError as error:
        if type(error).__module__.partition(".")[0] != "distributed":  # a worker's own error
            raise
        text = f"the Dask scheduler went away ({type(error).__name__}); start it again, and give the command again"
        raise InputError(text) from None


def _require_folder(client: Any, root: Path) -> None:
    for worker, seen in sorted(_asked(client, os.path.isdir, str(root)).items()):
        if not seen:
            raise InputError(f"worker {worker} does not see this folder; mount it there under the same path", root)


def fingerprint(effects: Sequence[type[Effect]] = ()) -> dict[str, str]:
    """What the numbers depend on: versions, and the hashes of the bench's own code and of the user's effects."""
    theirs = hashlib.sha256()
    for kind in effects:
        theirs.update(Path(str(sys.modules[kind.__module__].__file__)).read_bytes())
    digest = hashlib.sha256()
    top = Path(str(files("bench")))
    for path in sorted(top.rglob("*.py")):
        digest.update(path.relative_to(top).as_posix().encode() + b"\0" + path.read_bytes())
    return {
        "bench": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "code": digest.hexdigest()[:12],
        "effects": theirs.hexdigest()[:12],
    }
