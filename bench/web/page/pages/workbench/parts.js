// Shared by all parts of the workbench: preact, words, the API, formatted numbers.
export { html, useEffect, useLayoutEffect, useMemo, useReducer, useRef, useState } from "../../lib/preact.js";
import { duration, language, moment, number as plain, or, sig, symbols, t } from "../../lib/words.js";
import * as api from "../../lib/api.js";
import { onTheme, palette } from "../../lib/figure.js";
import { html, useEffect, useState } from "../../lib/preact.js";
import { runTitle } from "../../lib/names.js";
export { api, duration, moment, or, runTitle, t };

/** A number with a few significant digits, or a dash without one; no row of zeros for what is next to nothing. */
export const number = (value, digits = 3) =>
  value === null || value === undefined || !Number.isFinite(value) ? "–"
    : value && Math.abs(value) < 1e-4 ? sig(value, digits)
    : new Intl.NumberFormat(language.get(), {
      maximumSignificantDigits: digits, minimumSignificantDigits: Number.isInteger(value) ? 1 : digits, useGrouping: Math.abs(value) >= 1e4,
    }).format(value).replace("-", "−");

/** Whether a deviation misleads, as one side of the interval is twice as wide as the other: as `Value.words` there. */
export const uneven = ({ value, interval }) => {
  const [below, above] = interval ? [value - interval[0], interval[1] - value] : [1, 1];
  return Math.max(below, above) > 2 * Math.min(below, above);
};

/** "8.6 ± 1.2 s": as many digits as the uncertainty allows; "2.7 [1.1 … 20] h" where the interval is uneven. */
export function measured({ value, std, unit, interval, at_bound }) {
  if (value === null || value === undefined) return "–";
  if (!at_bound && uneven({ value, interval })) {
    return `${number(value, 2)} [${interval.map((end) => number(end, 2)).join(" … ")}]\u00a0${symbols(unit)}`.trim();
  }
  if (!std || !Number.isFinite(std)) return `${number(value, 4)}\u00a0${symbols(unit)}`.trim();
  const digits = Math.max(0, 1 - Math.floor(Math.log10(std)));
  const written = digits > 6 ? [sig(value), sig(std, 2)] : [plain(value, digits), plain(std, digits)];
  return `${written[0].replace("-", "−")}\u00a0±\u00a0${written[1]}\u00a0${symbols(unit)}`.trim();
}

/** Colours of the page, taken again when it turns light or dark. */
export function usePalette() {
  const [, repaint] = useState(0);
  useEffect(() => onTheme(() => repaint((n) => n + 1)), []);
  return palette();
}

const LONG_S = 2;

/** A computation that goes on; when it takes long, with its time and a way to give it up. When it was, with a way back. */
export function Waiting({ job, children }) {
  const [seconds, setSeconds] = useState(0);
  useEffect(() => {
    if (!job.running) return undefined;
    const begin = performance.now();
    setSeconds(0);
    const timer = setInterval(() => setSeconds((performance.now() - begin) / 1000), 1000);
    return () => clearInterval(timer);
  }, [job.running]);
  if (job.stopped) return html`<p class="wb-waiting"><span role="status">${t("workbench.stopped")}</span> <button type="button" class="narrow" onClick=${job.again}>${t("error.retry")}</button></p>`;
  return job.running && html`<p class="wb-waiting"><span class="wb-pulse" aria-hidden="true"></span><span role="status">${children}</span>
    ${seconds > LONG_S && html`<span class="figures">${duration(seconds)}</span> <button type="button" class="narrow" onClick=${job.stop}>${t("run.cancel")}</button>`}</p>`;
}

export const unitOf = (run) => run.split("/")[0];
