"""The registry beside the run folders as the server reads it: opened where it is, counted again only after it changed.

What takes long to count is kept in the server's own folder, so that a server that has just started gives the last
answer at once.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from cachetools import LRUCache
from pydantic_core import to_json

from bench.archive import FILE, Archive, Registry, archive, is_archive, open_registry
from bench.base import BenchError, __version__
from bench.record import write_atomically
from bench.web.ground.problems import CountingError

Parts = Mapping[str, Any]
_KEPT = 32
"""Answers that are kept."""
_PATIENCE_S = 0.3
"""Longer than this nobody waits for an answer [s]."""
_COUNTING = 4
"""Questions without an answer that are counted at a time."""
_SHARED_S = 5.0
"""How long an answer of a shared registry, whose changes cannot be seen from here, is good for [s]."""


@dataclass(frozen=True)
class Answer:
    """Parts of an answer by name, as JSON; `current`: no newer one is being counted."""

    parts: Mapping[str, bytes]
    current: bool = True

    def part(self, name: str) -> Any:
        """What a part holds; KeyError where there is none."""
        return json.loads(self.parts[name])

    def content(self) -> dict[str, Any]:
        """All parts."""
        return {name: self.part(name) for name in self.parts}


@dataclass(frozen=True)
class _Kept:
    """An answer, or the error instead, with the state of the registry that it is of and the time that it took [s]."""

    state: str
    took_s: float
    parts: Mapping[str, bytes]
    error: BenchError | None = None

    def given(self, *, current: bool) -> Answer:
        if self.error is not None:
            raise self.error
        return Answer(self.parts, current)


class Stock:
    """Registry and archive of one folder of run folders; `where` names another registry than the file in it."""

    def __init__(self, root: Path, where: str | None = None, own: Callable[[], Path] | None = None) -> None:
        """Nothing is opened yet; `own` makes the server's folder, in which answers are kept that took long."""
        self.root, self.where = root, where
        self._own = own
        self._changed = threading.Condition()
        self._answers: LRUCache[str, _Kept] = LRUCache(_KEPT)
        self._asking: set[str] = set()
        self._due: dict[bool, deque[tuple[str, Callable[[Registry], Parts]]]] = {False: deque(), True: deque()}
        """Questions to be counted; True: those that have an older answer, of which one is counted at a time."""
        self._free = {False: _COUNTING, True: 1}
        """Daemon threads that may be started: a server that ends waits for an executor's, and not for these."""

    @property
    def exists(self) -> bool:
        """Whether there is a registry to ask."""
        return self.where is not None or (self.root / FILE).is_file()

    @property
    def archive(self) -> Archive:
        """The folder as the registry knows it; an id that no run has where it was never registered."""
        return Archive(self.root, archive(self.root).id if is_archive(self.root) else "")

    def open(self) -> Registry:
        """The registry; InputError where it cannot be opened."""
        return open_registry(self.where or self.root / FILE)

    def answer(self, question: str, ask: Callable[[Registry], Parts]) -> Answer:
        """What `ask` says of the registry as it is now; several who ask the same wait for one answer.

        Where counting takes long, the last answer is given, or CountingError where there is none yet. Errors are those
        of `ask`.
        """
        with self._changed:
            state, kept = self._state(), self._answers.get(question) or self._read(question)
            if kept is not None and kept.state == state:
                return kept.given(current=True)
            if question not in self._asking:
                self._asking.add(question)
                newer = kept is not None and kept.took_s > _PATIENCE_S
                self._due[newer].append((question, ask))
                if self._free[newer]:
                    self._free[newer] -= 1
                    threading.Thread(target=self._work, args=(newer,), name="stock", daemon=True).start()
            if kept is None or kept.took_s <= _PATIENCE_S:
                self._changed.wait_for(lambda: question not in self._asking, max(_PATIENCE_S, 0.0))
                kept = self._answers.get(question, kept)
            if kept is None:
                raise CountingError("all units are being counted; ask again in a second")
            return kept.given(current=question not in self._asking)

    def _work(self, newer: bool) -> None:
        """Count what is due, until nothing is."""
        while True:
            with self._changed:
                if not self._due[newer]:
                    self._free[newer] += 1
                    return
                question, ask = self._due[newer].popleft()
            self._count(question, ask)

    def _count(self, question: str, ask: Callable[[Registry], Parts]) -> None:
        begun, state, parts, failed = monotonic(), self._state(), dict[str, bytes](), None
        try:
            with self.open() as registry:
                parts = {name: to_json(part) for name, part in ask(registry).items()}
        except BenchError as error:
            failed = error
        finally:
            kept = _Kept(state, monotonic() - begun, parts, failed)
            with self._changed:
                self._answers[question] = kept
                self._asking.discard(question)
                self._changed.notify_all()
            if kept.took_s > _PATIENCE_S and failed is None:
                self._write(question, kept)

    def _file(self, question: str) -> Path | None:
        name = hashlib.sha256(f"{__version__} {question}".encode()).hexdigest()[:32]
        return None if self._own is None else self._own() / "counted" / f"{name}.jsonl"

    def _write(self, question: str, kept: _Kept) -> None:
        """Head and parts, a line each; the oldest files go."""
        file = self._file(question)
        if file is None:
            return
        head = json.dumps({"state": kept.state, "took_s": kept.took_s, "parts": list(kept.parts)}).encode()
        with suppress(OSError):  # a full disk costs the next start some time, and nobody the answer
            file.parent.mkdir(exist_ok=True)
            write_atomically(file, b"\n".join([head, *kept.parts.values()]))
            for old in sorted(file.parent.iterdir(), key=lambda path: path.stat().st_mtime_ns)[:-_KEPT]:
                old.unlink(missing_ok=True)

    def _read(self, question: str) -> _Kept | None:
        """What was counted before this start; None where nothing was."""
        file = self._file(question)
        with suppress(OSError, ValueError, KeyError, TypeError):
            head, *parts = file.read_bytes().split(b"\n") if file else [b""]
            told = json.loads(head)
            found = _Kept(told["state"], told["took_s"], dict(zip(told["parts"], parts, strict=True)))
            self._answers[question] = found
            return found
        return None

    def _state(self) -> str:
        """Changes with every write."""
        if self.where is not None:
            return str(int(monotonic() / _SHARED_S))
        return str([_stamp(self.root / f"{FILE}{suffix}") for suffix in ("", "-wal")])


def _stamp(path: Path) -> tuple[int, int, int]:
    try:
        known = path.stat()
    except OSError:
        return 0, 0, 0
    # Whoever reads makes an empty log, which goes when the last one closes.
    return (known.st_ino, known.st_size, known.st_mtime_ns) if known.st_size else (0, 0, 0)
