"""Faults of the wire by name: what can be injected, and what it does."""

from __future__ import annotations

ON_BUS = {
    "loss": "a `share` of the frames is missing",
    "duplicate": "a `share` of the frames comes twice",
    "reorder": "a `share` of the frames is overtaken by the next one",
    "corrupt": "one bit of a `share` of the payloads flips: the CRC of the unit no longer fits",
    "burst": "frames are held back until `seconds` have passed, then come at once, stamped late",
    "silence": "nothing is heard",
    "bus_off": "the controller is off the bus: sending and receiving raise CanOperationError",
    "error_frames": "a `share` of the frames is preceded by an error frame",
    "reset": "the unit starts anew: `seconds` of nothing, boot-up heartbeat, counter from 0",
    "silent_reset": "the same without the boot-up heartbeat",
    "twin": "a second unit with the same number: its own counter and serial number",
}
"""Of a CAN bus (`bus`)."""

ON_MODBUS = {
    "delay": "the answer comes `seconds` later",
    "drop": "the device does what was asked; its answer is lost",
    "silence": "the request never reaches the device",
    "truncate": "half of the answer, then nothing",
    "garble": "one bit flips: wrong CRC on RTU, wrong protocol id on TCP",
    "transaction": "TCP: the answer carries another transaction id",
    "device": "the answer carries another device id",
    "function": "the answer carries another function code",
    "count": "the answer holds one register less, all lengths consistent",
    "exception": "the device answers with exception `code`",
    "echo": "RTU: the adapter hears its own request before the answer",
    "split": "the answer comes in two pieces (harmless)",
    "stuck": "the data that a request read first are read for ever",
    "close": "the connection ends in the middle of the answer",
    "refuse": "no connection is accepted, open ones end",
}
"""Of a Modbus gateway (`proxy`)."""
