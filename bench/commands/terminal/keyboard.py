"""Keys of a terminal while a run is live: h hold, p pause after this segment, r resume, q abort (asks once).

A thread reads single keys; Ctrl-C stays what it is. Without a terminal, or as long as the bench runs in the background
of one, nothing is read. The terminal is left as it was found.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from types import TracebackType
from typing import Protocol

from bench.acquisition import Action, Desk, whoami

HELP = "h hold   p pause after this segment   r resume   q abort"
QUESTION = "abort the run? y: yes, any other key: no"
_KEYS: dict[str, tuple[Action, str]] = {
    "h": ("hold", "asked to hold"),
    "p": ("pause", "asked to hold after this segment"),
    "r": ("resume", "asked to go on"),
}
_LOOK_S = 0.2


class Keys(Protocol):
    """Where keys come from."""

    def read(self, patience_s: float) -> str:
        """One key, or nothing after that time; EOFError when there will be no more."""


class Keyboard:
    """Context manager; `notice` is the line to be shown with the progress, empty where no keys are read."""

    def __init__(self, desk: Desk, keys: Keys | None = None) -> None:
        self._desk = desk
        self._keys = keys
        self._said = HELP
        self._asking = False
        self._done = threading.Event()
        self._thread: threading.Thread | None = None
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Keyboard:
        keys = self._keys or self._stack.enter_context(_terminal())
        if keys is not None:
            self._thread = threading.Thread(target=self._listen, args=(keys,), name="keyboard", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        if self._thread is not None:
            self._thread.join()
        self._stack.close()

    @property
    def notice(self) -> str:
        """What the operator should read: the keys, the last answer, or a question."""
        return "" if self._thread is None else self._said

    def press(self, key: str) -> None:
        """Do what a key asks for."""
        key = key.lower()
        who = f"{whoami()} at the keyboard"
        try:
            if self._asking:
                self._asking = False
                self._said = "aborting" if key == "y" else HELP
                if key == "y":
                    self._desk.ask("abort", who)
            elif key == "q":
                self._asking, self._said = True, QUESTION
            elif key in _KEYS:
                action, said = _KEYS[key]
                self._desk.ask(action, who)
                self._said = f"{said}   ({HELP})"
        except RuntimeError as error:
            self._said = str(error)

    def _listen(self, keys: Keys) -> None:
        with contextlib.suppress(EOFError, OSError):
            while not self._done.is_set():
                if key := keys.read(_LOOK_S):
                    self.press(key)


@contextlib.contextmanager
def _terminal() -> Iterator[Keys | None]:
    """The keys of this process's terminal; None where it has none."""
    try:
        interactive = sys.stdin.isatty() and sys.stderr.isatty()
    except (AttributeError, ValueError):  # closed, or replaced by something that is no file
        interactive = False
    if not interactive:
        yield None
    elif sys.platform == "win32":
        yield _WindowsKeys()
    else:
        import termios

        handle = sys.stdin.fileno()
        before = termios.tcgetattr(handle)
        try:
            yield _PosixKeys(handle)
        finally:
            if _in_foreground(handle):
                termios.tcsetattr(handle, termios.TCSADRAIN, before)


def _in_foreground(handle: int) -> bool:
    """Whether reading and setting this terminal would not stop us (`bench run … &`)."""
    try:
        return os.tcgetpgrp(handle) == os.getpgrp()
    except OSError:
        return False


class _PosixKeys:
    """A terminal that hands over each key at once, without showing it."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def read(self, patience_s: float) -> str:
        import select

        if _in_foreground(self._handle):
            self._at_once()
        ready = select.select([self._handle], [], [], patience_s)[0]
        if not ready:
            return ""
        if not _in_foreground(self._handle):
            threading.Event().wait(patience_s)  # what is typed there is meant for others
            return ""
        data = os.read(self._handle, 1)
        if not data:
            raise EOFError
        return data.decode("ascii", errors="ignore")

    def _at_once(self) -> None:
        """Single keys; again after a shell had the terminal (Ctrl-Z, fg)."""
        import termios

        now = termios.tcgetattr(self._handle)
        if now[3] & (termios.ICANON | termios.ECHO):
            now[3] &= ~(termios.ICANON | termios.ECHO)
            now[6][termios.VMIN], now[6][termios.VTIME] = 1, 0
            termios.tcsetattr(self._handle, termios.TCSADRAIN, now)


class _WindowsKeys:
    """The console of Windows."""

    def read(self, patience_s: float) -> str:
        import msvcrt

        waited = threading.Event()
        for _ in range(10):
            if msvcrt.kbhit():  # type: ignore[attr-defined,unused-ignore]
                key: str = msvcrt.getwch()  # type: ignore[attr-defined,unused-ignore]
                return key
            waited.wait(patience_s / 10)
        return ""
