"""Notices to people who are not beside the bench, by the library apprise: e-mail, webhooks, desktops, chats.

Each recipient has a thread and a short queue: a caller never waits, a recipient that does not answer holds up no other
one, and what was not delivered is told to the caller, who records it.
"""

from __future__ import annotations

import logging
import threading
import time
import warnings
from collections import Counter
from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, Literal, TypeVar

from bench.acquisition.station.settings.notify import Kind, NotifyFile, Recipient
from bench.base import Document, InputError, load_config, read_yaml

if TYPE_CHECKING:
    from apprise import NotifyBase

PATIENCE_S = 20.0
"""The end of a run waits at most so long for notices to be delivered; the equipment is safe by then."""
MOST_WAITING = 16
"""Notices that wait for one recipient; further ones are dropped."""


Mood = Literal["info", "success", "warning", "failure"]
T = TypeVar("T")


class Notifier:
    """Sends notices to the recipients of a file; one without a file sends nothing. For one thread."""

    def __init__(self, path: str | None) -> None:
        """InputError with file and line where the file is wrong, or one of its services cannot be used here."""
        self._lines = [_Line(recipient, service) for recipient, service in load_recipients(path)] if path else []

    def tell(self, kind: Kind, title: str, text: str, mood: Mood = "info") -> None:
        """Send to everybody who wants to know of it, and return at once."""
        for line in self._lines:
            line.tell(kind, title, text, mood)

    def close(self) -> None:
        """Wait until everything is delivered, at most `PATIENCE_S`; nothing can be told after it."""
        until_s = time.monotonic() + PATIENCE_S
        for line in self._lines:
            line.close(until_s)

    def troubles(self) -> list[str]:
        """What was not delivered since this was asked last, a sentence for each recipient."""
        return [text for line in self._lines if (text := line.trouble())]


def try_out(path: str) -> list[tuple[str, str]]:
    """Send a trial to every recipient of a file and wait for it: (name, what went wrong, empty where it was taken)."""
    import apprise

    found = []
    for recipient, service in load_recipients(path):
        with apprise.LogCapture(level=logging.WARNING) as said:  # type: ignore[no-untyped-call]
            taken = service.notify(body="Trial: nothing happened.", title="bench: trial", notify_type="info")
            lines = [line.partition("WARNING - ")[2] or line for line in said.getvalue().splitlines()]
        found.append((recipient.name, "" if taken else "; ".join(lines) or "not taken, without a reason"))
    return found


class _Line:
    """The way to one recipient."""

    def __init__(self, recipient: Recipient, service: NotifyBase) -> None:
        self._recipient, self._service = recipient, service
        self._waiting: Queue[tuple[Kind, str, str, Mood] | None] = Queue(MOST_WAITING)
        self._failed: Queue[Kind] = Queue()
        self._on_its_way: Kind | None = None
        self._thread: threading.Thread | None = None

    def tell(self, kind: Kind, title: str, text: str, mood: Mood) -> None:
        if kind in self._recipient.when:
            if self._thread is None:  # a check of the file needs none
                self._thread = threading.Thread(
                    target=self._send, name=f"notices to {self._recipient.name}", daemon=True
                )
                self._thread.start()
            try:
                self._waiting.put_nowait((kind, title, text, mood))
            except Full:
                self._failed.put(kind)

    def close(self, until_s: float) -> None:
        """Give up what is not delivered at `until_s` of the monotonic clock."""
        if self._thread is None:
            return
        try:
            self._waiting.put(None, timeout=max(until_s - time.monotonic(), 0.0))
            self._thread.join(max(until_s - time.monotonic(), 0.0))
        except Full:
            pass
        if self._thread.is_alive():
            late = [] if (now := self._on_its_way) is None else [now]
            for kind in late + [notice[0] for notice in _rest(self._waiting) if notice is not None]:
                self._failed.put(kind)

    def trouble(self) -> str:
        count = Counter(_rest(self._failed))
        if not count:
            return ""
        kinds = ", ".join(kind if n == 1 else f"{kind} ({n} times)" for kind, n in count.items())
        return f"{self._recipient.name} was not told of: {kinds}; `bench doctor STATION --notify` says why"

    def _send(self) -> None:
        while (notice := self._waiting.get()) is not None:
            kind, title, text, mood = notice
            self._on_its_way = kind
            try:
                taken = self._service.notify(body=text, title=title, notify_type=mood)
            except Exception:  # of any service: nothing that it does may end the run
                taken = False
            if not taken:
                self._failed.put(kind)
            self._on_its_way = None


def _rest(queue: Queue[T]) -> list[T]:
    found: list[T] = []
    while True:
        try:
            found.append(queue.get_nowait())
        except Empty:
            return found


def load_recipients(source: str | Document) -> list[tuple[Recipient, NotifyBase]]:
    """Recipients of a file, each with its service; InputError where the file, or a service, is wrong."""
    document = source if isinstance(source, Document) else read_yaml(Path(source))
    path = document.file
    recipients = load_config(document, NotifyFile).recipients
    try:
        import apprise
    except ImportError:
        raise InputError("notifications need apprise: pip install 'gyro-thermal-bench[notify]'", path) from None
    found = []
    for i, recipient in enumerate(recipients):
        with warnings.catch_warnings():  # the services import what Python has deprecated
            warnings.simplefilter("ignore")
            service = apprise.Apprise.instantiate(recipient.url, suppress_exceptions=True)
        if service is None:
            text = f"recipients[{i}].url: {_wrong(recipient.url)}"
            raise InputError(text, path, document.line(("recipients", i, "url")))
        found.append((recipient, service))
    return found


def _wrong(url: str) -> str:
    """Why apprise takes no such URL, without a word of what may be secret in it."""
    from apprise.manager_plugins import NotificationManager

    scheme, found, _ = url.partition("://")
    if not found:
        return "begins with no service; such as mailtos://, jsons:// (a webhook) or dbus:// (the desktop)"
    services = NotificationManager()  # type: ignore[no-untyped-call]
    if scheme.lower() not in services:
        return f"apprise has no service '{scheme}://'; its documentation lists them"
    if not services[scheme.lower()].enabled:
        return f"'{scheme}://' cannot be used on this computer: {services[scheme.lower()].requirements['details']}"
    return f"is not complete for the service '{scheme}://'"
