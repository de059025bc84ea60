"""Sessions of browsers, one per cookie; they survive a restart of the server."""

from __future__ import annotations

import contextlib
import hashlib
import json
import secrets
import threading
import time
from collections.abc import Callable
from pathlib import Path

from bench.record import write_atomically
from bench.web.people.people import Person

LIFE_S = 12 * 3600
"""Length of a session [s]: a little more than a shift."""
_MOST = 1000


class Sessions:
    """Hashes of cookies, each with the hash of its token and the end of the session [s since 1970]."""

    life_s = LIFE_S

    def __init__(self, path: Path, clock: Callable[[], float] = time.time) -> None:
        self._path, self._clock = path, clock
        self._lock = threading.Lock()
        self._known: dict[str, tuple[str, float]] = {}
        with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):  # unreadable: all users sign in again
            known = json.loads(path.read_bytes())
            self._known = {key: (str(token), float(until)) for key, (token, until) in known.items()}

    def begin(self, person: Person, life_s: float = LIFE_S, mark: str = "") -> str:
        """Begin a session of this length [s] and kind; returns the content of its cookie."""
        key = secrets.token_urlsafe(32)
        with self._lock:
            self._known[_hash(key)] = (mark + person.token_sha256, self._clock() + life_s)
            self._write()
        return key

    def token(self, key: str) -> str | None:
        """Kind, and hash of the token, of this session; None where the session is over."""
        token, until_s = self._known.get(_hash(key), ("", 0.0))
        return token if self._clock() < until_s else None

    def left_s(self, key: str) -> float:
        """What is left of this session [s]; 0 where it is over."""
        return max(self._known.get(_hash(key), ("", 0.0))[1] - self._clock(), 0.0)

    def end(self, key: str) -> None:
        """End a session."""
        with self._lock:
            if self._known.pop(_hash(key), None):
                self._write()

    def _write(self) -> None:
        now_s = self._clock()
        alive = sorted((item for item in self._known.items() if item[1][1] > now_s), key=lambda item: item[1][1])
        self._known = dict(alive[-_MOST:])
        with contextlib.suppress(OSError):  # a full disk must not keep a user from an abort
            write_atomically(self._path, json.dumps(self._known).encode())


def _hash(key: str) -> str:
    return hashlib.sha256(key.encode(errors="replace")).hexdigest()
