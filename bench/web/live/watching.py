"""Watches live runs: one thread asks each at most five times a second, whatever the number of browsers.

It passes its results to one listener. The end of a run is reported twice: when the equipment is safe, and when the
verdict exists.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from bench.acquisition import ANSWER_S, LiveRun, ask_run
from bench.base import BenchError, EquipmentError, InputError, process_alive
from bench.record import LIVE
from bench.web.ground.problems import within
from bench.web.live import story
from bench.web.live.finding import Finder, ids
from bench.web.live.mirror import Mirror
from bench.web.live.starts import Starts
from bench.web.live.subject import describe, in_use

PERIOD_S = 0.2
"""Shortest time between two questions to a run."""
IDLE_S = 1.0
"""The same while no browser looks; also the interval of the search for live runs."""
PATIENCE_S = 1.0
SILENT_S = 3.0
"""Pause after a run did not answer [s]."""
TICKING = frozenset({"running", "pausing", "holding"})
"""States in which the loop of a run ticks once a second."""
VERDICT_S = 3600.0
"""Longest wait for an analysis [s]."""

_log = logging.getLogger("bench.web")
Listener = Callable[[list["Watched"], list[dict[str, Any]]], None]


class Watched:
    """The last known state of a live run; only the watcher's thread writes it, replacing whole values."""

    def __init__(self, live: LiveRun, started_by: dict[str, Any] | None) -> None:
        self.live, self.mirror = live, Mirror()
        self.about = describe(live, started_by)
        self.picture: dict[str, Any] = {"state": "starting"}
        self.condition, self.detail = "live", ""
        self.next_s = 0.0
        self.traced = True
        """Whether the run offers a trace."""
        self.killed = False
        """Whether its process is gone without writing an end."""

    @property
    def runs(self) -> list[str]:
        """Ids of all run folders of this run."""
        runs: list[str] = self.about["runs"]
        return runs

    def told(self) -> dict[str, Any]:
        """The state for `/live`."""
        told = {**self.about, **self.picture, "condition": self.condition, "detail": self.detail}
        return told if self.condition == "live" else {**told, "state": self.condition, "error": self.detail}

    def ask(self, now_s: float) -> None:
        """Ask the run once and update its state."""
        try:
            answer = self._answer()
        except InputError as error:  # another process uses its port now
            self.condition, self.detail = "gone", self._gone(self._without_place(error))
        except EquipmentError as error:
            silent = isinstance(error.__cause__, TimeoutError)
            self.condition = "silent" if silent else "gone"
            self.detail = self._without_place(error) if silent else self._gone()
        else:
            if self.traced:
                self.mirror.take(answer.pop("trace"))
            self.picture = {key: value for key, value in answer.items() if key not in {"ok", "pid"}}
            self.condition, self.detail, self.killed = "live", "", False
            age_s = self.picture.get("age_s", 0.0)
            if self.picture["state"] in TICKING and age_s > ANSWER_S:
                self.condition = "silent"
                self.detail = f"its loop has not ticked for {age_s:.0f} s: nothing here is newer; look at the chamber"
        self.next_s = now_s + (PERIOD_S if self.condition == "live" else SILENT_S)

    def _gone(self, why: str = "") -> str:
        again = "its calibration can go on" if self.about["job"] else f"`bench resume {self.runs[0]}` goes on with it"
        text = f"its process {self.live.file.pid} is gone; {again}"
        return f"{text} ({why})" if why else text

    def _without_place(self, error: BenchError) -> str:
        return within(self.live.folders[0].parents[1], str(error))

    def _answer(self) -> dict[str, Any]:
        """Picture and trace; only the picture from an older bench, which refuses to give a trace."""
        if self.traced:
            since, generation = self.mirror.wanted
            with contextlib.suppress(InputError):
                return ask_run(self.live, "trace", PATIENCE_S, since=since, generation=generation)
        answer = ask_run(self.live, "status", PATIENCE_S)  # another process on its port refuses this too
        self.traced = False
        return answer


