// Shared by all parts of the workbench: preact, words, the API, formatted numbers.
export { html, useEffect, useLayoutEffect, useMemo, useReducer, useRef, useState } from "../../lib/preact.js";
import { duration, language, moment, number as plain, or, symbols, t } from "../../lib/words.js";
import * as api from "../../lib/api.js";
import { onTheme, palette } from "../../lib/figure.js";
import { useEffect, useState } from "../../lib/preact.js";
import { runTitle } from "../../lib/names.js";
export { api, duration, moment, or, runTitle, t };

/** A number with a few significant digits, or a dash without one. */
export const number = (value, digits = 3) =>
  value === null || value === undefined || !Number.isFinite(value) ? "–"
    : new Intl.NumberFormat(language.get(), {
      maximumSignificantDigits: digits, minimumSignificantDigits: Number.isInteger(value) ? 1 : digits, useGrouping: Math.abs(value) >= 1e4,
    }).format(value).replace("-", "−");

/** "8.6 ± 1.2 s": as many digits as the uncertainty allows. */
export function measured({ value, std, unit }) {
  if (value === null || value === undefined) return "–";
  if (!std || !Number.isFinite(std)) return `${number(value, 4)} ${symbols(unit)}`.trim();
  const digits = Math.max(0, 1 - Math.floor(Math.log10(std)));
  const written = digits > 6 ? [value.toExponential(2), std.toExponential(1)] : [plain(value, digits), plain(std, digits)];
  return `${written[0].replace("-", "−")} ± ${written[1]} ${symbols(unit)}`.trim();
}

/** Colours of the page, taken again when it turns light or dark. */
export function usePalette() {
  const [, repaint] = useState(0);
  useEffect(() => onTheme(() => repaint((n) => n + 1)), []);
  return palette();
}

export const unitOf = (run) => run.split("/")[0];
