"""Faults of the wire by name, with their effects."""

from __future__ import annotations

ON_BUS = {
    "loss": "a `share` of the frames is missing",
    "duplicate": "a `share` of the frames arrives twice",
    "reorder": "a `share` of the frames arrives after the next one",
    "corrupt": "one bit of a `share` of the payloads flips: the CRC of the unit does not match",
    "burst": "frames are held back for `seconds`, then arrive together, stamped late",
    "silence": "no frames arrive",
    "bus_off": "the controller is off the bus: sending and receiving raise CanOperationError",
    "error_frames": "a `share` of the frames is preceded by an error frame",
    "reset": "the unit restarts: `seconds` without frames, boot-up heartbeat, counter from 0",
    "silent_reset": "the same without the boot-up heartbeat",
    "twin": "a second unit with the same number: its own counter and serial number",
}
"""Faults of a CAN bus (`bus`)."""

ON_MODBUS = {
    "delay": "the answer arrives `seconds` later",
    "drop": "the device executes the request; its answer is lost",
    "silence": "the request never reaches the device",
    "ignore": "the device confirms a write and does not execute it",
    "truncate": "only half of the answer arrives",
    "garble": "one bit flips: wrong CRC on RTU, wrong protocol id on TCP",
    "transaction": "TCP: the answer carries another transaction id",
    "device": "the answer carries another device id",
    "function": "the answer carries another function code",
    "count": "the answer contains one register less, all lengths consistent",
    "exception": "the device answers with exception `code`",
    "echo": "RTU: the adapter receives its own request before the answer",
    "split": "the answer arrives in two pieces (harmless)",
    "stuck": "every request returns the data of its first answer",
    "close": "the connection ends in the middle of the answer",
    "refuse": "connections are refused, open ones are closed",
}
"""Faults of a Modbus gateway (`proxy`)."""