class Watcher:
    """The thread and its knowledge; any thread may read it."""

    def __init__(self, out: Path, starts: Starts, listener: Listener) -> None:
        """The thread calls `listener` with all live runs and with new ends."""
        self._finder, self._starts, self._listener = Finder(out), starts, listener
        self._watched: dict[str, Watched] = {}
        self._analysed: list[tuple[float, Watched, dict[str, Any]]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watcher", daemon=True)
        self._looked_s = -IDLE_S
        self._eager = 0
        self.wanted: Callable[[], bool] = lambda: True
        """Whether a browser looks."""

    def start(self) -> None:
        """Find the live runs and ask each, so that no answer denies one that was live before the server; then watch."""
        self.turn(time.monotonic())
        self._thread.start()

    def close(self) -> None:
        """Stop watching."""
        self._stop.set()
        self._thread.join()

    @property
    def runs(self) -> list[Watched]:
        """The live runs, oldest first."""
        return list(self._watched.values())

    def in_use(self) -> dict[str, str]:
        """The equipment of the live runs, with texts."""
        used: dict[str, str] = {}
        for watched in self.runs:
            if watched.condition != "gone":
                used |= in_use(watched.live)
        return used

    def of_job(self, job: str) -> Watched | None:
        """The live run of a calibration."""
        return next((watched for watched in self.runs if watched.about["job"] == job), None)

    def find(self, run: str) -> Watched | None:
        """The live run with this id."""
        return next((watched for watched in self.runs if run in watched.runs), None)

    def _run(self) -> None:
        while not self._stop.wait(IDLE_S if self._idle() else PERIOD_S):
            try:
                self.turn(time.monotonic())
            except Exception:  # a problem with the files of one run must not stop the others
                _log.exception("looking at the live runs")

    def _idle(self) -> bool:
        return not (self._eager or self.wanted() or any(watched.mirror.behind for watched in self.runs))

    @contextlib.contextmanager
    def eagerly(self) -> Iterator[None]:
        """Ask at the shortest interval meanwhile; only for the server's own loop."""
        self._eager += 1
        try:
            yield
        finally:
            self._eager -= 1

    def turn(self, now_s: float) -> None:
        """Search, ask and report once; `now_s` is monotonic."""
        ends: list[dict[str, Any]] = []
        if now_s - self._looked_s >= IDLE_S:
            self._looked_s = now_s
            try:
                self._look()
            except Exception:  # known runs are asked all the same
                _log.exception("looking for live runs")
            self._starts.reap()
            self._starts.take_up(self.in_use())
            ends += self._verdicts(now_s)
        for token, watched in list(self._watched.items()):
            if now_s >= watched.next_s:
                self._ask(watched, now_s)
            if watched.condition != "live" and (end := self._told_end(watched)) is not None:
                self._analysed = [*self._analysed, (now_s + VERDICT_S, watched, end)]
                self._watched = {key: one for key, one in self._watched.items() if key != token}
                ends.append(end)
        self._listener(self.runs, ends)

    def _look(self) -> None:
        known = self._watched
        found: dict[str, Watched] = {}
        for run in self._finder.look():
            watched = known.get(run.file.token)
            # On its way to go on, a run of several units has no file in some of their folders.
            if watched is None or (watched.live.folders != run.folders and not self._starts.resuming(watched.runs)):
                try:
                    watched = Watched(run, self._starts.saw(run.file.pid, ids(run.folders)))
                except Exception:  # a problem with the files of this run must not hide the others
                    _log.exception("the files of %s", run.path)
                    continue
            found[run.file.token] = watched
        # A run without its file stays until it was asked and its end was read, or it goes on in another process.
        on = {one for watched in found.values() for one in watched.runs}
        gone = {token: one for token, one in known.items() if token not in found and not on & {*one.runs}}
        self._watched = {**gone, **found}

    def _ask(self, watched: Watched, now_s: float) -> None:
        """Ask a run; an answer that cannot be understood counts as none."""
        try:
            watched.ask(now_s)
        except Exception as error:
            _log.exception("the answer of %s", watched.runs[0])
            watched.condition, watched.next_s = "silent", now_s + SILENT_S
            watched.detail = f"its answer cannot be understood ({type(error).__name__}: {error}); look at the chamber"

    def _told_end(self, watched: Watched) -> dict[str, Any] | None:
        """End of a run; one that cannot be understood is reported as failed."""
        try:
            return self._end(watched)
        except Exception:
            _log.exception("the end of %s", watched.runs[0])
            unknown = {"state": "failed", "cause": "how it ended cannot be read: look at the chamber"}
            return {**_head(watched), **story.told([]), **unknown, **story.NO_VERDICT}

    def _end(self, watched: Watched) -> dict[str, Any] | None:
        """End of a run that does not answer; None where it has not ended, or was killed and can be resumed."""
        file = watched.live.path / LIVE
        if watched.condition == "silent" or (watched.killed and file.exists()):
            return None
        if (end := story.ending(watched.live)) is None:
            watched.killed = file.exists()
            if watched.killed or self._starts.resuming(watched.runs):
                return None
            end = story.told([])
        return {**_head(watched), **end, **story.verdicts(watched.live.folders)} | {"analysing": True}

    def _verdicts(self, now_s: float) -> list[dict[str, Any]]:
        """The ends whose verdict is new."""
        waiting: list[tuple[float, Watched, dict[str, Any]]] = []
        news: list[dict[str, Any]] = []
        for until_s, watched, end in self._analysed:
            busy = now_s <= until_s and process_alive(
                watched.live.file.pid
            )  # before the files, so that its last report is not missed
            start = None if busy else self._starts.of_run(end["run"])
            verdicts = story.verdicts(watched.live.folders, busy, start)
            if self.find(end["run"]):  # a killed run goes on
                continue
            told = {**end, **verdicts}
            if verdicts["analysing"]:
                waiting.append((until_s, watched, told))
            if not verdicts["analysing"] or _analysed(told) != _analysed(end):
                news.append(told)
        self._analysed = waiting
        return news

    def ended(self, run: str) -> dict[str, Any] | None:
        """The end of a run whose tables do not exist yet."""
        return next((end for _, watched, end in self._analysed if run in watched.runs), None)


def _analysed(end: Mapping[str, Any]) -> list[bool]:
    """Which units have their report: each is told as soon as it has."""
    return [unit["analysed"] for unit in end["units"]]


def _head(watched: Watched) -> dict[str, Any]:
    return {key: watched.about[key] for key in ("run", "runs", "unit", "profile", "station", "start", "who", "job")}
