"""Runs that the page started: detached processes, which a server finds again through their files after a restart.

The folder `<out>/.web/starts/<start>/` of a start holds the request and its user (`start.json`), the output of the
process (`stdout`, `stderr`), a lock that the process holds while it lives, and its exit code.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import secrets
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from bench.acquisition import LIVE
from bench.base import EquipmentError, InputError
from bench.record import MANIFEST, StartRecord
from bench.web.live.story import state_of

EXIT = "exit_code"
"""The exit code of the process, in the folder of its start."""
KEPT = 200
"""Number of starts that are kept; the oldest are removed, their runs stay."""
_SAID_BYTES = 1 << 20

State = Literal["starting", "running", "ended", "refused"]


class _Detached(subprocess.Popen[bytes]):
    """A process that outlives the server: nobody waits for it."""

    def __del__(self) -> None:
        """Do not warn, as Popen does, that the process still runs: it is meant to."""


class InUse(Exception):  # noqa: N818 - a state, not an error
    """Another run uses this equipment; the text says whose and what to do."""


@dataclass(frozen=True)
class Order:
    """A run to start: files, units, models, limits, user."""

    plan: str
    station: str
    profile_file: Path
    station_file: Path
    equipment: frozenset[str]
    """Equipment that no other run may use meanwhile."""
    units: Sequence[str] = ()
    models: Sequence[str] = ()
    limits: Path | None = None
    who: Mapping[str, str] = field(default_factory=dict)
    operator: str = ""
    """The user, for events and manifest."""

    def arguments(self, out: Path) -> list[str]:
        """Arguments of `bench`."""
        more = [("--unit", unit) for unit in self.units] + [("--model", model) for model in self.models]
        more += [("--limits", str(self.limits))] if self.limits else []
        more += [("--station", str(self.station_file)), ("--out", str(out)), ("--operator", self.operator)]
        return ["run", "--quiet", "--json", *(word for pair in more for word in pair), "--", str(self.profile_file)]


class Starts:
    """The starts of one server; safe to use from any thread."""

    def __init__(self, own: Path, out: Path, project: Path) -> None:
        """`own`: the server's folder, `out`: where the runs go, `project`: where they are started."""
        self._folder, self._out, self._project = own / "starts", out.resolve(), project
        self._lock = threading.RLock()
        self._children: list[_Detached] = []
        self._ended: dict[str, dict[str, Any]] = {}

    def begin(self, order: Order, in_use: Mapping[str, str]) -> dict[str, Any]:
        """Start a run; InUse where another one uses its equipment. `in_use`: equipment of live runs, with texts."""
        with self._lock:
            in_use = {**in_use, **self._in_use()}
            if taken := sorted(order.equipment & in_use.keys()):
                text = f"{taken[0]} is in use: {in_use[taken[0]]}; wait for its end, or abort it first"
                raise InUse(text)
            self._forget()
            folder = self._new_folder()
            about = StartRecord(
                start=folder.name,
                plan=order.plan,
                station=order.station,
                equipment=tuple(sorted(order.equipment)),
                units=tuple(order.units),
                models=tuple(order.models),
                limits=order.limits.stem if order.limits else None,
                who=dict(order.who),
                started=datetime.now(UTC).isoformat(timespec="milliseconds"),
                runs=(),
                pid=None,
            )
            try:
                about.write(folder)  # written first, so that every process has a record
                pid = self._spawn(folder, order.arguments(self._out))
            except OSError as error:
                shutil.rmtree(folder, ignore_errors=True)
                raise EquipmentError(f"the run cannot be started: {error.strerror or error}") from error
            self._write(folder, about.model_copy(update={"pid": pid}))
            return self._told(folder)

    def _write(self, folder: Path, about: StartRecord) -> None:
        """Write the record; on a full disk the link from the start to its run is lost, but the run goes on."""
        with contextlib.suppress(OSError):
            about.write(folder)

    def _new_folder(self) -> Path:
        name = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}"
        folder = self._folder / name
        folder.mkdir(parents=True)
        return folder

    def _spawn(self, folder: Path, arguments: list[str]) -> int:
        """Start a process in its own session, so that neither the server's end nor its terminal ends it."""
        environment = {name: value for name, value in os.environ.items() if name != "BENCH_TOKEN"}
        with (
            (folder / "lock").open("wb") as lock,
            (folder / "stdout").open("wb") as stdout,
            (folder / "stderr").open("wb") as stderr,
        ):
            fcntl.flock(lock, fcntl.LOCK_EX)  # the child inherits and keeps the lock
            number = str(lock.fileno())
            child = _Detached(
                [sys.executable, "-P", "-m", "bench.cli.started", str(folder.resolve()), number, *arguments],
                cwd=self._project, env=environment, stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr,
                start_new_session=True, pass_fds=(lock.fileno(),),
            )  # fmt: skip
        self._children = [known for known in self._children if known.poll() is None] + [child]
        return child.pid

    def reap(self) -> None:
        """Collect the exit status of ended processes."""
        with self._lock:
            self._children = [child for child in self._children if child.poll() is None]

    def saw(self, pid: int, runs: Sequence[str]) -> dict[str, Any] | None:
        """Record the folders of a live run of process `pid` in its start, and return the start; None without one."""
        with self._lock:
            for folder in self._folders():
                about = _about(folder)
                if about and folder.name not in self._ended and about.pid == pid and _alive(folder):
                    if about.runs != tuple(runs):
                        about = about.model_copy(update={"runs": tuple(runs)})
                        self._write(folder, about)
                    return _facts(about)
        return None

    def find(self, start: str) -> dict[str, Any] | None:
        """A start with its outcome; None for an unknown name."""
        with self._lock:
            return next((self._told(folder) for folder in self._folders() if folder.name == start), None)

    def listed(self) -> list[dict[str, Any]]:
        """All starts, newest first."""
        with self._lock:
            return [told for folder in self._folders() if (told := self._told(folder))]

    def of_run(self, run: str) -> dict[str, Any] | None:
        """The newest start that made this run."""
        return next((told for told in self.listed() if run in told["runs"]), None)

    def _folders(self) -> list[Path]:
        with contextlib.suppress(FileNotFoundError):
            return sorted((entry for entry in self._folder.iterdir() if entry.is_dir()), reverse=True)
        return []

    def _forget(self) -> None:
        for folder in self._folders()[KEPT - 1 :]:
            if not _alive(folder):
                shutil.rmtree(folder, ignore_errors=True)
                self._ended.pop(folder.name, None)

    def _in_use(self) -> dict[str, str]:
        """Equipment of starts whose run has not ended; a run that is only being analysed uses none."""
        found: dict[str, str] = {}
        for told in self.listed():
            over = told["runs"] and not any((self._out / run / LIVE).exists() for run in told["runs"])
            if told["state"] in {"starting", "running"} and not over:
                who, at = told["who"].get("name", "somebody"), told["started"][11:16]
                text = f"{who} started {told['plan']} there at {at} UTC"
                found |= dict.fromkeys(told["equipment"], text)
        return found

    def _told(self, folder: Path) -> dict[str, Any]:
        if known := self._ended.get(folder.name):
            return known
        about = _about(folder)
        if about is None:
            return {}
        alive = _alive(folder)  # before the files, so that nothing the process wrote is missed
        told = {**_facts(about), **_outcome(folder, about, alive, self._out)}
        if told["state"] in {"ended", "refused"}:
            self._ended[folder.name] = told
        return told


