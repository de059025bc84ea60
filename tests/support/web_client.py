"""A server of the page in a thread of the test, on a free port, and a client that speaks HTTP with it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import uvicorn

from bench.web.ground.settings import Settings
from bench.web.server.app import create_app
from bench.web.server.serving import GuardedServer, Tls, configured


class _Server(GuardedServer):
    """Tells when it is there."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready = threading.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.ready.set()


class _Repeating(httpx.HTTPTransport):
    """Asks again where the answer is being counted."""

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        while True:
            answer = super().handle_request(request)
            if answer.status_code != 202 or "retry-after" not in answer.headers:
                return answer
            answer.close()


@contextmanager
def served(
    settings: Settings, tls: Tls | None = None, *, repeats: bool = True, **options: Any
) -> Iterator[httpx.Client]:
    """A client of a server with these settings; both end with the block. `options` are those of uvicorn.

    `repeats`: the client asks again, as the page does, where an answer is being counted.
    """
    server = _Server(configured(create_app(settings), tls, **options))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            assert server.ready.wait(30)
            url = f"http://127.0.0.1:{listener.getsockname()[1]}"
            transport = _Repeating() if repeats else httpx.HTTPTransport()
            with httpx.Client(base_url=url, timeout=60.0, trust_env=False, transport=transport) as client:
                yield client
        finally:
            server.should_exit = True
            thread.join()
