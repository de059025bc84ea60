"""A programmable power supply that switches the units' power: SCPI over a serial line or a TCP socket.

`OUTPut[:STATe] ON|OFF[,(@channels)]` and its query are in the SCPI-99 command reference (volume 2, 15.11); `*IDN?` in
IEEE 488.2. Voltage and current limit stay as they are set at the supply: this driver never writes them.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import serial

from drivers.errors import IdentityError, LinkError, ReadBackError


@dataclass(frozen=True)
class SupplyLine:
    """Where a supply is: a serial port, or `socket://HOST:PORT`."""

    port: str
    baudrate: int = 9600
    timeout_s: float = 2.0


class PowerSupply:
    """One output of a supply, or all of them for None."""

    def __init__(self, line: SupplyLine, output: int | None = None) -> None:
        """Raises LinkError when the line does not open."""
        self._name = f"power supply on {line.port}"
        self._output = "" if output is None else f"(@{output})"
        try:
            self._port = serial.serial_for_url(line.port, line.baudrate, timeout=line.timeout_s)
        except (OSError, ValueError) as error:
            raise LinkError(f"{self._name} does not open: {error}") from error

    def identify(self) -> str:
        """What the supply says it is; IdentityError when it does not answer as SCPI wants. Writes nothing."""
        said = self._ask("*IDN?")
        if said.count(",") != 3:
            raise IdentityError(f"{self._name} answers *IDN? with {said!r}, not with maker, model, serial and version")
        return said

    def is_on(self) -> bool:
        """Whether the output is on."""
        said = self._ask(f"OUTP? {self._output}".strip())
        if said not in {"0", "1"}:
            raise LinkError(f"{self._name}: OUTP? answers {said!r}, which is neither 0 nor 1")
        return said == "1"

    def switch(self, on: bool) -> None:
        """Switch the output and read it back; ReadBackError when it is not as it was told."""
        state = "ON" if on else "OFF"
        self._send(",".join(filter(None, [f"OUTP {state}", self._output])))
        if self.is_on() is not on:
            raise ReadBackError(f"{self._name}: the output was switched {state.lower()} and reads otherwise")

    def close(self) -> None:
        """Close the line; the output stays as it is."""
        with contextlib.suppress(OSError):
            self._port.close()

    def _ask(self, query: str) -> str:
        with contextlib.suppress(OSError):
            self._port.reset_input_buffer()
        self._send(query)
        try:
            raw = bytes(self._port.read_until(b"\n"))
        except (OSError, serial.SerialException) as error:
            raise LinkError(f"{self._name}: {query}: {error}") from error
        if not raw.endswith(b"\n"):
            raise LinkError(f"{self._name}: {query}: no answer within {self._port.timeout:g} s")
        return raw.decode("ascii", errors="replace").strip()

    def _send(self, command: str) -> None:
        try:
            self._port.write(f"{command}\n".encode("ascii"))
        except (OSError, serial.SerialException) as error:
            raise LinkError(f"{self._name}: {command}: {error}") from error
