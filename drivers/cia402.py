"""Objects, states and commands of a CiA 402 drive in profile velocity and profile position mode.

Source: CiA 402 (IEC 61800-7-201, -301), objects 0x6040-0x60FF, and CiA 301 for 0x1000-0x1A00. Rates and positions are
in units of the drive; the station file gives the units per degree. Driver and simulated drive share only this
description.
"""

from __future__ import annotations

import canopen
from canopen import objectdictionary as od

DEVICE_TYPE = 0x1000
ERROR_REGISTER = 0x1001
CONSUMER_HEARTBEAT = 0x1016
PRODUCER_HEARTBEAT = 0x1017
TPDO1, TPDO1_MAP = 0x1800, 0x1A00
ABORT_OPTION = 0x6007
ERROR_CODE = 0x603F
CONTROL, STATUS = 0x6040, 0x6041
QUICK_STOP_OPTION = 0x605A
MODE, MODE_DISPLAY = 0x6060, 0x6061
POSITION, VELOCITY = 0x6064, 0x606C
ACCELERATION, DECELERATION, QUICK_STOP_DECELERATION = 0x6083, 0x6084, 0x6085
TARGET_POSITION, PROFILE_SPEED = 0x607A, 0x6081
TARGET_VELOCITY = 0x60FF
SUPPORTED_MODES = 0x6502

PROFILE_402 = 402
PROFILE_POSITION, PROFILE_VELOCITY = 1, 3
"""Modes of operation; bits 0 and 2 of the supported modes."""
ON_ABORT_QUICK_STOP = 3
"""Abort option: a lost master causes a quick stop."""
QUICK_STOP_AND_STAY = 6
"""Quick stop option: slow down on the quick stop ramp and stay in QUICK STOP ACTIVE, axis held."""

SHUTDOWN, SWITCH_ON, ENABLE_OPERATION = 0x06, 0x07, 0x0F
QUICK_STOP, DISABLE_VOLTAGE = 0x02, 0x00
NEW_SET_POINT = 0x3F
"""Control word in profile position mode: operation enabled, new set point, at once, absolute position."""
TARGET_REACHED, SET_POINT_TAKEN = 1 << 10, 1 << 12
"""Bits of the status word in profile position mode."""

ENABLED, STOPPING, FAULT = "operation enabled", "quick stop active", "fault"
_STATES = (
    (0x4F, 0x00, "not ready to switch on"),
    (0x4F, 0x40, "switch on disabled"),
    (0x6F, 0x21, "ready to switch on"),
    (0x6F, 0x23, "switched on"),
    (0x6F, 0x27, ENABLED),
    (0x6F, 0x07, STOPPING),
    (0x4F, 0x0F, "fault reaction active"),
    (0x4F, 0x08, FAULT),
)
STATUS_OF = {name: value for _, value, name in _STATES}

_VARIABLES: tuple[tuple[int, str, int, str, int], ...] = (
    (DEVICE_TYPE, "device type", od.UNSIGNED32, "ro", 0x0002_0192),
    (ERROR_REGISTER, "error register", od.UNSIGNED8, "ro", 0),
    (PRODUCER_HEARTBEAT, "producer heartbeat time", od.UNSIGNED16, "rw", 0),
    (ABORT_OPTION, "abort connection option code", od.INTEGER16, "rw", 1),
    (ERROR_CODE, "error code", od.UNSIGNED16, "ro", 0),
    (CONTROL, "controlword", od.UNSIGNED16, "rw", 0),
    (STATUS, "statusword", od.UNSIGNED16, "ro", 0x40),
    (QUICK_STOP_OPTION, "quick stop option code", od.INTEGER16, "rw", 2),
    (MODE, "modes of operation", od.INTEGER8, "rw", 0),
    (MODE_DISPLAY, "modes of operation display", od.INTEGER8, "ro", 0),
    (POSITION, "position actual value", od.INTEGER32, "ro", 0),
    (VELOCITY, "velocity actual value", od.INTEGER32, "ro", 0),
    (ACCELERATION, "profile acceleration", od.UNSIGNED32, "rw", 0),
    (DECELERATION, "profile deceleration", od.UNSIGNED32, "rw", 0),
    (QUICK_STOP_DECELERATION, "quick stop deceleration", od.UNSIGNED32, "rw", 0),
    (TARGET_POSITION, "target position", od.INTEGER32, "rw", 0),
    (PROFILE_SPEED, "profile velocity", od.UNSIGNED32, "rw", 0),
    (TARGET_VELOCITY, "target velocity", od.INTEGER32, "rw", 0),
    (SUPPORTED_MODES, "supported drive modes", od.UNSIGNED32, "ro", 1 << 0 | 1 << 2),
)
_RECORDS: tuple[tuple[int, str, tuple[tuple[int, str, int, int], ...]], ...] = (
    (CONSUMER_HEARTBEAT, "consumer heartbeat time", ((1, "master", od.UNSIGNED32, 0),)),
    (
        TPDO1,
        "TPDO1 communication",
        ((1, "COB-ID", od.UNSIGNED32, 0), (2, "type", od.UNSIGNED8, 255), (5, "event timer", od.UNSIGNED16, 0)),
    ),
    (
        TPDO1_MAP,
        "TPDO1 mapping",
        ((0, "count", od.UNSIGNED8, 0), (1, "first", od.UNSIGNED32, 0), (2, "second", od.UNSIGNED32, 0)),
    ),
)

RECORDS = frozenset(index for index, _, _ in _RECORDS)
"""Objects whose values have sub-indices."""


def dictionary() -> canopen.ObjectDictionary:
    """The objects that the bench uses, with the values they have at power-on."""
    objects = canopen.ObjectDictionary()
    for index, name, kind, access, value in _VARIABLES:
        objects.add_object(_variable(name, (index, 0), kind, access, value))
    for index, name, members in _RECORDS:
        record = od.ODRecord(name, index)
        for sub, member, kind, value in members:
            record.add_member(_variable(member, (index, sub), kind, "rw", value))
        objects.add_object(record)
    return objects


def _variable(name: str, place: tuple[int, int], kind: int, access: str, value: int) -> od.ODVariable:
    variable = od.ODVariable(name, *place)
    variable.data_type, variable.access_type, variable.default = kind, access, value
    return variable


def state(status_word: int) -> str:
    """Name of the drive state in a status word."""
    return next((name for mask, value, name in _STATES if status_word & mask == value), f"0x{status_word:04X}")


def mapped(index: int) -> int:
    """Entry of a PDO mapping for a 32-bit object."""
    return index << 16 | 32
