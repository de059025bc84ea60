"""A unit's calibration memory on a bus with nothing else: heartbeats, requests and answers, in simulated time."""

from __future__ import annotations

import uuid
from contextlib import contextmanager

import can
import numpy as np

from bench.deliver.export.delivery import Block, Delivery, Shape
from bench.deliver.export.image import words_of
from bench.deliver.export.signals import channel_signal
from bench.deliver.export.words import to_bytes
from drivers.canopen_store import CanopenStore
from drivers.clock import SimClock
from drivers.flash_objects import Addresses
from drivers.layout import layout_of
from drivers.sim.blockbus import BlockBus
from drivers.sim.eeprom import Eeprom
from drivers.sim.flash_port import FlashPort, serve
from drivers.sim.memory import CalibrationMemory
from drivers.uds_store import UdsStore
from drivers.unit_line import UnitLine
from drivers.wire import load_dbc

SERIAL = 7


def delivery(shift_dps: float = 0.0, terms: int = 4, created: int = 1_700_000_000, **more) -> Delivery:
    """A polynomial over temperature."""
    coefficients = np.concatenate([[0.001 + shift_dps], 1e-4 / np.arange(1, terms)])
    block = Block(Shape.SERIES, 0, 0, terms - 1, coefficients)
    return Delivery("polynomial", (channel_signal("temperature", -55.0, 125.0),), (block,), created=created, **more)


def image(serial: int = SERIAL, id_: int = 1, form: str = "split_fixed", **wishes) -> bytes:
    return to_bytes(words_of(delivery(**wishes), form, serial, id_))


class Beating:
    """What `FlashPort` needs of a unit's wire: a bus, and heartbeats."""

    def __init__(self, bus, number: int, serial: int) -> None:
        self.bus, self.number, self.serial = bus, number, serial
        self.coefficient_set, self.booted, self.due_s = 0, False, 0.0
        self.message = load_dbc("vibratory")["GYRO_HEARTBEAT"]
        self.silent = False

    def reboot(self) -> None:
        self.booted = False

    def live(self, t_s: float) -> None:
        if self.silent or (self.booted and t_s < self.due_s):
            return
        state = 5 if self.booted else 0
        values = {"State": state, "Serial": self.serial, "Firmware": 1, "CoefficientSet": self.coefficient_set}
        data = self.message.pack(1, values)[0].tobytes()
        self.bus.send(can.Message(arbitration_id=self.message.id + self.number, is_extended_id=False, data=data))
        self.booted, self.due_s = True, t_s + 1.0


class World:
    """One unit; `stores` connects to it. A later world with the same file is the same unit after a power cycle."""

    def __init__(self, path=None, protocol="canopen", serial: int = SERIAL, number: int = 3) -> None:
        self.channel, self.number, self.protocol = uuid.uuid4().hex, number, protocol
        self.clock = SimClock()
        self.wire = Beating(BlockBus(self.channel), number, serial)
        self.memory = CalibrationMemory(Eeprom(path), serial)
        self.port = FlashPort(self.wire, self.memory, Addresses.usual(number, protocol))
        self.clock.attach(self.step)

    def step(self, t0_s: float, t1_s: float) -> None:
        serve([self.port], t0_s)
        self.wire.live(t0_s)

    @contextmanager
    def store(self, wrap=lambda bus: bus, transfer="segmented"):
        bus = BlockBus(self.channel)
        try:
            line = UnitLine(wrap(bus), self.clock, layout_of("vibratory"), self.number)
            addresses = Addresses.usual(self.number)
            if self.protocol == "uds":
                yield UdsStore(line, addresses.request, addresses.answer)
            else:
                yield CanopenStore(line, addresses.node, transfer)
        finally:
            bus.shutdown()

    def close(self) -> None:
        self.wire.bus.shutdown()


class KilledError(BaseException):
    """The bench died; not even `except Exception` sees it."""


class Counting:
    """A bus that counts the frames of the bench and lets it die, or the cable break, before frame number `last`."""

    def __init__(self, bus, last=None, cut=False) -> None:
        self.bus, self.sent, self.last, self.cut = bus, 0, last, cut

    def send(self, message) -> None:
        if self.last is not None and self.sent >= self.last:
            if not self.cut:
                raise KilledError
            return
        self.sent += 1
        self.bus.send(message)

    def __getattr__(self, name):
        return getattr(self.bus, name)
