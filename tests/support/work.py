"""Counting work: calls, rows, bytes. The same on every machine and every day, which seconds are not."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections.abc import Callable
from contextlib import contextmanager
from typing import Any


def calls(work: Callable[[], Any]) -> int:
    """Calls of Python and of C functions in this thread; `work` ran once before, so that caches are filled."""
    work()
    count = 0

    def counted(frame: Any, event: str, argument: Any) -> None:
        nonlocal count
        count += event in {"call", "c_call"}

    with _quiet():
        sys.setprofile(counted)
        try:
            work()
        finally:
            sys.setprofile(None)
    return count - 1  # the end of counting


def peak_bytes(work: Callable[[], Any]) -> int:
    """Most that Python and numpy held at once on top of what was there before; `work` ran once before.

    The least of three: what another thread allocates meanwhile is counted, too.
    """
    work()
    return min(_peak_bytes(work) for _ in range(3))


def _peak_bytes(work: Callable[[], Any]) -> int:
    with _quiet():
        tracemalloc.start()
        try:
            before = tracemalloc.get_traced_memory()[0]
            work()
            return tracemalloc.get_traced_memory()[1] - before
        finally:
            tracemalloc.stop()


@contextmanager
def _quiet() -> Any:
    """Without the garbage collector, whose finalisers would be counted."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def costs(count: float, bound: float) -> None:
    """At most the bound, and twice the count would be over it: else the bound notices nothing and must come down."""
    assert count <= bound, f"counted {count:,.6g}, allowed {bound:,.6g}: where is it done again?"
    assert 2 * count > bound, f"counted {count:,.6g}, allowed {bound:,.6g}: work was saved, lower the bound"
