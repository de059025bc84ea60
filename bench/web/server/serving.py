"""`bench ui`: bind the address, print it, serve until a signal."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import os
import signal
import socket
import ssl
import sys
import threading
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import uvicorn
from fastapi import FastAPI

from bench.base import InputError
from bench.web.ground.callers import network
from bench.web.ground.settings import Settings
from bench.web.server.app import create_app, failure
from bench.web.server.connections import HEADER_S, Guarded, Places, room
from bench.web.server.gate import is_loopback
from bench.web.server.pages import require_page

GOODBYE_S = 2
"""Time that answers have to end after a signal [s]."""
_LOOK_TICKS = 10
"""uvicorn ticks ten times a second; connections are looked at once."""
_NEEDS_TOKENS = (
    "others can reach {how}, so tokens are needed: make one with "
    "`bench ui --access access.yaml --new-token NAME --role engineer`, then add --access access.yaml"
)


@dataclass(frozen=True)
class Tls:
    """Certificate chain and its key, PEM."""

    certificate: Path
    key: Path

    def check(self) -> None:
        """InputError where they cannot be read or do not belong together."""
        for path in (self.certificate, self.key):
            if not path.is_file():
                raise InputError("no such file; --certificate and --key are PEM files", path)
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(self.certificate, self.key, password=_no_password)
        except (OSError, ValueError) as error:
            text = f"not a certificate chain and its key (PEM, without a password): {error}"
            raise InputError(text, self.certificate) from error


def _no_password() -> str:
    """Prevents a question on the terminal."""
    raise ValueError("the key has a password")


class GuardedServer(uvicorn.Server):
    """Looks at its connections once a second (`connections.Guarded.look`)."""

    async def on_tick(self, counter: int) -> bool:
        """Look at the connections; whether the server ends."""
        if counter % _LOOK_TICKS == 0:
            for connection in list(self.server_state.connections):
                if isinstance(connection, Guarded):
                    connection.look(1.0)
        return await super().on_tick(counter)


def configured(app: FastAPI, tls: Tls | None = None, behind: str | None = None, **options: Any) -> uvicorn.Config:
    """How a server of the page is served; `behind`: address of a reverse proxy; `options` are further ones of uvicorn.

    Connections of the proxy are bounded by the proxy.
    """
    if tls:
        options |= {"loop": f"{__name__}:_tls_loop", "ssl_certfile": tls.certificate, "ssl_keyfile": tls.key}
    return uvicorn.Config(
        app,
        http=cast(
            "type[asyncio.Protocol]", partial(Guarded, places=Places(room(), (network(behind),) if behind else ()))
        ),
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=behind is not None,
        forwarded_allow_ips=behind,
        ws="none",
        lifespan="on",
        timeout_graceful_shutdown=GOODBYE_S,
        **options,
    )


def _tls_loop() -> asyncio.AbstractEventLoop:
    """An event loop in which a handshake may not take a minute, as is asyncio's own limit."""
    loop = asyncio.new_event_loop()
    setattr(loop, "create_server", partial(loop.create_server, ssl_handshake_timeout=HEADER_S))  # noqa: B010
    return loop


class _Server(GuardedServer):
    """Prints its address once it serves; ends where the API cannot begin."""

    def __init__(self, app: FastAPI, config: uvicorn.Config, url: str, browser: bool) -> None:
        super().__init__(config)
        self._app, self._url, self._browser = app, url, browser

    async def on_tick(self, counter: int) -> bool:
        """Whether the server ends."""
        return await super().on_tick(counter) or failure(self._app) is not None

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the stream of events, which would not end by itself; then as any server."""
        if stream := getattr(self._app.state, "stream", None):
            stream.close()
        await super().shutdown(sockets)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Print the address; open it in the browser."""
        await super().startup(sockets)
        if self.started:
            print(f"bench ui: {self._url}  (Ctrl-C ends it; runs go on)", file=sys.stderr, flush=True)
            if self._browser and _has_screen():
                threading.Thread(target=webbrowser.open, args=(self._url,), daemon=True).start()


def serve(settings: Settings, port: int, tls: Tls | None = None, browser: bool = True) -> None:
    """Serve until SIGINT or SIGTERM; InputError where the page is not built, the address is in use or needs tokens."""
    require_page()
    if settings.access is None and not (is_loopback(settings.host) and settings.behind is None):
        how = f"--host {settings.host}" if settings.behind is None else f"the proxy --behind {settings.behind}"
        raise InputError(_NEEDS_TOKENS.format(how=how))
    if tls:
        tls.check()
    try:
        settings.own.touch()
    except OSError as error:
        raise InputError(f"--out cannot hold run folders: {error.strerror}", settings.out) from error
    app = create_app(replace(settings, secure=tls is not None or settings.behind is not None))
    with _bound(settings.host, port) as listener:
        if tls is None and settings.behind is None and not is_loopback(settings.host):
            print("bench ui: without --certificate and --key, tokens cross the network unencrypted", file=sys.stderr)
        options = configured(app, tls, settings.behind)
        url = f"{'https' if tls else 'http'}://{_name(settings.host)}:{listener.getsockname()[1]}/"
        # uvicorn raises the signal again after its end; the process must go on to its normal end.
        signal.signal(signal.SIGTERM, lambda *_: None)
        with contextlib.suppress(KeyboardInterrupt):
            _Server(app, options, url, browser).run(sockets=[listener])
        if failed := failure(app):
            raise failed


def _name(host: str) -> str:
    """Host name for a browser, given an address to bind to."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.is_unspecified:
        return socket.gethostname()
    return f"[{host}]" if address.version == 6 else host


def _has_screen() -> bool:
    """Whether a browser would open a window instead of running in the terminal."""
    return sys.platform in {"win32", "darwin"} or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


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
            hint = "; `--port 0` takes a free one" if error.errno == errno.EADDRINUSE else ""
            raise InputError(f"--host {host} --port {port}: {error.strerror}{hint}") from error
        yield listener