def _about(folder: Path) -> StartRecord | None:
    try:
        return StartRecord.find(folder)
    except InputError:  # the run itself is not in it: one damaged start costs the way to its run, not the list
        return None


def _facts(about: StartRecord) -> dict[str, Any]:
    """As the page's API tells it."""
    return about.model_dump(mode="json", exclude={"format"})


def _alive(folder: Path) -> bool:
    """Whether the process of a start lives, which then holds the lock."""
    try:
        with (folder / "lock").open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _outcome(folder: Path, about: StartRecord, alive: bool, out: Path) -> dict[str, Any]:
    """State, exit code, verdict and message of a start."""
    nothing: dict[str, Any] = {"exit_code": None, "verdict": None, "sentence": "", "message": "", "verdicts": []}
    if alive:
        return {**nothing, "state": "running" if about.runs else "starting"}
    code = _exit_code(folder)
    said = _said(folder)
    content = _answer(folder)
    runs = _runs(content, out) or list(about.runs)
    if code is None:
        again = _again(out / runs[0]) if runs else "start it again"
        return {**nothing, "state": "ended", "runs": runs, "message": f"something ended its process; {again}"}
    if code == 2 and not runs:
        return {**nothing, "state": "refused", "exit_code": code, "message": said}
    return {
        "state": "ended",
        "runs": runs,
        "exit_code": code,
        "verdict": content.get("verdict"),
        "sentence": str(content.get("sentence", "")),
        "message": str(content.get("error", "")) or ("" if content else said),
        "verdicts": [state_of(unit) for unit in content.get("units", [content] if content else [])],
    }


def _again(run: Path) -> str:
    """Advice for a run whose process was killed, during the run or its analysis."""
    if (run / MANIFEST).is_file():
        return f"`bench report {run}` analyses it"
    return f"`bench resume {run}` goes on with it"


def _exit_code(folder: Path) -> int | None:
    try:
        return int((folder / EXIT).read_text())
    except (OSError, ValueError):
        return None


def _said(folder: Path) -> str:
    """Last message of `bench`, as one line."""
    with contextlib.suppress(OSError):
        lines = (folder / "stderr").read_bytes()[-_SAID_BYTES:].decode("utf-8", "replace").splitlines()
        first = next((i for i, line in enumerate(lines) if line.startswith("bench: ")), max(len(lines) - 1, 0))
        return "; ".join(line.removeprefix("bench: ").strip() for line in lines[first:] if line.strip())[:2000]
    return ""


def _answer(folder: Path) -> dict[str, Any]:
    """The object that `bench run --json` printed; empty without one."""
    try:
        content = json.loads((folder / "stdout").read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _runs(content: Mapping[str, Any], out: Path) -> list[str]:
    """Ids of the runs in an answer."""
    return list(_ids((unit.get("run") for unit in content.get("units", [content])), out))


def _ids(paths: Iterable[str | None], out: Path) -> Iterator[str]:
    for path in paths:
        if path:
            with contextlib.suppress(ValueError):
                yield Path(path).resolve().relative_to(out).as_posix()
