"""Asks a bench's server: `bench status`, `hold`, `pause`, `resume` and `abort` with `--server`, and `bench queue`.

Of the standard library alone: what asks needs no server's packages. Redirects are not followed and proxies not used,
so that the token goes nowhere else.
"""

from __future__ import annotations

import json
import os
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

from bench.base import BenchError, EquipmentError, InputError
from bench.commands.live import ENDING_S
from bench.commands.results.live import Aborted, Asked, LiveRuns, Queue

PATIENCE_S = 30.0
_ANSWER_BYTES = 8 << 20


@dataclass(frozen=True)
class Server:
    """A server as `bench ui` prints it, and the token to show there."""

    url: str
    token: str | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        if parts.scheme not in {"http", "https"} or not parts.hostname or parts.username or parts.query:
            raise InputError(f"--server is {self.url!r}, must be like http://127.0.0.1:8321 (the token: BENCH_TOKEN)")

    def get(self, path: str) -> dict[str, Any]:
        """Ask for something."""
        return self._ask(urllib.request.Request(self._address(path)), PATIENCE_S)

    def post(
        self, path: str, patience_s: float = PATIENCE_S, content: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Have something done."""
        headers, body = {"Content-Type": "application/json"}, json.dumps(content or {}).encode()
        return self._ask(urllib.request.Request(self._address(path), body, headers, method="POST"), patience_s)

    def delete(self, path: str) -> None:
        """Have something removed."""
        self._ask(urllib.request.Request(self._address(path), method="DELETE"), PATIENCE_S)

    def _address(self, path: str) -> str:
        return f"{self.url.rstrip('/')}/api/v1{path}"

    def _ask(self, request: urllib.request.Request, patience_s: float) -> dict[str, Any]:
        if self.token:
            request.add_unredirected_header("Authorization", f"Bearer {self.token}")
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), _NoRedirect)
        try:
            with opener.open(request, timeout=patience_s) as answer:
                content = json.loads(answer.read(_ANSWER_BYTES) or b"{}")
        except urllib.error.HTTPError as error:
            with error:
                raise self._refused(error) from error
        except (OSError, ValueError, HTTPException) as error:
            reason = " ".join(str(getattr(error, "reason", error)).split())
            raise EquipmentError(f"{self.url}: no answer of a bench: {reason}; is `bench ui` running there?") from error
        if not isinstance(content, dict):
            raise EquipmentError(f"{self.url}: not the answer of a bench")
        return content

    def _refused(self, error: urllib.error.HTTPError) -> BenchError:
        try:
            detail = str(json.loads(error.read(_ANSWER_BYTES))["detail"])
        except (OSError, ValueError, KeyError, TypeError, HTTPException):
            detail = f"{error.code} {error.reason}: not the answer of a bench"
        if error.code == 401:
            detail += "; put it into BENCH_TOKEN"
        kind = EquipmentError if error.code >= 500 else InputError
        return kind(f"{self.url}: {detail}")


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Not followed: an HTTPError then."""


def server_at(url: str) -> Server:
    """The server at a URL, with the token of the environment."""
    return Server(url, os.environ.get("BENCH_TOKEN"))


def server_status(server: Server, run: Path | None) -> LiveRuns:
    """`bench status --server`: one live run, or all of them."""
    return LiveRuns(f"at {server.url}", _live(server) if run is None else [server.get(f"/live/{_id(run)}")])


def _live(server: Server) -> list[dict[str, Any]]:
    runs = server.get("/live").get("runs")
    if not isinstance(runs, list):
        raise EquipmentError(f"{server.url}: not the answer of a bench")
    return runs


def server_act(server: Server, action: str, run: Path | None) -> Asked:
    """`bench hold`, `pause` and `resume` with `--server`."""
    which = _the_run(server, run)
    return Asked(action, which, server.post(f"/live/{which}/{action}"))


def server_abort(server: Server, run: Path | None) -> Aborted:
    """`bench abort --server`: end a live run, and say what the safe state reached."""
    which = _the_run(server, run)
    answer = server.post(f"/live/{which}/abort?wait_s={ENDING_S:g}", ENDING_S + PATIENCE_S)
    if "safe" not in answer:
        raise EquipmentError(f"{which}: told to abort, but how it ended is not known; LOOK AT THE CHAMBER")
    return Aborted({"run": which, **answer})


def server_queue(server: Server) -> Queue:
    """`bench queue`: what waits for its station, first what is next."""
    waiting = server.get("/calibrations").get("waiting")
    if not isinstance(waiting, list):
        raise EquipmentError(f"{server.url}: not the answer of a bench")
    return Queue(server.url, waiting)


def server_move(server: Server, which: str, place: int) -> Queue:
    """`bench queue move`: the queue with a start at another place of it."""
    waiting = server_queue(server).waiting
    at = _in_queue(server, waiting, which)
    server.post(f"/starts/{quote(waiting[at]['start'])}/move", content={"by": place - 1 - at})
    return server_queue(server)


def server_drop(server: Server, which: str) -> Queue:
    """`bench queue drop`: the queue without a start."""
    waiting = server_queue(server).waiting
    server.delete(f"/starts/{quote(waiting[_in_queue(server, waiting, which)]['start'])}")
    return server_queue(server)


def _in_queue(server: Server, waiting: Sequence[Mapping[str, Any]], which: str) -> int:
    """Where a start stands that is named by its id, or by a unit that nothing else there has."""
    found = [i for i, one in enumerate(waiting) if which == one["start"] or which in map(_serial, one["units"])]
    if len(found) == 1:
        return found[0]
    listed = ", ".join(one["start"] for one in waiting) or "nothing"
    text = f"{len(found)} starts of {which!r} wait; name one by its id" if found else f"nothing of {which!r} waits"
    raise InputError(f"{server.url}: {text}; in the queue: {listed}")


def _serial(unit: str) -> str:
    return unit.partition("@")[0]


def _the_run(server: Server, run: Path | None) -> str:
    if run is not None:
        return _id(run)
    runs = [live["run"] for live in _live(server) if live["state"] != "gone"]
    if len(runs) == 1:
        return quote(runs[0])
    listed = ", ".join(runs)
    raise InputError(f"{server.url}: {f'{len(runs)} live runs; name one of {listed}' if runs else 'no live run'}")


def _id(run: Path) -> str:
    """A run as the server names it: unit and run folder, the end of any path to it."""
    if len(run.parts) < 2:
        raise InputError(f"RUN is {str(run)!r}, must be UNIT/RUN with --server; `bench status` lists those that live")
    return quote("/".join(run.parts[-2:]))
