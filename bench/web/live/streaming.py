"""Server-sent events for many browsers: each event is encoded once, each browser has a short queue.

A slow browser loses updates of the picture, which later ones replace, and catches up with the traces through `since`;
ends of runs have a separate queue. All queues are bounded.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

KEPT, KEPT_ENDS = 4, 64
"""Length of the queues of pictures and ends; ends are also kept for a browser that reconnects."""
MOST = 64
"""Greatest number of browsers."""
BEAT_S = 4.0
"""Longest interval between events, so that a page notices a lost connection [s]."""
RETRY_MS = 1000

Numbered = tuple[int, bytes]


class _Browser:
    """A browser with the events that it has not received yet."""

    def __init__(self) -> None:
        self.live: deque[Numbered] = deque(maxlen=KEPT)
        self.ends: deque[Numbered] = deque(maxlen=KEPT_ENDS)
        self.news = asyncio.Event()

    def take(self) -> list[Numbered]:
        """All waiting events, in order."""
        taken = sorted((*self.live, *self.ends))
        self.live.clear()
        self.ends.clear()
        self.news.clear()
        return taken


class Stream:
    """One sequence of events; lives in the server's loop."""

    def __init__(self) -> None:
        self._sequence = 0
        self._browsers: set[_Browser] = set()
        self._ends: deque[Numbered] = deque(maxlen=KEPT_ENDS)
        self._last: Numbered | None = None
        self._closed = False

    @property
    def listeners(self) -> int:
        """Number of browsers."""
        return len(self._browsers)

    @property
    def full(self) -> bool:
        """Whether no further browser is accepted."""
        return len(self._browsers) >= MOST

    def live(self, content: Mapping[str, Any]) -> None:
        """A new picture of all live runs."""
        self._last = self._written("live", content)
        for browser in self._browsers:
            browser.live.append(self._last)
            browser.news.set()

    def ended(self, content: Mapping[str, Any]) -> None:
        """A run has ended, or its verdict has come."""
        end = self._written("ended", content)
        self._ends.append(end)
        for browser in self._browsers:
            browser.ends.append(end)
            browser.news.set()

    def close(self) -> None:
        """End it for all browsers, also for those that come later."""
        self._closed = True
        for browser in self._browsers:
            browser.news.set()

    def _written(self, event: str, content: Mapping[str, Any]) -> Numbered:
        self._sequence += 1
        data = json.dumps(content, allow_nan=False, separators=(",", ":"))
        return self._sequence, f"id: {self._sequence}\nevent: {event}\ndata: {data}\n\n".encode()

    async def listen(
        self, since: int | None = None, most: int = 0, welcome: Callable[[], bool] = lambda: True
    ) -> AsyncIterator[bytes]:
        """Events from now on, and the ends after `since`, the number of the last event that the browser received.

        Stops after `most` events (0: never), when `welcome`, asked before every event, returns False, and at `close`.
        """
        browser, sent = _Browser(), 0
        if self._last is not None:
            browser.live.append(self._last)
        if since is not None and since <= self._sequence:
            browser.ends.extend(end for end in self._ends if end[0] > since)
        if browser.live or browser.ends:
            browser.news.set()
        self._browsers.add(browser)
        try:
            yield f"retry: {RETRY_MS}\n\n".encode()
            while not self._closed:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(browser.news.wait(), BEAT_S)
                if self._closed or not welcome():
                    return
                events = browser.take()
                for _, event in events:
                    yield event
                    sent += 1
                    if sent == most:
                        return
                if not events:
                    yield b"event: beat\ndata: {}\n\n"
        finally:
            self._browsers.discard(browser)
