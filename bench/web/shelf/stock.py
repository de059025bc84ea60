"""The registry beside the run folders as the server reads it: opened where it is, asked again only after it changed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

from cachetools import LRUCache

from bench.archive import FILE, Archive, Registry, archive, is_archive, open_registry

T = TypeVar("T")
_KEPT = 32
"""Answers that are kept."""
_SHARED_S = 5.0
"""How long an answer of a shared registry, whose changes cannot be seen from here, is good for [s]."""


class Stock:
    """Registry and archive of one folder of run folders; `where` names another registry than the file in it."""

    def __init__(self, root: Path, where: str | None = None) -> None:
        """Nothing is opened yet."""
        self.root, self.where = root, where
        self._lock = threading.Lock()
        self._answers: LRUCache[Hashable, tuple[Hashable, Any]] = LRUCache(_KEPT)

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

    def answer(self, key: Hashable, ask: Callable[[Registry], T]) -> T:
        """What `ask` says of the registry as it is now; one thread asks, the others wait for the same answer."""
        with self._lock:
            state = self._state()
            kept = self._answers.get(key)
            if kept is not None and kept[0] == state:
                answer: T = kept[1]
                return answer
            with self.open() as registry:
                answer = ask(registry)
            self._answers[key] = (state, answer)
            return answer

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
