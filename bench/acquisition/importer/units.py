"""Units of other people's columns: a factor and an offset into the unit of a channel."""

from __future__ import annotations

from bench.base import CHANNELS, InputError
from drivers.errors import ConfigError
from drivers.units import USUAL, Conversion
from drivers.units import conversion as into


def conversion(unit: str, channel: str) -> Conversion:
    """From `unit` into the unit of `channel`; InputError when it is unknown or measures something else."""
    kept = CHANNELS[channel].unit
    if kept not in USUAL:
        return Conversion()
    try:
        return into(unit, kept, channel)
    except ConfigError as error:
        raise InputError(str(error)) from None


def examples(channel: str) -> tuple[str, ...]:
    """Units that a channel is usually given in."""
    return USUAL.get(CHANNELS[channel].unit, ("0/1",))
