"""`bench ui`: bind, say where, serve until told to stop."""

from __future__ import annotations

import contextlib
import socket
import sys
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import uvicorn

from bench.errors import InputError
from bench.web.app import create_app
from bench.web.gate import is_loopback
from bench.web.settings import Settings

GOODBYE_S = 2
"""Streams of events have this long after a signal to stop."""
_CONNECTIONS = 256


@dataclass(frozen=True)
class Tls:
    """Certificate chain and its key, PEM."""

    certificate: Path
    key: Path


class _Server(uvicorn.Server):
    """Says where it is, once it is there."""

    def __init__(self, config: uvicorn.Config, url: str, browser: bool) -> None:
        super().__init__(config)
        self._url, self._browser = url, browser

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Announce the address; open the browser at it."""
        await super().startup(sockets)
        if self.started:
            print(f"bench ui: {self._url}  (Ctrl-C ends it; runs go on)", file=sys.stderr, flush=True)
            if self._browser:
                webbrowser.open(self._url)


def serve(settings: Settings, port: int, tls: Tls | None = None, browser: bool = True) -> None:
    """Serve until SIGINT or SIGTERM; InputError when the address is not free, or needs tokens that there are not."""
    if settings.access is None and not is_loopback(settings.host):
        raise InputError(
            f"--host {settings.host} can be reached by others: they need tokens; "
            "`bench ui --access access.yaml --new-token NAME --role engineer` makes one, then add --access access.yaml"
        )
    settings = replace(settings, secure=tls is not None)
    app = create_app(settings)
    with _bound(settings.host, port) as listener:
        options = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            ws="none",
            lifespan="on",
            limit_concurrency=_CONNECTIONS,
            timeout_graceful_shutdown=GOODBYE_S,
            ssl_certfile=tls.certificate if tls else None,
            ssl_keyfile=tls.key if tls else None,
        )
        scheme = "https" if tls else "http"
        name = f"[{settings.host}]" if ":" in settings.host else settings.host
        server = _Server(options, f"{scheme}://{name}:{listener.getsockname()[1]}/", browser)
        with contextlib.suppress(KeyboardInterrupt):  # uvicorn hands the signal on after it has ended
            server.run(sockets=[listener])


@contextlib.contextmanager
def _bound(host: str, port: int) -> Iterator[socket.socket]:
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind)
    except OSError as error:
        raise InputError(f"--host {host}: {error.strerror or error}") from error
    with listener:
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
        except OSError as error:
            raise InputError(f"--host {host} --port {port}: {error.strerror}; `--port 0` takes a free one") from error
        yield listener
