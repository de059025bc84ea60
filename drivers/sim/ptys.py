"""Two ends of a serial line without hardware: bytes written to one end are read from the other."""

from __future__ import annotations

import contextlib
import os
import select
import threading


def raw(slave: int) -> None:
    """Let a pseudo terminal pass every byte as it is."""
    import tty  # Windows has none

    tty.setraw(slave)


class PtyPair:
    """A null-modem cable between two pseudo terminals; `left` and `right` are their paths."""

    def __init__(self) -> None:
        """Open both ends; OSError on a system without pseudo terminals."""
        masters, self._slaves = zip(*(os.openpty() for _ in range(2)), strict=True)
        self._masters: tuple[int, int] = (masters[0], masters[1])
        for slave in self._slaves:
            raw(slave)  # and kept open, so that a program that closes its end does not hang up the line
        self.left, self.right = (os.ttyname(slave) for slave in self._slaves)
        self._wake, self._wake_up = os.pipe()
        self._thread = threading.Thread(target=self._pump, name="pty-pair", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Cut the cable; a second call does nothing."""
        if self._thread.is_alive():
            os.close(self._wake_up)
            self._thread.join()
            for number in (*self._masters, *self._slaves, self._wake):
                os.close(number)

    def _pump(self) -> None:
        first, second = self._masters
        other = {first: second, second: first}
        while True:
            ready, _, _ = select.select([first, second, self._wake], [], [])
            if self._wake in ready:
                return
            for end in ready:
                with contextlib.suppress(OSError):
                    os.write(other[end], os.read(end, 4096))
