"""A simulated Ideal Aerosmith table on a pseudo terminal: answers in a thread, moves with the given clock."""

from __future__ import annotations

import contextlib
import os
import select
import threading
from collections.abc import Callable

from drivers.sim.ptys import raw

STEP_DEG = 0.0001


class SimulatedAerosmith:
    """`jog_per_dps` is 1 for a table that jogs in deg/s, 60 for deg/min; `port` is the terminal to open."""

    def __init__(self, now: Callable[[], float], jog_per_dps: float = 1.0, modulo: bool = False) -> None:
        self.motor = False
        self.silent = False
        self._now, self._per_dps, self._modulo = now, jog_per_dps, modulo
        self._rate_dps = self._target_dps = self._angle_deg = 0.0
        self._accel_dps2 = 50.0
        self._at_s = now()
        self._master, self._slave = os.openpty()
        raw(self._slave)
        self.port = os.ttyname(self._slave)
        self._stop, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._serve, name="aerosmith", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and the terminal."""
        os.write(self._wake, b"x")
        self._thread.join()
        for handle in (self._master, self._slave, self._stop, self._wake):
            os.close(handle)

    def _serve(self) -> None:
        line = b""
        while True:
            ready, _, _ = select.select([self._master, self._stop], [], [])
            if self._stop in ready:
                return
            with contextlib.suppress(OSError):
                line += os.read(self._master, 1024)
            while b"\r" in line:
                command, line = line.split(b"\r", 1)
                answer = self._answer(command.decode("ascii", errors="replace"))
                if not self.silent:
                    os.write(self._master, f"{answer}\r\n>".encode())

    def _answer(self, command: str) -> str:
        self._move()
        word, argument = command[:3], command[3:]
        try:
            if word == "SRV":
                self.motor = argument == "1"
            elif word == "ACL":
                self._accel_dps2 = float(argument)
            elif word == "JOG" and self.motor:
                self._target_dps = float(argument) / self._per_dps
            elif word == "STO":
                self._target_dps = 0.0
            elif word == "PPO":
                angle = self._angle_deg % 360.0 if self._modulo else self._angle_deg
                return f"{round(angle / STEP_DEG) * STEP_DEG:.4f}"
            elif command == "MCO5":
                return "0" if self._rate_dps == 0.0 else "1"
            else:
                return "?"
        except ValueError:
            return "?"
        return ""

    def _move(self) -> None:
        """Update rate and angle for the time since the last command: a ramp, then a constant rate."""
        now_s = self._now()
        passed_s, self._at_s = now_s - self._at_s, now_s
        change = (self._target_dps if self.motor else 0.0) - self._rate_dps
        ramp_s = min(abs(change) / self._accel_dps2, passed_s)
        reached = self._rate_dps + (self._accel_dps2 * ramp_s if change > 0 else -self._accel_dps2 * ramp_s)
        if ramp_s < passed_s:
            reached = self._rate_dps + change
        self._angle_deg += (self._rate_dps + reached) / 2 * ramp_s + reached * (passed_s - ramp_s)
        self._rate_dps = reached
