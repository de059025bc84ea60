"""Which events of a run are told to people who are not beside the bench: its end, a guard that ends it, a hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.station.notices import Mood, Notifier
from bench.acquisition.station.settings.notify import Kind
from bench.acquisition.station.settings.station import StationSettings
from bench.record import RunFolder


class Bell:
    """Hears the events of one run."""

    def __init__(self, station: StationSettings, serials: Sequence[str], profile: str) -> None:
        """InputError where the station's notification file is wrong."""
        self._notifier = Notifier(station.notify)
        self._subject, self._station = f"{', '.join(serials)} {profile}", station.name

    def hear(self, run: RunFolder, event: Mapping[str, Any]) -> None:
        """An event of the run, as it is recorded; sends what is worth it, and returns at once."""
        notice = _notice(event)
        if notice is not None:
            kind, what, mood = notice
            where = f"run {run.path.parent.name}/{run.path.name} on station {self._station}, {event['utc']}"
            self._notifier.tell(kind, f"{self._subject}: {what}", f"{event['text']}\n{where}", mood)

    def record(self, recorder: Recorder) -> None:
        """Record what could not be delivered so far."""
        for text in self._notifier.troubles():
            recorder.event("notify", text)

    def end(self, recorder: Recorder) -> None:
        """Wait a little for what is on its way, and record what was not delivered; a full disk was told of before."""
        self._notifier.close()
        with suppress(OSError):
            self.record(recorder)


def _notice(event: Mapping[str, Any]) -> tuple[Kind, str, Mood] | None:
    """What an event is told as: (kind, words, mood); None where it is not told."""
    kind = event["kind"]
    if kind == "hold" and event["phase"] == "start":
        return "hold", "holds", "warning"
    if kind == "guard" and event["tripped"] and event["action"] != "hold":
        return "trip", "tripped", "failure"
    if kind == "end":
        state = event["state"]
        said = {"done": "the run ended", "aborted": "the run was aborted", "failed": "the run failed"}[state]
        return "end", said, "success" if state == "done" else "failure"
    return None
