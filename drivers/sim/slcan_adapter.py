"""A serial-line CAN adapter (slcan, LAWICEL protocol) simulated on a pty: a python-can bus behind a few ASCII commands.

`C` close, `O` open, `L` listen only, `S0`..`S8` bit rate, `sxxyy` registers, `V`, `N`, `F` queries; frames are
`t` + 3 hex digits (`T` + 8) + length + data, `r`/`R` remote. A command is answered by CR, or by BEL when it is refused
(LAWICEL CANUSB manual, 2.x). For tests of the driver, and for stations without an adapter.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading

import can

from drivers.sim.ptys import raw

_OK, _REFUSED = b"\r", b"\a"
_ANSWERS = {"V": b"V1013\r", "N": b"NA123\r", "F": b"F00\r"}


class SlcanAdapter:
    """Connects `bus` (which the caller owns) to the pty `path`; `commands` lists the commands of the host.

    Frames are forwarded while the host has the channel open. The answer to a transmitted frame is only CR.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self.commands: list[str] = []
        self.is_open = False
        self._bus = bus
        self._master, self._slave = os.openpty()
        raw(self._slave)
        self.path = os.ttyname(self._slave)
        self._running = True
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._from_host, self._to_host)]
        for thread in self._threads:
            thread.start()

    def write(self, line: bytes) -> None:
        """Write these bytes to the serial line."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, line)

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        if self._running:
            self._running = False
            for thread in self._threads:
                thread.join()
            os.close(self._master)
            os.close(self._slave)

    def _from_host(self) -> None:
        rest = b""
        while self._running:
            if select.select([self._master], [], [], 0.02)[0]:
                *lines, rest = (rest + os.read(self._master, 4096)).split(b"\r")
                for line in lines:
                    self.write(self._execute(line.decode("ascii", "replace")))

    def _execute(self, line: str) -> bytes:
        """Execute one command; returns its answer."""
        self.commands.append(line)
        if not line:
            return _OK
        if line in ("O", "L", "C"):
            self.is_open = line != "C"
            return _OK
        if line[0] in "tTrR":
            return self._transmit(line) if self.is_open else _REFUSED
        if line[0] in "Ss":
            return _REFUSED if self.is_open else _OK
        return _ANSWERS.get(line, _REFUSED)

    def _transmit(self, line: str) -> bytes:
        digits = 8 if line[0] in "TR" else 3
        try:
            identifier, length = int(line[1 : 1 + digits], 16), int(line[1 + digits])
            remote = line[0] in "rR"
            data = None if remote else bytes.fromhex(line[2 + digits : 2 + digits + 2 * length])
            self._bus.send(
                can.Message(
                    arbitration_id=identifier,
                    is_extended_id=digits == 8,
                    is_remote_frame=remote,
                    dlc=length,
                    data=data,
                )
            )
        except (ValueError, IndexError, can.CanError):
            return _REFUSED
        return _OK

    def _to_host(self) -> None:
        while self._running:
            message = self._bus.recv(0.02)
            if message is not None and self.is_open:
                self.write(to_line(message))


def to_line(message: can.Message) -> bytes:
    """A received frame as a line of the adapter."""
    kind = "r" if message.is_remote_frame else "t"
    head = f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"
    kind = kind.upper() if message.is_extended_id else kind
    data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
    return f"{kind}{head}{message.dlc}{data}\r".encode()
