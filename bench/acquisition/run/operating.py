"""What an operator, or whoever speaks for one, asks of a live run: hold, pause, resume, stop.

Requests come from any thread or signal handler; the loop of the run takes them at its next tick, in their order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Literal

from bench.base import RunAborted

Request = Literal["hold", "pause", "resume", "stop"]


class Operating:
    """Requests and what they leave in force; `report(kind, text, **facts)` takes an event for each."""

    def __init__(self, report: Callable[..., None], confirm: Callable[[str], None] = lambda who: None) -> None:
        """`confirm` is told who went on."""
        self.hold = ""
        """Who holds the chamber where it is; empty: nobody."""
        self.pause = ""
        """Who wants it held after the present segment; empty: nobody."""
        self._requests: deque[tuple[Request, str]] = deque()
        self._report, self._confirm = report, confirm

    def ask(self, request: Request, cause: str) -> None:
        """Safe to call from any thread and from a signal handler."""
        self._requests.append((request, cause))

    @property
    def asked_to_stop(self) -> bool:
        """Whether a stop waits to be taken."""
        return any(request == "stop" for request, _ in tuple(self._requests))

    def take(self) -> None:
        """Let the requests come into force. RunAborted when one of them is to stop."""
        while self._requests:
            request, cause = self._requests.popleft()
            self._report("request", f"{request} by {cause}", request=request, who=cause)
            if request == "stop":
                raise RunAborted(f"aborted by {cause}")
            if request == "hold":
                self.hold, self.pause = cause, ""
            elif request == "pause":
                self.pause = self.pause or cause
            else:
                self.hold = self.pause = ""
                self._confirm(cause)

    def segment_is_over(self) -> None:
        """A pause that waited for the end of a segment holds from now on."""
        if self.pause:
            self.hold, self.pause = self.pause, ""

    @property
    def holding(self) -> tuple[str, ...]:
        """What holds the run, for people."""
        return (f"operator: hold by {self.hold}",) if self.hold else ()
