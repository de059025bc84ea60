"""Checks every request before its route sees it, and sets the headers of every answer.

The Host must be a name of this server, against DNS rebinding. A request that changes something must come from a page of
this server, with a content type that no form of another site can send. A stranger is refused before the body of the
request is read; bodies are counted while they come in. It is written for ASGI directly, so that a stream of events
passes through unchanged.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from typing import NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from bench.base import InputError
from bench.web.ground.policy import HEADERS, policy_of
from bench.web.ground.problems import problem
from bench.web.ground.settings import Settings
from bench.web.people.access import Access

_HARMLESS = {"GET", "HEAD", "OPTIONS"}
API = "/api/v1"
IMPORTS = f"{API}/imports"
OPEN = frozenset({f"{API}/session", f"{API}/openapi.json"})
"""What anybody may ask: who am I, and what can be asked."""


class Refusal(NamedTuple):
    """Status and reason of a refused request."""

    status: int
    detail: str
    headers: dict[str, str] | None = None


class Gate:
    """ASGI middleware around the whole application."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app, self._settings = app, settings
        self._names = {"localhost", *(name.lower() for name in settings.names)}
        if not is_loopback(settings.host):
            self._names |= {settings.host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers, path = Headers(scope=scope), scope["path"]

        async def dressed(message: Message) -> None:
            if message["type"] == "http.response.start":
                answer = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    answer.setdefault(name, value)
                answer.setdefault("Content-Security-Policy", policy_of(answer.get("content-type")))
                answer.setdefault("Cache-Control", "no-store" if path.startswith("/api/") else "no-cache")
            await send(message)

        refusal = self._refusal(scope["method"], path, headers) or _stranger(scope) or await _failed(scope)
        if refusal:
            await problem(*refusal)(scope, receive, dressed)
            return
        await self._app(scope, _bounded(receive, self._limit(path)), dressed)

    def _refusal(self, method: str, path: str, headers: Headers) -> Refusal | None:
        host = headers.get("host", "")
        if not self._ours(host):
            return Refusal(403, f"Host is {host[:100]!r}, not a name of this server; `bench ui --name` adds one")
        site = headers.get("sec-fetch-site", "same-origin")
        if method in _HARMLESS:
            foreign = site == "cross-site" and path.startswith("/api/") and headers.get("sec-fetch-mode") != "navigate"
            return Refusal(403, "a page of another site sent this request") if foreign else None
        origin = headers.get("origin")
        if origin is not None and origin.lower() not in {f"http://{host.lower()}", f"https://{host.lower()}"}:
            return Refusal(403, f"Origin is {origin[:100]!r}, not a page of this server")
        if site not in {"same-origin", "none"}:
            return Refusal(403, "a page of another site sent this request")
        length = headers.get("content-length", "0")
        if length.isdecimal() and int(length) > self._limit(path):
            return _too_large(self._limit(path))
        return _wrong_type(method, path, headers)

    def _limit(self, path: str) -> int:
        return self._settings.upload_bytes if path == IMPORTS else self._settings.body_bytes

    def _ours(self, host: str) -> bool:
        name = host.rsplit(":", 1)[0] if host.rpartition(":")[2].isdecimal() else host
        if name.lower() in self._names:
            return True
        try:
            address = ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        # DNS can redirect names, not addresses.
        return address.is_loopback or not is_loopback(self._settings.host)


def is_loopback(host: str) -> bool:
    """Whether only this computer can reach an address to bind to."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _wrong_type(method: str, path: str, headers: Headers) -> Refusal | None:
    if method == "DELETE":  # forms cannot send DELETE
        return None
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    if path == IMPORTS and kind == "multipart/form-data":
        return None if headers.get("x-bench") == "1" else Refusal(403, "an import needs the header `X-Bench: 1`")
    allowed = "multipart/form-data" if path == IMPORTS else "application/json"
    return None if kind == "application/json" else Refusal(415, f"Content-Type is {kind[:60]!r}, must be {allowed}")


def _stranger(scope: Scope) -> Refusal | None:
    """Why the sender of this request may not ask; None for a person with access, and where anybody may ask."""
    path: str = scope["path"]
    if not path.startswith(f"{API}/") or path in OPEN:
        return None
    access: Access = scope["app"].state.access
    try:
        access.who(Request(scope))
    except HTTPException as error:
        return Refusal(error.status_code, error.detail, dict(error.headers or {}))
    except InputError as error:
        return Refusal(400, str(error))
    return None


async def _failed(scope: Scope) -> Refusal | None:
    """Wait for the API, which is imported while the page is served already; why it cannot be asked."""
    if not scope["path"].startswith("/api/"):
        return None
    api: asyncio.Task[None] = scope["app"].state.api
    await asyncio.wait([api])
    return Refusal(503, "the server cannot begin; its terminal says why") if api.exception() else None


def _too_large(limit: int) -> Refusal:
    return Refusal(413, f"the request is larger than the {limit} bytes that are allowed here")


def _bounded(receive: Receive, limit: int) -> Receive:
    """Count the bytes that come in; HTTPException 413 above the limit, whatever Content-Length says."""
    seen = 0

    async def counted() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > limit:
            raise HTTPException(*_too_large(limit)[:2])
        return message

    return counted
