// A plan's temperature over time as a small drawing: corners of the nominal set point, hot and cold named.
import { html, useEffect, useRef, useState } from "./preact.js";
import { degrees, duration, number, t } from "./words.js";

/** Lowest and highest temperature [degC] of a curve [[s, degC], ...]. */
export function range(curve) {
  const degc = curve.map(([, value]) => value);
  return [Math.min(...degc), Math.max(...degc)];
}

const EDGE = { left: 10, right: 10, top: 12, bottom: 12 };
const STEPS_S = [300, 600, 900, 1800, 3600, 7200, 10800, 14400, 21600, 43200, 86400];
const STEPS_DEGC = [5, 10, 20, 25, 50];

const step = (steps, span, most) => steps.find((size) => span / size <= most) ?? steps.at(-1);
const multiples = (low, high, size) => {
  const first = Math.ceil(low / size);
  return Array.from({ length: Math.max(0, Math.floor(high / size) - first + 1) }, (_, index) => (first + index) * size);
};

/**
 * `width` and `height` are units of the drawing, which scales with its place; `axes` adds a grid with numbers, and such a
 * drawing has as many units as its place has pixels, so that its numbers have the size of the text around it.
 */
export function Curve({ width = 320, height = 130, axes = false, ...of }) {
  const place = useRef(null);
  const [wide, setWide] = useState(width);
  useEffect(() => {
    if (!axes || !place.current) return undefined;
    const watcher = new ResizeObserver(([{ contentRect }]) => contentRect.width && setWide(Math.round(contentRect.width)));
    watcher.observe(place.current);
    return () => watcher.disconnect();
  }, [Boolean(of.curve?.length)]);
  if (!of.curve?.length) return null;
  if (!axes) return html`<${Drawing} ...${of} width=${width} height=${height} axes=${false} />`;
  return html`<div ref=${place}><${Drawing} ...${of} width=${wide} height=${Math.max(180, Math.round((height * wide) / width))} axes /></div>`;
}

/** The runs of a curve: where a time stands twice, one has ended and another begins. */
const runsOf = (curve) => curve.reduce((runs, corner, index) => {
  if (!index || corner[0] === curve[index - 1][0]) runs.push([]);
  runs.at(-1).push(corner);
  return runs;
}, /** @type {number[][][]} */ ([]));

/** The drawing itself, the runs of the curve apart; `width` and `height` are its units. */
export function Drawing({ curve, width, height, axes, label }) {
  const [low, high] = range(curve);
  const edge = axes ? { left: 56, right: 28, top: 16, bottom: 34 } : EDGE;
  const end = curve.at(-1)[0] || 1;
  const [bottom, top] = low === high || (axes && high - low < 5) ? [low - 5, high + 5] : axes ? [low - (high - low) * 0.06, high + (high - low) * 0.06] : [low, high];
  const runs = runsOf(curve);
  const gap = width / 50;
  const scale = (width - edge.left - edge.right - (runs.length - 1) * gap) / end;
  const x = (t_s, run = runs.findLastIndex((one) => one[0][0] <= t_s)) => edge.left + t_s * scale + run * gap;
  const y = (degc) => edge.top + ((top - degc) / (top - bottom)) * (height - edge.top - edge.bottom);
  const text = label ?? t("curve.label", { low: degrees(low, 0), high: degrees(high, 0), time: duration(end) });
  const base = y(Math.max(bottom, Math.min(top, curve[0][1])));
  return html`<svg class="curve" viewBox=${`0 0 ${width} ${height}`} role="img" aria-label=${text}>
    ${axes && html`<${Grid} x=${x} y=${y} end=${end} low=${bottom} high=${top} width=${width} height=${height} edge=${edge} />`}
    ${!axes && html`<path class="curve-base" d=${`M${x(0)} ${base.toFixed(1)}H${x(end)}`} />`}
    ${runs.map((run, index) => {
      const line = run.map(([t_s, degc], at) => `${at ? "L" : "M"}${x(t_s, index).toFixed(1)} ${y(degc).toFixed(1)}`).join("");
      return html`<path class="curve-fill" d=${`${line}V${base.toFixed(1)}H${x(run[0][0], index).toFixed(1)}Z`} /><path class="curve-line" d=${line} />`;
    })}
  </svg>`;
}

function Grid({ x, y, end, low, high, width, height, edge }) {
  const size_s = step(STEPS_S, end, Math.min(8, Math.floor(width / 70)));
  const hours = size_s >= 3600;
  return html`
    ${multiples(low, high, step(STEPS_DEGC, high - low, 6)).map((degc) => html`
      <path class="curve-grid" d=${`M${edge.left} ${y(degc)}H${width - edge.right}`} />
      <text class="curve-text" x=${edge.left - 8} y=${y(degc) + 5} text-anchor="end">${number(degc, 0)}</text>`)}
    ${multiples(0, end, size_s).map((t_s) => html`
      <path class="curve-grid" d=${`M${x(t_s)} ${edge.top}V${height - edge.bottom}`} />
      <text class="curve-text" x=${x(t_s)} y=${height - edge.bottom + 20} text-anchor="middle">
        ${hours ? t("unit.h", { value: number(t_s / 3600, 0) }) : t("unit.min", { value: number(t_s / 60, 0) })}
      </text>`)}
    <text class="curve-text" x=${edge.left - 8} y=${edge.top - 3} text-anchor="end">°C</text>`;
}
