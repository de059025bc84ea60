"""The registry beside the run folders as the server reads it: opened where it is, asked again only after it changed."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Hashable
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

from cachetools import LRUCache

from bench.archive import FILE, Archive, Registry, archive, is_archive, open_registry
from bench.base import InputError

T = TypeVar("T")
_KEPT = 32
"""Answers that are kept."""
_PATIENCE_S = 0.3
"""Longer than this nobody waits for an answer that was given before [s]."""
_SHARED_S = 5.0
"""How long an answer of a shared registry, whose changes cannot be seen from here, is good for [s]."""


class Stock:
    """Registry and archive of one folder of run folders; `where` names another registry than the file in it."""

    def __init__(self, root: Path, where: str | None = None) -> None:
        """Nothing is opened yet."""
        self.root, self.where = root, where
        self._changed = threading.Condition()
        self._answers: LRUCache[Hashable, tuple[Hashable, Any, float]] = LRUCache(_KEPT)
        self._asking: set[Hashable] = set()

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

    @property
    def counting(self) -> bool:
        """Whether an answer that was given is being brought up to date."""
        return bool(self._asking)

    def answer(self, key: Hashable, ask: Callable[[Registry], T]) -> T:
        """What `ask` says of the registry as it is now; one thread asks, the others wait for the same answer.

        Where the last answer took long, it is given at once, and another thread asks anew.
        """
        with self._changed:
            while True:
                state, kept = self._state(), self._answers.get(key)
                if kept is not None and kept[0] == state:
                    answer: T = kept[1]
                    return answer
                if kept is not None and kept[2] > _PATIENCE_S:
                    if key not in self._asking:
                        self._asking.add(key)
                        threading.Thread(target=self._again, args=(key, ask), name="stock", daemon=True).start()
                    stale: T = kept[1]
                    return stale
                if key not in self._asking:
                    self._asking.add(key)
                    break
                self._changed.wait()
        return self._asked(key, ask)

    def _again(self, key: Hashable, ask: Callable[[Registry], Any]) -> None:
        with contextlib.suppress(InputError):  # the next one who asks is told
            self._asked(key, ask)

    def _asked(self, key: Hashable, ask: Callable[[Registry], T]) -> T:
        begun, state = monotonic(), self._state()
        try:
            with self.open() as registry:
                answer = ask(registry)
            with self._changed:
                self._answers[key] = (state, answer, monotonic() - begun)
            return answer
        finally:
            with self._changed:
                self._asking.discard(key)
                self._changed.notify_all()

    def _state(self) -> Hashable:
        """Changes with every write."""
        if self.where is not None:
            return int(monotonic() / _SHARED_S)
        return tuple(_stamp(self.root / f"{FILE}{suffix}") for suffix in ("", "-wal"))


def _stamp(path: Path) -> tuple[int, int, int]:
    try:
        known = path.stat()
    except OSError:
        return 0, 0, 0
    return known.st_ino, known.st_size, known.st_mtime_ns
