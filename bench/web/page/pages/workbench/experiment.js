// The next experiment: why the runs so far cannot decide, the proposed temperature curve, and a link to start it.
import { html, t, api, duration, usePalette } from "./parts.js";
import { sign } from "../../lib/words.js";
import { reasons, rival } from "./sentence.js";
import { degrees } from "../../lib/words.js";

const WIDTH = 420;
const HEIGHT = 150;
const EDGE = { left: 52, right: 10, top: 10, bottom: 26 };

/** Temperature over time, `curve` [[t_s, degc]...]. */
export function Curve({ curve, label }) {
  const colours = usePalette();
  if (!curve?.length) return null;
  const times = curve.map(([time]) => time);
  const temperatures = curve.map(([, degc]) => degc);
  const [low, high] = [Math.min(...temperatures), Math.max(...temperatures)];
  const end = Math.max(...times) || 1;
  const x = (time) => EDGE.left + ((WIDTH - EDGE.left - EDGE.right) * time) / end;
  const y = (degc) => HEIGHT - EDGE.bottom - ((HEIGHT - EDGE.top - EDGE.bottom) * (degc - low)) / (high - low || 1);
  const path = curve.map(([time, degc], i) => `${i ? "L" : "M"}${x(time).toFixed(1)},${y(degc).toFixed(1)}`).join("");
  const text = { "font-size": 12, fill: colours.soft };
  return html`<svg class="wb-curve" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label=${label}>
    ${[low, high].map((degc) => html`<g key=${degc}>
      <line x1=${EDGE.left} x2=${WIDTH - EDGE.right} y1=${y(degc)} y2=${y(degc)} stroke=${colours.grid} />
      <text ...${text} x=${EDGE.left - 6} y=${y(degc) + 4} text-anchor="end">${degrees(degc, 0)}</text></g>`)}
    <path d=${path} fill="none" stroke=${colours.heldOut} stroke-width="2.2" stroke-linejoin="round" />
    <text ...${text} x=${EDGE.left} y=${HEIGHT - 6}>0</text>
    <text ...${text} x=${WIDTH - EDGE.right} y=${HEIGHT - 6} text-anchor="end">${duration(end)}</text>
  </svg>`;
}

/** `next`: `next_experiment` of a diagnosis. */
export function NextExperiment({ next, unit }) {
  if (!next) return null;
  const [before, after] = [next.probability_before, next.probability_after].map((share) => Math.round(100 * (share ?? 0)));
  const known = next.probability_after !== null && next.probability_after !== undefined;
  const none = known && !next.decides && after <= before;
  const rivals = next.separates.map(rival).join(" ⇄ ");
  return html`<section class="wb-card wb-next" aria-labelledby="wb-next-title">
    <h2 id="wb-next-title">${t("workbench.next.title")}</h2>
    <p class="wb-lead">⇄ ${t("workbench.next.cannot", { effects: rivals })}</p>
    <p>${none ? t("workbench.next.none", { percent: String(before) }) : reasons(next).join(sign(" "))}</p>
    ${!none && html`<${Curve} curve=${next.curve} label=${t("workbench.next.curve", { duration: duration(60 * next.duration_min) })} />`}
    ${known && !none && before < after && html`<p class="wb-soft">${t("workbench.next.chance", { before, after })}</p>`}
    ${next.plan && next.decides && html`<p><a class="button primary narrow" href=${`/start${api.query({ plan: next.plan, unit })}`}>${t("workbench.next.run")}</a></p>`}
  </section>`;
}
