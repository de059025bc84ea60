"""Runs and calibrations that the page started: detached processes.

A server finds them again through their files after a restart. What waits for its equipment has no process yet. The
folder `<out>/.web/starts/<start>/` of a start holds the request and its user (`start.json`), the output of the process
(`stdout`, `stderr`), a lock that the process holds while it lives, and its exit code.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from bench.base import OPERATOR, EquipmentError, InputError, hold, library, locked
from bench.record import LIVE, StartRecord, sha256
from bench.web.live.outcomes import LOCK, outcome, waits

KEPT = 200
"""Number of starts that are kept; the oldest are removed, their runs stay."""
_LATE = timedelta(minutes=1)
"""A time to begin may have passed by this: people give whole minutes."""

State = Literal["waiting", "starting", "running", "ended", "refused"]


class _Detached(subprocess.Popen[bytes]):
    """A process that outlives the server: nobody waits for it."""

    def __del__(self) -> None:
        """Do not warn, as Popen does, that the process still runs: it is meant to."""


class InUse(Exception):  # noqa: N818 - a state, not an error
    """Another run uses this equipment; the text says whose and what to do."""


@dataclass(frozen=True)
class Order:
    """A run, its continuation, a calibration or a write into a unit to start: files, units, models, limits, user."""

    plan: str
    station: str
    station_file: Path
    equipment: frozenset[str]
    """Equipment that no other run may use meanwhile."""
    profile_file: Path | None = None
    """Of a run."""
    verifies: bool = False
    """The run is with the unit's own correction on, and judges it (`bench verify`)."""
    flashes: Path | None = None
    """Run whose calibration is written into its unit (`bench flash`)."""
    resumes: Path | None = None
    """Run that goes on (`bench resume`), with what its folder keeps: profile, station, models and limits."""
    plan_file: Path | None = None
    """Of a calibration, with the digests of its jobs, one for each unit."""
    digests: Sequence[str] = ()
    behind: Sequence[Path] = ()
    """Files that plan and station name."""
    release: str = ""
    """Why a held calibration goes on."""
    anew: bool = False
    queue: bool = False
    """Wait until nothing else uses the equipment."""
    not_before: datetime | None = None
    """Wait until then, too."""
    units: Sequence[str] = ()
    """Units of the station, or new ones in their slots (`NEW@KNOWN`)."""
    models: Mapping[str, str] = field(default_factory=dict)
    """By name, each as `bench run --model` takes it."""
    limits: Path | None = None
    who: Mapping[str, str] = field(default_factory=dict)
    """The user, for events and manifest: name, role, address."""

    def arguments(self, out: Path) -> list[str]:
        """Arguments of `bench`."""
        if self.resumes:
            return ["resume", "--quiet", "--json", "--out", str(out), "--", str(self.resumes)]
        more = [] if self.flashes else [("--unit", unit) for unit in self.units]
        more += [("--run", str(self.flashes))] if self.flashes else []
        more += [("--model", model) for model in self.models.values()]
        more += [("--limits", str(self.limits))] if self.limits else []
        more += [("--station", str(self.station_file)), ("--out", str(out))]
        more += [("--plan", str(self.plan_file))] if self.plan_file else []
        more += [("--release", self.release)] if self.release else []
        words = [word for pair in more for word in pair] + ["--new"] * self.anew
        last = [str(self.profile_file)] if self.profile_file else self.units if self.flashes else []
        return [self._command, "--quiet", "--json", *words, *(["--", *last] if last else [])]

    def files(self) -> list[Path]:
        """Files that say what it does."""
        models = [Path(model) for model in self.models.values() if Path(model).is_file()]
        named = (self.station_file, self.profile_file, self.plan_file, self.limits, *models, *self.behind)
        return [file for file in named if file is not None]

    @property
    def _command(self) -> str:
        if self.flashes:
            return "flash"
        return "calibrate" if self.plan_file else "verify" if self.verifies else "run"


