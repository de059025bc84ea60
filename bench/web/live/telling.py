"""Passes changes from the watcher's thread to the stream of the browsers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from typing import Any

from bench.web.live.streaming import Stream
from bench.web.live.watching import Watched

STEADY_TURNS = 5
"""An unchanged picture is sent once in so many turns, so that the page sees a run that hangs."""


class Teller:
    """The watcher's listener."""

    def __init__(self, stream: Stream, loop: asyncio.AbstractEventLoop) -> None:
        self._stream, self._loop = stream, loop
        self._places: dict[str, tuple[int, int]] = {}
        self._told: Any = None
        self._quiet = 0

    def __call__(self, runs: list[Watched], ends: list[dict[str, Any]]) -> None:
        """Called by the watcher's thread, once a turn."""
        pictures = [watched.told() for watched in runs]
        traces = {watched.runs[0]: self._increment(watched) for watched in runs}
        moved = any(trace["points"] for trace in traces.values())
        compared = [{key: value for key, value in picture.items() if key != "age_s"} for picture in pictures]
        self._quiet += 1
        with contextlib.suppress(RuntimeError):  # the server ends
            if moved or compared != self._told or (runs and self._quiet >= STEADY_TURNS):
                self._told, self._quiet = compared, 0
                self._loop.call_soon_threadsafe(self._stream.live, {"runs": pictures, "traces": traces})
            for end in ends:
                self._loop.call_soon_threadsafe(self._stream.ended, end)
        self._forget(runs)

    def _increment(self, watched: Watched) -> dict[str, Any]:
        run = watched.runs[0]
        index, generation = self._places.get(run, (0, -2))
        news = watched.mirror.news(index, generation)
        self._places[run] = news["next"], news["generation"]
        return news

    def _forget(self, runs: Sequence[Watched]) -> None:
        here = {watched.runs[0] for watched in runs}
        self._places = {run: place for run, place in self._places.items() if run in here}
