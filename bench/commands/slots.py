"""New units in the slots of a station: `NEW@KNOWN` is unit NEW where the station file has unit KNOWN."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from bench import analysis
from bench.base import Document, InputError, dump, nearest_or_all

LONGEST = 64


def seated(station: Document, units: Sequence[str]) -> tuple[Document, list[str]]:
    """The station file with new units in its slots, and the serial numbers; as it is where no unit is new.

    A new unit is in all else like the one whose slot it takes. Where the station checks the number that a unit sends
    (`identity`), it is the number in the new serial number.
    """
    entries = station.content.get("units") if isinstance(station.content, dict) else None
    known = {str(entry.get("serial")): entry for entry in entries or () if isinstance(entry, dict)}
    serials, moved = [], dict[str, str]()
    for unit in units:
        new, at, slot = unit.rpartition("@")
        if not at or unit in known:
            serials.append(unit)
            continue
        if slot not in known:
            raise InputError(f"no slot '{slot}' for unit '{new}'{nearest_or_all(slot, known)}", station.file)
        _refuse_wrong(new, slot, {*known} - {slot}, station)
        if moved.get(slot, new) != new:
            raise InputError(f"'{moved[slot]}' and '{new}' are both in slot '{slot}': one unit stands in a slot")
        serials.append(new)
        if new != slot:
            moved[slot] = new
    if not moved:
        return station, serials
    seats = [_renamed(entry, moved, station) for entry in entries or ()]
    content = {**station.content, "units": [_beside(seat, seats, serials) for seat in seats]}
    return replace(station, content=content, text=dump(content)), serials


def _refuse_wrong(new: str, slot: str, others: set[str], station: Document) -> None:
    if not new.strip() or new != new.strip() or not new.isprintable() or len(new) > LONGEST:
        raise InputError(f"serial number {new[: LONGEST + 1]!r} must be 1 to {LONGEST} visible characters")
    if new in others:
        raise InputError(f"unit '{new}' has a slot of its own; leave out '@{slot}'", station.file)


def _beside(seat: dict[str, Any], seats: Sequence[dict[str, Any]], serials: Sequence[str]) -> dict[str, Any]:
    """A unit that is not asked for may have the number that a new one sends: its own is not checked then."""
    sent = {str(one.get("identity")) for one in seats if str(one.get("serial")) in serials}
    if str(seat.get("serial")) in serials or str(seat.get("identity")) not in sent:
        return seat
    return {name: value for name, value in seat.items() if name != "identity"}


def _renamed(entry: dict[str, Any], moved: dict[str, str], station: Document) -> dict[str, Any]:
    new = moved.get(str(entry.get("serial")))
    if new is None:
        return entry
    changed = {**entry, "serial": new}
    if entry.get("identity") is not None:
        number = analysis.serial_number(new)
        if number is None:
            text = (
                f"serial number '{new}' has no digits: the station checks the number that the unit sends (`identity`)"
            )
            raise InputError(f"{text}; type the serial number as it stands on the unit", station.file)
        changed["identity"] = number
    return changed