class Starts:
    """The starts of one server; safe to use from any thread."""

    def __init__(
        self, own: Path, out: Path, project: Path, now: Callable[[], datetime] = lambda: datetime.now(UTC)
    ) -> None:
        """`own`: the server's folder, `out`: where the runs go, `project`: where they are started."""
        self._now = now
        self._folder, self._out, self._project = own / "starts", out.resolve(), project
        self._lock = threading.RLock()
        self._children: list[_Detached] = []
        self._ended: dict[str, dict[str, Any]] = {}
        self._waiting = {folder.name for folder in self._folders()}
        """What may wait for its equipment; at first all that there is."""

    def begin(self, order: Order, in_use: Mapping[str, str]) -> dict[str, Any]:
        """Start a run; InUse where another one uses its equipment. `in_use`: equipment of live runs, with texts.

        InputError where the time before which it must not begin has passed: nothing moves at once that was planned.
        """
        with self._lock:
            if order.not_before is not None and order.not_before < self._now() - _LATE:
                given = order.not_before.isoformat(timespec="minutes")
                raise InputError(
                    f"not_before is {given}, which has passed: give a later time, or none to start at once"
                )
            in_use = {**in_use, **self.in_use()}
            taken = sorted(order.equipment & in_use.keys())
            later = order.not_before is not None and order.not_before > self._now()
            if taken and not (order.queue or later):
                text = f"{taken[0]} is in use: {in_use[taken[0]]}; wait for its end, or abort it first"
                raise InUse(text)
            self._forget()
            folder = self._new_folder()
            about = StartRecord(
                start=folder.name,
                digest=next(iter(order.digests), ""),
                digests=tuple(order.digests),
                plan=order.plan,
                station=order.station,
                equipment=tuple(sorted(order.equipment)),
                units=tuple(order.units),
                models=tuple(order.models),
                limits=order.limits.stem if order.limits else None,
                who=dict(order.who),
                started=datetime.now(UTC).isoformat(timespec="milliseconds"),
                resumes="/".join(order.resumes.parts[-2:]) if order.resumes else "",
                runs=(),
                waiting=tuple(order.arguments(self._out)),
                files={str(file): _digest(file) for file in order.files()},
                not_before=None if order.not_before is None else order.not_before.isoformat(timespec="seconds"),
                pid=None,
            )
            try:
                about.write(folder)  # written first, so that every process has a record
                self._waiting.add(folder.name)
                if not (taken or later):
                    self._go(folder, about)
            except OSError as error:
                shutil.rmtree(folder, ignore_errors=True)
                raise EquipmentError(f"the run cannot be started: {error.strerror or error}") from error
            return self._told(folder)

    def _go(self, folder: Path, about: StartRecord) -> None:
        pid = self._spawn(folder, list(about.waiting), about.who)
        self._write(folder, about.model_copy(update={"pid": pid, "waiting": ()}))

    def _changed(self, about: StartRecord) -> str:
        """What has become of the files that somebody confirmed, while it waited; empty where they are the same."""
        files = [path for path, digest in about.files.items() if _digest(self._of_now(Path(path))) != digest]
        if not files:
            return ""
        names = ", ".join(Path(path).name for path in files)
        return f"{names} changed while this waited, so it does not begin; take it out of the queue and start it again"

    def _of_now(self, file: Path) -> Path:
        """A file, or the user's own one that has taken the place of a shipped one."""
        shipped = library().resolve()
        own = self._project / "profiles" / file.relative_to(shipped) if file.is_relative_to(shipped) else file
        return own if own.is_file() else file

    def take_up(self, in_use: Mapping[str, str]) -> None:
        """Start what waits for equipment that is free now, in their turn; nothing before its time, or changed since."""
        with self._lock:
            waiting = self._in_turn()
            self._waiting = {*waiting}
            if not waiting:
                return
            taken = {*in_use, *self.in_use()}
            for name, about in waiting.items():
                if about.not_before is not None and datetime.fromisoformat(about.not_before) > self._now():
                    continue
                if self._changed(about):
                    continue
                if not taken & {*about.equipment}:
                    self._go(self._folder / name, about)
                taken |= {*about.equipment}  # whoever came first is first

    def _in_turn(self) -> dict[str, StartRecord]:
        """What waits, first what is next."""
        waiting = {name: about for name in self._waiting if (about := self._waits(name))}
        return dict(sorted(waiting.items(), key=lambda item: item[1].turn or item[0]))

    def waiting(self) -> list[dict[str, Any]]:
        """All that waits, first what is next."""
        with self._lock:
            return [self._told(self._folder / name) for name in self._in_turn()]

    def move(self, start: str, by: int) -> bool:
        """Move a start that waits by so many places, back or (below 0) forward; False where it does not wait."""
        with self._lock:
            turns = self._in_turn()
            if start not in turns:
                return False
            names = list(turns)
            places = [about.turn or name for name, about in turns.items()]
            at = names.index(start)
            names.insert(max(at + by, 0), names.pop(at))
            for name, place in zip(names, places, strict=True):
                if (turns[name].turn or name) != place:
                    self._write(self._folder / name, turns[name].model_copy(update={"turn": place}))
            return True

    def _waits(self, name: str) -> StartRecord | None:
        about = _about(self._folder / name)
        return about if about is not None and waits(self._folder / name, about) else None

    def give_up(self, start: str) -> bool:
        """Remove a start that waits; False where it does not wait, or not any more."""
        with self._lock:
            found = start in {folder.name for folder in self._folders()} and self._waits(start) is not None
            if found:
                shutil.rmtree(self._folder / start, ignore_errors=True)
            return found

    def _write(self, folder: Path, about: StartRecord) -> None:
        """Write the record; on a full disk the link from the start to its run is lost, but the run goes on."""
        with contextlib.suppress(OSError):
            about.write(folder)

    def _new_folder(self) -> Path:
        name = f"{datetime.now(UTC):%Y%m%dT%H%M%S%fZ}-{secrets.token_hex(4)}"  # sorts by time
        folder = self._folder / name
        folder.mkdir(parents=True)
        return folder

    def _spawn(self, folder: Path, arguments: list[str], who: Mapping[str, str]) -> int:
        """Start a process in its own session, so that neither the server's end nor its terminal ends it."""
        if os.name == "nt":
            raise OSError("the page starts runs on Linux and macOS; use `bench run`")
        environment = {name: value for name, value in os.environ.items() if name != "BENCH_TOKEN"}
        if who:
            environment[OPERATOR] = "{name} ({role}) from {address}".format(**who)
        with (
            (folder / LOCK).open("wb") as lock,
            (folder / "stdout").open("wb") as stdout,
            (folder / "stderr").open("wb") as stderr,
        ):
            hold(lock, wait=True)  # the child inherits and keeps the lock
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

    def by_job(self) -> dict[tuple[str, str], list[dict[str, Any]]]:
        """The starts of each calibration, newest first, by its unit and digest."""
        found: dict[tuple[str, str], list[dict[str, Any]]] = {}
        for told in self.listed():
            for job in jobs_of(told):
                found.setdefault(job, []).append(told)
        return found

    def of_run(self, run: str) -> dict[str, Any] | None:
        """The newest start that made this run."""
        return next((told for told in self.listed() if run in told["runs"]), None)

    def resuming(self, runs: Sequence[str]) -> bool:
        """Whether a process is about to go on with one of these runs, whose `live.json` it has removed."""
        return any(told["state"] == "starting" and told["resumes"] in runs for told in self.listed())

    def _folders(self) -> list[Path]:
        with contextlib.suppress(FileNotFoundError):
            return sorted((entry for entry in self._folder.iterdir() if entry.is_dir()), reverse=True)
        return []

    def _forget(self) -> None:
        for folder in self._folders()[KEPT - 1 :]:
            if not _alive(folder) and not self._waits(folder.name):
                shutil.rmtree(folder, ignore_errors=True)
                self._ended.pop(folder.name, None)

    def in_use(self) -> dict[str, str]:
        """Equipment of starts whose run has not ended; a run that is only being analysed uses none."""
        found: dict[str, str] = {}
        for told in self.listed():
            live = any((self._out / run / LIVE).exists() for run in told["runs"])
            over = told["runs"] and not live and not told["digest"]  # a calibration has further runs
            if told["state"] in {"starting", "running"} and not over:
                who, at = told["who"].get("name", "somebody"), told["started"][11:16]
                text = f"{who} started {told['plan']} at station {told['station']} at {at} UTC"
                found |= dict.fromkeys(told["equipment"], text)
        return found

    def _told(self, folder: Path) -> dict[str, Any]:
        if known := self._ended.get(folder.name):
            return known
        about = _about(folder)
        if about is None:
            return {}
        alive = _alive(folder)  # before the files, so that nothing the process wrote is missed
        told = {**_facts(about), **outcome(folder, about, alive, self._out, self._project)}
        if told["state"] == "waiting":
            told["message"] = self._changed(about)
        if told["state"] in {"ended", "refused"}:
            self._ended[folder.name] = told
        return told


def serial_of(unit: str) -> str:
    """Serial number of a unit, which may be a new one in a slot (`NEW@KNOWN`)."""
    return unit.rpartition("@")[0] or unit


def jobs_of(start: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Serial number and digest of each job that a start began or went on with; none for a run."""
    digests = start.get("digests") or [start["digest"]]
    return [(serial_of(unit), digest) for unit, digest in zip(start["units"], digests, strict=False) if digest]


def _about(folder: Path) -> StartRecord | None:
    try:
        return StartRecord.find(folder)
    except InputError:  # the run itself is not in it: one damaged start costs the way to its run, not the list
        return None


def _facts(about: StartRecord) -> dict[str, Any]:
    """As the page's API tells it."""
    return about.model_dump(mode="json", exclude={"format", "waiting", "files"})


def _digest(file: Path) -> str:
    """SHA-256 of a file; empty where it cannot be read."""
    try:
        return sha256(file)
    except OSError:
        return ""


def _alive(folder: Path) -> bool:
    """Whether the process of a start lives, which then holds the lock."""
    return locked(folder / LOCK)
