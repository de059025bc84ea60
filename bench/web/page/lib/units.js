// A unit of a station, or a new one in a slot of it, as the API names it: `SERIAL`, or `NEW@KNOWN`.

/** Serial number. */
export const serialOf = (unit) => (unit.includes("@") ? unit.slice(0, unit.lastIndexOf("@")) : unit);

/** Serial number in the station file: the slot. */
export const slotOf = (unit) => unit.slice(unit.lastIndexOf("@") + 1);

/** Whether two serial numbers are of one unit, as somebody types them. */
export const same = (one, other) => one.trim().toLowerCase() === other.trim().toLowerCase();

/** The unit with this serial number in a slot. */
export const inSlot = (serial, slot) => (serial.trim() && !same(serial, slot) ? `${serial.trim()}@${slot}` : slot);

/** The serial number that `text` repeats, as a scanner types it that reads a label twice: a known one, or one of three characters and more; empty without one. */
export const repeated = (text, known) => {
  const typed = text.trim().toLowerCase();
  const rest = (unit) => typed.replaceAll(unit.trim().toLowerCase(), "").trim();
  if (!typed || known.some((unit) => same(unit, text))) return "";
  return known.find((unit) => !rest(unit)) ?? text.trim().match(/^(.{3,}?)\s*(\1\s*)+$/i)?.[1] ?? "";
};
