// Values that people type.

/** A value as it is typed: text as it is, all else as JSON. */
export const written = (value) => (typeof value === "string" ? value : JSON.stringify(value));

/** A number that was typed, with a decimal point or comma; NaN where it is none. */
export const numberOf = (text) => (/^\s*[-+−]?(\d+([.,]\d*)?|[.,]\d+)(e[-+]?\d+)?\s*$/i.test(text) ? Number(text.replace(",", ".").replace("−", "-")) : NaN);

/** The value of a text: a number, JSON, or the text itself. */
export function typed(text) {
  const value = numberOf(text);
  if (Number.isFinite(value)) return value;
  try {
    return JSON.parse(text);
  } catch {
    return text.trim();
  }
}

/** What a file of a person may be called, without its ending, in any script. */
export const FILE_NAME = /^[\p{L}\p{N}][\p{L}\p{N}._+-]{0,59}$/u;
