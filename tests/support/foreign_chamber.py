"""A controller served by modbus_tk, a Modbus library that is not ours, for the contract of register maps."""

from __future__ import annotations

import socket
from collections.abc import Iterable
from contextlib import suppress
from functools import partial

import serial
from modbus_tk import defines
from modbus_tk.modbus_rtu import RtuServer
from modbus_tk.modbus_tcp import TcpServer

from drivers.register_map import RegisterMap
from drivers.sim.modbus_chamber import ModbusChamber
from drivers.sim.ptys import PtyPair
from tests.support import foreign_server


class Watched(list):
    """Registers that tell when one of them is written."""

    def __init__(self, values, on_write):
        super().__init__(values)
        self.on_write = on_write

    def __setitem__(self, index, value):
        super().__setitem__(index, value)
        self.on_write(index, value)


class ForeignChamber:
    """Serves what a controller of ours holds after boot; takes every write, as modbus_tk does."""

    def __init__(self, registers: RegisterMap, wire: str = "tcp") -> None:
        self.map = registers.with_decimals(dict.fromkeys(registers.decimals, 1))
        with ModbusChamber(registers) as booted:
            image = {name: booted.words(name) for name in self.map.registers}
        self.pair = PtyPair() if wire == "rtu" else None
        if self.pair:
            port = serial.Serial(self.pair.right, 19200)
            self.server = RtuServer(port)
        else:
            self.server = TcpServer(port=0, address="127.0.0.1", timeout_in_sec=0.02)
        self.slave = self.server.add_slave(1)
        kinds = {1: defines.COILS, 2: defines.DISCRETE_INPUTS, 3: defines.HOLDING_REGISTERS, 4: defines.ANALOG_INPUTS}
        self.memory: dict[int, list[int]] = {}
        for code, kind in kinds.items():
            self.slave.add_block(f"all {code}", kind, 0, 65536)
            self.memory[code] = Watched([0] * 65536, partial(self.mirror, code))
            self.slave._get_block(f"all {code}")._data = self.memory[code]
        for name, words in image.items():
            self.set_words(name, words)
        foreign_server.started(self.server)

    @property
    def url(self) -> str:
        if self.pair:
            return f"rtu://{self.pair.left}?baudrate=19200"
        return f"tcp://127.0.0.1:{foreign_server.port_of(self.server)}"

    def mirror(self, code: int, address: int, value: int) -> None:
        """The state register follows the command, as in a controller."""
        run = self.map.run
        command, state = self.map[run.register], self.map[run.state]
        if (code, address) == (command.read, command.address) and state is not command:
            self.set_words(run.state, state.encode(command.decode([value])))

    def words(self, name: str) -> list[int]:
        return list(self.memory[self.map[name].read][self.map[name].address : self.map[name].end])

    def set_words(self, name: str, words: Iterable[int]) -> None:
        register = self.map[name]
        for offset, word in enumerate(words):
            address = register.address + offset
            others = (
                0 if register.mask is None else list.__getitem__(self.memory[register.read], address) & ~register.mask
            )
            list.__setitem__(self.memory[register.read], address, word | others)

    def close(self) -> None:
        if not self.pair:  # it looks whether to stop once a second, or when somebody calls
            self.server._go.clear()
            with suppress(OSError):  # it has stopped already
                socket.create_connection(self.server._sock.getsockname()).close()
        self.server.stop()
        if self.pair:
            self.server.close()
            self.pair.close()
