"""Firmware of a gyro that the bench does not know, as a host compiles it, and the program that heats its chamber."""

import random
import struct

from pymodbus.client import ModbusTcpClient

ORDER, LOST, LAG_S, SETPOINT = ">", (), 0.0, 100
BIG = {"id": 0x200, "order": "big", "type": "signed"}
SIGNALS = {
    "rate": BIG | {"start": 7, "length": 32, "scale": 1e-6, "unit": "deg/s"},
    "counter": BIG | {"start": 39, "length": 16, "type": "unsigned"},
    "temperature": BIG | {"start": 55, "length": 16, "scale": 0.01, "unit": "degC"},
    "cycle_ms": 10,
}


class Gyro:
    def __init__(self):
        self.core_degc, self.noise = None, random.Random(1)

    def frames(self, moment):
        behind = moment.temperature_degc - (self.core_degc or moment.temperature_degc)
        self.core_degc = moment.temperature_degc - behind * (1 - 0.01 / max(LAG_S, 0.01))
        rate_dps = moment.rate_dps + 1e-4 * (self.core_degc - 25) + self.noise.gauss(0, 1e-4)
        values = round(1e6 * rate_dps), moment.index & 0xFFFF, round(100 * moment.temperature_degc)
        return [] if moment.index in LOST else [(0x200, struct.pack(ORDER + "iHh", *values))]


def heat(port, degc):
    with ModbusTcpClient("127.0.0.1", port=port) as chamber:
        chamber.write_register(SETPOINT, round(10 * degc))
        chamber.write_coil(5, True)
