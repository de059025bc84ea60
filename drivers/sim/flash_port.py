"""Service side of simulated units on their buses: answers requests and performs resets, in step with the clock."""

from __future__ import annotations

from collections.abc import Iterable

import can

from drivers.flash_objects import NMT_RESET, SDO_ANSWER, SDO_REQUEST, Addresses
from drivers.sim.can_gyro import CanGyro
from drivers.sim.can_unit import CanUnit
from drivers.sim.eeprom import PowerLostError
from drivers.sim.memory import CalibrationMemory
from drivers.sim.sdo_server import SdoServer
from drivers.sim.uds_server import UdsServer


class FlashPort:
    """The memory of one unit on its bus."""

    def __init__(self, wire: CanGyro | CanUnit, memory: CalibrationMemory, addresses: Addresses) -> None:
        self.wire, self.memory = wire, memory
        self._addresses = addresses
        self.power_up()

    def power_up(self) -> None:
        """Restart as after power-on: everything outside the EEPROM is lost."""
        self._sdo, self._uds = SdoServer(self.memory), UdsServer(self.memory)
        self.memory.boot()
        self.wire.reboot()
        self.show()

    def show(self) -> None:
        """Update the coefficient set in the heartbeat and the rate message."""
        self.wire.coefficient_set = self.memory.coefficient_set

    def take(self, message: can.Message, t_s: float) -> None:
        """Serve one frame, at bench time `t_s` [s]; frames to other units are ignored."""
        data, identifier = bytes(message.data), message.arbitration_id
        if message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        try:
            if self._addresses.protocol == "uds":
                if identifier == self._addresses.request:
                    for frame in self._uds.answer(data):
                        self._send(self._addresses.answer, frame, t_s)
                    if self._uds.reset_asked:
                        self.power_up()
            elif identifier == SDO_REQUEST + self._addresses.node:
                if (answer := self._sdo.answer(data)) is not None:
                    self._send(SDO_ANSWER + self._addresses.node, answer, t_s)
            elif identifier == 0 and data[:1] == bytes([NMT_RESET]) and data[1:2] in {b"\0", self._node}:
                self.power_up()
        except PowerLostError:
            self.memory.eeprom.writable = None
            self.power_up()
        self.show()

    @property
    def _node(self) -> bytes:
        return bytes([self._addresses.node])

    def _send(self, identifier: int, data: bytes, t_s: float) -> None:
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data, timestamp=t_s)
        self.wire.bus.send(message)


def serve(ports: Iterable[FlashPort], t_s: float) -> None:
    """Serve the frames that have arrived on the buses of these units."""
    by_bus: dict[int, list[FlashPort]] = {}
    for port in ports:
        by_bus.setdefault(id(port.wire.bus), []).append(port)
    for on_bus in by_bus.values():
        while (message := on_bus[0].wire.bus.recv(0.0)) is not None:
            for port in on_bus:
                port.take(message, t_s)
