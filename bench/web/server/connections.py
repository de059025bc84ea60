"""Bounds what a connection may hold before and after its sender is recognised.

uvicorn counts idle connections as work and has no time-outs for headers, bodies and answers that nobody reads. Here
each connection has a place. When places run short, the oldest connection of a stranger is closed, never a new one
refused: who holds connections open loses them, and who has something to say is heard.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Container
from typing import Any, Protocol

from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from bench.web.ground.callers import RECOGNISED, network

HEADER_S = 10.0
"""A request must have sent its headers within this time, and TLS its handshake [s]."""
BODY_S = 20.0
"""Time for a body [s], and one more second for every `BODY_BYTES` that have come in."""
BODY_BYTES = 1000
STUCK_S = 30.0
"""An answer of which nothing is read for so long is given up [s]."""
EACH = 64
"""Connections of strangers from one address."""
MOST = 2048
"""All connections."""
FRESH_S = 1.0
"""A connection this young keeps its place, so that what it sent can be read first [s]."""


class Closable(Protocol):
    """A connection."""

    def drop(self) -> None:
        """Close it at once."""


class Places:
    """The connections of a server; those of strangers by address, oldest first."""

    def __init__(
        self, most: int = MOST, unbounded: Container[str] = (), now: Callable[[], float] = time.monotonic
    ) -> None:
        """At most `most` connections; addresses in `unbounded` have no limit of their own."""
        self._most, self._unbounded, self._now = most, unbounded, now
        self._strangers: dict[str, dict[Closable, float]] = {}
        self._all: set[Closable] = set()

    def come(self, one: Closable, group: str) -> None:
        """A new connection; closes the oldest strangers where there are too many."""
        now = self._now()
        mine = self._strangers.setdefault(group, {})
        mine[one] = now
        self._all.add(one)
        if group not in self._unbounded:
            while len(mine) > EACH and now - next(iter(mine.values())) > FRESH_S:
                self._drop(group)
        if len(self._all) > self._most:
            self._drop(max(self._strangers, key=lambda name: len(self._strangers[name])))

    def recognise(self, one: Closable, group: str) -> None:
        """Its sender is no stranger."""
        self._strangers.get(group, {}).pop(one, None)
        self._tidy(group)

    def go(self, one: Closable, group: str) -> None:
        """It is closed."""
        self._all.discard(one)
        self.recognise(one, group)

    def _drop(self, group: str) -> None:
        oldest = next(iter(self._strangers[group]))
        self.go(oldest, group)
        oldest.drop()

    def _tidy(self, group: str) -> None:
        if not self._strangers.get(group, True):
            del self._strangers[group]


class Guarded(H11Protocol):
    """An HTTP connection with a place and with time-outs; `Server.on_tick` looks at it once a second."""

    def __init__(
        self, config: Config, server_state: ServerState, app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None, *, places: Places,
    ) -> None:  # fmt: skip
        super().__init__(config, server_state, app_state, _loop)
        self._places, self._group = places, ""
        self._phase: object = None
        self._waited_s = self._stuck_s = 0.0
        self._received = self._unread = 0
        self.app: Any = _introduced(self.app, self._recognise)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place."""
        super().connection_made(transport)
        self._group = network(self.client[0]) if self.client else ""
        self._places.come(self, self._group)

    def connection_lost(self, exc: Exception | None) -> None:
        """Leave the place."""
        self._places.go(self, self._group)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Count what comes in."""
        self._received += len(data)
        super().data_received(data)

    def drop(self) -> None:
        """Close the connection without a word."""
        self.transport.abort()

    def look(self, passed_s: float) -> None:
        """Close the connection where headers, body or the reading of the answer take too long; [s] since the last."""
        unread = self.transport.get_write_buffer_size()
        self._stuck_s = self._stuck_s + passed_s if unread and unread == self._unread else 0.0
        self._unread = unread
        cycle = self.cycle
        answered = cycle is None or cycle.response_complete
        phase = (cycle, answered)
        if phase != self._phase:
            self._phase, self._waited_s, self._received = phase, 0.0, 0
        if answered or (cycle.more_body and not self.flow.read_paused):  # paused: it is the server that takes its time
            self._waited_s += passed_s
        most_s = HEADER_S if answered else BODY_S + self._received / BODY_BYTES
        if self._waited_s > most_s or self._stuck_s > STUCK_S:
            self.drop()

    def _recognise(self) -> None:
        self._places.recognise(self, self._group)


def _introduced(app: ASGIApp, recognise: Callable[[], None]) -> ASGIApp:
    """The application, which learns whom to tell that it has recognised a person."""

    async def introduced(scope: Scope, receive: Receive, send: Send) -> None:
        scope.setdefault("extensions", {})[RECOGNISED] = recognise
        await app(scope, receive, send)

    return introduced


def room() -> int:
    """Connections that the open files of this process allow, after raising their limit as far as it may be raised."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return MOST
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 2 * MOST
    if soft != resource.RLIM_INFINITY and soft < wanted:
        soft = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return MOST if soft == resource.RLIM_INFINITY else max(min(MOST, soft // 2), EACH)
