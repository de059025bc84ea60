"""Control of a live run: one desk for keyboard, command line and page; and its server on 127.0.0.1.

The desk keeps the newest picture of the run, made by the run's own loop at every tick, and passes requests on to the
sequencer, whose `request_*` may be called from any thread; the sequencer makes each an event with who asked and when.
The server is a thread that answers lines of JSON (see `remote`). The run never depends on it: without a port, with a
client that talks nonsense or none at all, the run goes on.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import math
import os
import secrets
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

from bench.acquisition.profile.guards import Guards, Light
from bench.acquisition.recording.trace import Trace
from bench.acquisition.run.remote import HOST, LiveFile, read_line
from bench.acquisition.run.sequencer import TICK_S
from bench.acquisition.run.status import Status
from bench.acquisition.station.station import LiveUnit, Station
from bench.record import LIVE
from drivers.canbus import CaptureHealth

Action = Literal["hold", "pause", "resume", "abort"]
ACTIONS: tuple[Action, ...] = get_args(Action)

Onlooker = Callable[[Station, Status], None]

PATIENCE_S = 2.0
"""A client has this long for its request."""
CLIENTS = 32
"""So many at once; the next one takes the place of the oldest that has not shown the token."""
_NAME_LENGTH = 120
_POLL_S = 0.1


class Requests(Protocol):
    """What a sequencer can be asked for, from any thread; it does so at its next tick."""

    def request_stop(self, cause: str) -> None:
        """End the run through the safe state."""

    def request_hold(self, cause: str) -> None:
        """Stop where the chamber is."""

    def request_pause(self, cause: str) -> None:
        """Hold after the present segment."""

    def request_resume(self, cause: str) -> None:
        """Go on."""


class Desk:
    """Where onlookers see a live run and operators ask it for something; safe to use from any thread."""

    def __init__(self) -> None:
        self._sequencer: Requests | None = None
        self._nominal_s = 0.0
        self._picture: dict[str, Any] = {"state": "starting"}
        self._seen_wall_s = time.monotonic()
        self._ending = ""
        self._guards: Guards | None = None
        self._lights: list[Light] = []
        self._expected_s: float | None = None
        self.notes: Callable[[], dict[str, Any]] = dict
        """What others have to say in the status: how well models fit so far. Called from any thread."""
        self._trace = Trace(tick_s=TICK_S, origin=int(time.time()))

    def attach(self, sequencer: Requests, nominal_s: float, guards: Guards | None = None) -> None:
        """Requests go to this sequencer from now on; its legs take `nominal_s` [s] and these guards watch over it."""
        self._sequencer, self._nominal_s, self._guards = sequencer, nominal_s, guards

    def look(self, station: Station, status: Status) -> None:
        """Take in one tick; called by the loop of the run, which alone may read the station."""
        seen = picture(station, status, self._nominal_s)
        end_s = status.t_s + time_left(status, self._nominal_s)[1]
        self._expected_s = end_s if self._expected_s is None else self._expected_s
        self._picture = {**seen, "late_s": round(end_s - self._expected_s, 1)}
        if self._guards is not None:
            self._lights = self._guards.lights()
        _add(self._trace, station, status)
        self._seen_wall_s = time.monotonic()

    def ends(self, cause: str) -> None:
        """No tick comes any more: the equipment is made safe now, for this reason."""
        self._ending = self._ending or cause

    def watched(self, onlooker: Onlooker) -> Onlooker:
        """An onlooker that lets this desk see each tick too."""

        def look(station: Station, status: Status) -> None:
            self.look(station, status)
            onlooker(station, status)

        return look

    def status(self) -> dict[str, Any]:
        """The newest picture; `age_s` is how old it is [s of wall time].

        `late_s` is by how much the run is later now than was expected when it began [s], `guards` are lights.
        """
        state = {"state": "ending", "ending": self._ending} if self._ending else {}
        guards = [{**vars(light), "value": _known(light.value)} for light in self._lights]
        age_s = round(time.monotonic() - self._seen_wall_s, 3)
        return {**self._picture, **state, **self.notes(), "guards": guards, "age_s": age_s}

    def trace(self, since: Any, generation: Any) -> dict[str, Any]:
        """A page of what the run has done so far (`trace`); what is asked for may be nonsense."""
        index, known = (value if type(value) is int else None for value in (since, generation))
        return self._trace.since(index or 0, known)

    def ask(self, action: Action, who: str) -> None:
        """Ask the run for something; RuntimeError before there is a sequencer to ask."""
        sequencer = self._sequencer
        if sequencer is None:
            raise RuntimeError("the run is only just starting; ask again in a moment")
        cause = _printable(who)
        if action == "abort":
            self._ending = cause
            sequencer.request_stop(cause)
        else:
            {"hold": sequencer.request_hold, "pause": sequencer.request_pause, "resume": sequencer.request_resume}[
                action
            ](cause)


def picture(station: Station, status: Status, nominal_s: float) -> dict[str, Any]:
    """A tick as an object for JSON: temperatures [degC], times [s]; what is not known is null."""
    leg, reading = status.leg, status.reading
    segment_left_s, left_s = (round(left, 1) for left in time_left(status, nominal_s))
    return {
        "state": status.state,
        "t_s": round(status.t_s, 3),
        "left_s": left_s,
        "segment": {
            "index": leg.index,
            "of": status.legs,
            "name": leg.name,
            "kind": leg.kind,
            "target_degc": leg.target_degc,
            "rate_degc_per_min": leg.rate_degc_per_min,
            "from_s": round(status.leg_from_s, 3),
            "left_s": segment_left_s,
            "anew": status.anew,
        },
        "chamber": {
            "temperature_degc": _known(reading.temperature),
            "setpoint_degc": _known(reading.setpoint),
            "working_setpoint_degc": _known(reading.working_setpoint),
            "on": reading.on,
            "alarm": list(reading.alarm),
        },
        "units": [
            *(_unit(unit, None) for unit in station.units),
            *(_unit(gone.unit, gone.reason) for gone in station.dropped),
        ],
        "buses": [_bus(health) for health in station.captures()],
        "holding": list(status.holding),
    }


def _add(trace: Trace, station: Station, status: Status) -> None:
    """Let the trace take in a tick, with the set point in force where the controller tells it."""
    reading = status.reading
    setpoint = reading.setpoint if reading.working_setpoint is None else reading.working_setpoint
    units = [
        (unit.serial, math.nan if unit.temperature is None else unit.temperature.value, unit.rates.take())
        for unit in (*station.units, *(gone.unit for gone in station.dropped))
    ]
    trace.add(status.t_s, (setpoint, reading.temperature), units)


def _unit(unit: LiveUnit, dropped: str | None) -> dict[str, Any]:
    return {
        "serial": unit.serial,
        "temperature_degc": None if unit.temperature is None else _known(unit.temperature.value),
        "losses": unit.decoder.losses.as_dict(),
        "dropped": dropped,
    }


def _bus(health: CaptureHealth) -> dict[str, Any]:
    """How a capture keeps up: frames, how long those taken last had waited, and the longest wait so far [s]."""
    return {
        "bus": health.bus,
        "state": health.state,
        "frames": health.frames,
        "behind_s": round(health.behind_s, 3),
        "most_behind_s": round(health.most_behind_s, 3),
    }


def time_left(status: Status, nominal_s: float) -> tuple[float, float]:
    """Bench time left [s] of this segment and of the run: nominal, late by as much as the segment already is."""
    segment_s = max(status.leg.nominal_s - (status.t_s - status.leg_from_s), 0.0)
    return segment_s, segment_s + max(nominal_s - status.leg.nominal_end_s, 0.0)


@contextmanager
def serve_desk(desk: Desk, folders: Sequence[Path], journals: Sequence[Path] = ()) -> Iterator[str]:
    """Serve the desk, with `live.json` in each run folder while it lasts; yields what is wrong, empty when nothing.

    `journals` are those in which the end of the run will stand.
    """
    with contextlib.ExitStack() as stack:
        try:
            server = stack.enter_context(_Server(desk))
            start = datetime.now(UTC).isoformat(timespec="milliseconds")
            paths = [str(journal.resolve()) for journal in journals]
            live = LiveFile(os.getpid(), server.server_address[1], start, paths, server.token)
            for folder in folders:
                stack.callback(_remove, folder / LIVE)
                live.write(folder)
            thread = threading.Thread(target=server.serve_forever, args=(_POLL_S,), name="control", daemon=True)
            thread.start()
            stack.callback(server.shutdown)
            trouble = ""
        except OSError as error:
            trouble = f"no control from other processes: {error.strerror or error}"
        yield trouble


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = 1024  # a full queue would let the operator wait for a second try of TCP

    def __init__(self, desk: Desk) -> None:
        super().__init__((HOST, 0), _Client)
        self.desk = desk
        self.token = secrets.token_urlsafe(24)
        self._places = threading.BoundedSemaphore(CLIENTS)
        self._strangers: dict[socket.socket, None] = {}
        self._lock = threading.Lock()

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._places.acquire(blocking=False):
            self._turn_away()
            if not self._places.acquire(timeout=PATIENCE_S):
                self.shutdown_request(request)
                return
        with self._lock:
            self._strangers[request] = None
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def shutdown_request(self, request: Any) -> None:
        self.recognise(request)
        super().shutdown_request(request)

    def recognise(self, request: socket.socket) -> None:
        """It has shown the token, or is about to be closed: it is not turned away."""
        with self._lock:
            self._strangers.pop(request, None)

    def _turn_away(self) -> None:
        """Close the oldest client that has not shown the token; its thread then ends."""
        with self._lock, contextlib.suppress(OSError, StopIteration):
            oldest = next(iter(self._strangers))
            del self._strangers[oldest]
            oldest.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away or talked nonsense is no news for the operator's terminal."""


