"""Bounds what a connection may hold before and after its sender is recognised.

uvicorn counts idle connections as work and has no time-outs for headers, bodies and answers that nobody reads. Here
each connection has a place. When places run short, the oldest connection of whoever holds the most is closed, never a
new one refused: who holds connections open loses them, and who has something to say is heard.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Container
from typing import Any, Literal, Protocol

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
EACH_PERSON = 256
"""Connections of one person: a few dozen pages."""
MOST = 2048
"""All connections."""
FRESH_LOOKS = 2
"""A connection keeps its place until it was looked at so often: what it sent at once has then been read, however busy
the server is."""


Holder = tuple[Literal["address", "person"], str]


class Closable(Protocol):
    """A connection."""

    @property
    def fresh(self) -> bool:
        """Whether what it sent may not have been read yet."""

    def drop(self) -> None:
        """Close it at once."""


class Places:
    """The connections of a server by who holds them: a person, or a stranger's address; oldest first."""

    def __init__(self, most: int = MOST, unbounded: Container[str] = ()) -> None:
        """At most `most` connections; addresses in `unbounded` have no limit of their own."""
        self._most, self._unbounded = most, unbounded
        self._held: dict[Holder, dict[Closable, None]] = {}
        self._holders: dict[Closable, Holder] = {}

    def come(self, one: Closable, address: str) -> None:
        """A new connection of a stranger; closes the oldest where there are too many."""
        self._take(one, ("address", address), EACH)
        if len(self._holders) > self._most:
            self._drop(max(self._held, key=lambda holder: len(self._held[holder])))

    def recognise(self, one: Closable, name: str) -> None:
        """Its sender is this person."""
        holder: Holder = ("person", name)
        if self._holders.get(one, holder) != holder:
            self.go(one)
            self._take(one, holder, EACH_PERSON)

    def go(self, one: Closable) -> None:
        """It is closed, or about to be."""
        holder = self._holders.pop(one, None)
        if holder is not None:
            del self._held[holder][one]
            if not self._held[holder]:
                del self._held[holder]

    def _take(self, one: Closable, holder: Holder, most: int) -> None:
        mine = self._held.setdefault(holder, {})
        mine[one], self._holders[one] = None, holder
        if holder[1] not in self._unbounded:
            while len(mine) > most and not next(iter(mine)).fresh:
                self._drop(holder)

    def _drop(self, holder: Holder) -> None:
        oldest = next(iter(self._held[holder]))
        self.go(oldest)
        oldest.drop()


class Guarded(H11Protocol):
    """An HTTP connection with a place and with time-outs; `Server.on_tick` looks at it once a second."""

    def __init__(
        self, config: Config, server_state: ServerState, app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None, *, places: Places,
    ) -> None:  # fmt: skip
        super().__init__(config, server_state, app_state, _loop)
        self._places, self._looks = places, 0
        self._phase: object = None
        self._waited_s = self._stuck_s = 0.0
        self._received = self._unread = 0
        self.app: Any = _introduced(self.app, self._recognise)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place."""
        super().connection_made(transport)
        self._places.come(self, network(self.client[0]) if self.client else "")

    def connection_lost(self, exc: Exception | None) -> None:
        """Leave the place."""
        self._places.go(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Count what comes in."""
        self._received += len(data)
        super().data_received(data)

    @property
    def fresh(self) -> bool:
        """Whether what it sent may not have been read yet."""
        return self._looks < FRESH_LOOKS

    def drop(self) -> None:
        """Close the connection without a word."""
        self.transport.abort()

    def look(self, passed_s: float) -> None:
        """Close the connection where headers, body or the reading of the answer take too long; [s] since the last."""
        self._looks += 1
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

    def _recognise(self, name: str) -> None:
        self._places.recognise(self, name)


def _introduced(app: ASGIApp, recognise: Callable[[str], None]) -> ASGIApp:
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
