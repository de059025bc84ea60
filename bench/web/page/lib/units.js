// A unit of a station, or a new one in a slot of it, as the API names it: `SERIAL`, or `NEW@KNOWN`.

/** Serial number. */
export const serialOf = (unit) => (unit.includes("@") ? unit.slice(0, unit.lastIndexOf("@")) : unit);

/** Serial number in the station file: the slot. */
export const slotOf = (unit) => unit.slice(unit.lastIndexOf("@") + 1);

/** Whether two serial numbers are of one unit, as somebody types them. */
export const same = (one, other) => one.trim().toLowerCase() === other.trim().toLowerCase();

/** The unit with this serial number in a slot. */
export const inSlot = (serial, slot) => (serial.trim() && !same(serial, slot) ? `${serial.trim()}@${slot}` : slot);