class _Client(socketserver.BaseRequestHandler):
    server: _Server
    request: socket.socket

    def handle(self) -> None:
        answer = {"pid": os.getpid(), **self._answer(read_line(self.request, PATIENCE_S))}
        self.request.settimeout(PATIENCE_S)
        self.request.sendall(json.dumps(answer, allow_nan=False).encode() + b"\n")

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict):
            return _refused("not a JSON object")
        if not hmac.compare_digest(str(request.get("token")).encode(errors="replace"), self.server.token.encode()):
            return _refused("wrong token: not the process that its live.json speaks of")
        self.server.recognise(self.request)
        action = request.get("do")
        if action in ACTIONS:
            try:
                self.server.desk.ask(action, str(request.get("who", "unknown")))
            except RuntimeError as error:
                return _refused(str(error))
        elif action == "trace":
            trace = self.server.desk.trace(request.get("since"), request.get("generation"))
            return {"ok": True, **self.server.desk.status(), "trace": trace}
        elif action != "status":
            return _refused(f"do is {str(action)[:40]!r}, must be one of status, trace, {', '.join(ACTIONS)}")
        return {"ok": True, **self.server.desk.status()}


def _refused(error: str) -> dict[str, Any]:
    return {"ok": False, "error": error}


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def _known(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 4)


def _printable(text: str) -> str:
    """A name as one bounded line: it goes into events, reports and terminals."""
    return "".join(char if char.isprintable() else "?" for char in text[:_NAME_LENGTH]) or "unknown"
