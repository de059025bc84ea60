// A live chart: one uPlot instance that gets new data and is never recreated. Colours come from the page.
import uPlot from "uplot";
import { html, useEffect, useLayoutEffect, useRef } from "./preact.js";
import { useStore } from "./store.js";
import { language, number, t } from "./words.js";

/** A current colour of the page. */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const STEPS_S = [1, 5, 10, 30, 60, 300, 600, 900, 1800, 3600, 7200, 10800, 14400, 21600, 43200, 86400];
const FONT = '13px system-ui, "Segoe UI", "Liberation Sans", "DejaVu Sans", sans-serif';

/** Bench time on the axis: hours if a tick is an hour, else hours and minutes, or minutes and seconds. */
function clock(ticks) {
  const small = ticks.length > 1 && ticks[1] - ticks[0] < 60;
  const two = (value) => String(Math.floor(value)).padStart(2, "0");
  return ticks.map((s) => (small ? `${Math.floor(s / 60)}:${two(s % 60)}` : `${Math.floor(s / 3600)}:${two((s % 3600) / 60)}`));
}

const axis = (more) => ({
  font: FONT, stroke: () => colour("--soft"), grid: { stroke: () => colour("--grid"), width: 1 },
  ticks: { stroke: () => colour("--line"), width: 1, size: 5 }, ...more,
});

const AXES = [
  axis({ incrs: STEPS_S, space: 70, size: 30, values: (_, ticks) => clock(ticks) }),
  axis({ size: 62, space: 20, values: (_, ticks) => ticks.map((value) => number(value)) }),
];

/** Space above and below the data, more for a nearly constant line. */
function padded(_, low, high, least) {
  if (low === null || high === null) return [-least, least];
  const span = Math.max(high - low, least);
  const middle = (low + high) / 2;
  const half = span / 2 + span * 0.08;
  return [middle - half, middle + half];
}

/** @returns {uPlot.Options} */
const options = (chart, series, bands, hooks) => ({
  width: 300, height: 160, legend: { show: false }, padding: [10, 18, 0, 0],
  cursor: { y: false, drag: { x: false, y: false }, points: { size: 7 } },
  scales: {
    x: { time: false, range: (_, low, high) => chart.current.span?.(low, high) ?? [low ?? 0, high ?? 1] },
    y: { range: (_, low, high) => (chart.current.reach ?? padded)(_, low, high, chart.current.least ?? 1) },
  },
  axes: AXES, series: [{}, ...series], bands, hooks,
});

/**
 * `series` and `bands` as for uPlot, fixed; `data` columns that change with `version`; `span` [low, high] of x,
 * `least` smallest span of y, `behind(plot)` draws behind the lines, `pointed(index or null)` gets the position of the mouse.
 */
export function Plot({ label, series, bands = [], data, version, span, least, reach, behind, pointed, height = 200 }) {
  const place = useRef(null);
  const plot = useRef(null);
  const chart = useRef(/** @type {any} */ ({}));
  chart.current = { span, least, reach, behind, pointed };
  // A layout effect ends before its element is removed.
  useLayoutEffect(() => {
    const hooks = {
      drawAxes: [(drawn) => chart.current.behind?.(drawn)],
      setCursor: [(drawn) => chart.current.pointed?.(drawn.cursor.idx ?? null)],
    };
    plot.current = new uPlot(options(chart, series, bands, hooks), data, place.current);
    const resize = new ResizeObserver(() => {
      const { clientWidth, clientHeight } = place.current;
      if (clientWidth && clientHeight) plot.current.setSize({ width: clientWidth, height: clientHeight });
    });
    resize.observe(place.current);
    const recolour = () => requestAnimationFrame(() => plot.current?.redraw());
    addEventListener("bench-theme", recolour);
    return () => {
      resize.disconnect();
      removeEventListener("bench-theme", recolour);
      plot.current.destroy();
      plot.current = null;
    };
  }, []);
  const speech = useStore(language); // numbers at the axes
  useEffect(() => plot.current?.setData(data), [version, speech]);
  // The canvas has no text alternative; the numbers beside it show the same.
  return html`<div class="plot" ref=${(element) => {
    place.current = element;
    element?.style.setProperty("--plot-height", `${height}px`);
  }} role="img" aria-label=${label}></div>`;
}

/** A polyline through points [[x, y], ...] of the plot's own scales, dashed, behind the data. */
export function polyline(plot, points, name) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.beginPath();
  for (const [x, y] of points) ctx.lineTo(plot.valToPos(x, "x", true), plot.valToPos(y, "y", true));
  ctx.strokeStyle = colour(name);
  ctx.lineWidth = 2 * devicePixelRatio;
  ctx.setLineDash([6 * devicePixelRatio, 5 * devicePixelRatio]);
  ctx.stroke();
  ctx.restore();
}

/** Lines and their names beside a plot: a drawing of the line, its word, its newest value. */
export const Legend = ({ entries }) => html`<ul class="legend" aria-label=${t("plot.lines")}>
  ${entries.map(({ name, tone, dash, value, band }) => html`<li key=${name}>
    <svg viewBox="0 0 28 12" aria-hidden="true" ref=${(element) => element?.style.setProperty("color", `var(${tone})`)}>
      ${band ? html`<rect x="0" y="1" width="28" height="10" rx="2" fill="currentColor" opacity=".35" /><path d="M0 1.5H28M0 10.5H28" stroke="currentColor" stroke-width="1.5" />`
        : html`<path d="M0 6H28" stroke="currentColor" stroke-width="3" stroke-dasharray=${dash ? "6 4" : undefined} />`}
    </svg>
    <span>${name}</span>${value !== undefined && html`<b class="figures">${value}</b>`}
  </li>`)}
</ul>`;
