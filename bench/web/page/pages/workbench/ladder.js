// The ladder: error of each model so far, in-sample and held-out, and the noise floor. A new rung is animated.
import { html, t, useEffect, usePalette, useRef, useState, number } from "./parts.js";
import { isBound } from "../../lib/floor.js";
import { labelled } from "../../lib/spoken.js";
import { number as plain } from "../../lib/words.js";
import { saveCsv, savePng, saveSvg } from "../../lib/download.js";
import { palette } from "../../lib/figure.js";
import { MOST_STEPS } from "./state.js";

const WIDTH = 420;
const HEIGHT = 214;
const EDGE = { left: 48, right: 16, top: 16, bottom: 44 };
const FALL_MS = 900;

/** What the noise floor is. */
export const floorWord = (rung, floor) => (isBound(headline(rung), floor) ? "workbench.ladder.floor_high" : "workbench.ladder.noise");

/** Main error: held-out if available. */
export const headline = (rung) => rung.heldOut ?? rung.inSample;

const still = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

/** 0 → 1 once for every new `key`, eased; 1 at once with reduced motion. */
function useFall(key, enabled) {
  const [progress, setProgress] = useState(1);
  const last = useRef(key);
  useEffect(() => {
    if (last.current === key) return undefined;
    last.current = key;
    if (!enabled || still()) return setProgress(1);
    let frame = 0;
    const begin = performance.now();
    const step = (now) => {
      const x = Math.min(1, Math.max(0, (now - begin) / FALL_MS));
      setProgress(x * x * (3 - 2 * x));
      if (x < 1) frame = requestAnimationFrame(step);
    };
    setProgress(0);
    frame = requestAnimationFrame(step);
    return () => cancelAnimationFrame(frame);
  }, [key, enabled]);
  return progress;
}

/** The rungs while the last one moves from the place of the previous one. */
function falling(rungs, progress) {
  if (rungs.length < 2 || progress >= 1) return rungs;
  const [before, last] = rungs.slice(-2);
  const between = (a, b) => (a === null || b === null ? b : a + (b - a) * progress);
  const moved = { ...last, inSample: between(before.inSample, last.inSample), heldOut: between(before.heldOut, last.heldOut) };
  return [...rungs.slice(0, -1), moved];
}

/** Round step for about four grid lines up to `top`. */
function gridStep(top) {
  const raw = top / 4;
  const decade = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].find((digit) => digit * decade >= raw) * decade;
}

const WIDE = /[\u2e80-\uffff]/;

/** A name that fits into so many pixels, without its middle. */
function short(name, pixels) {
  const most = Math.floor(pixels / (WIDE.test(name) ? 12 : 6.6));
  return name.length > most ? `${name.slice(0, Math.ceil(most / 2) - 1)}…${name.slice(-Math.floor(most / 2))}` : name;
}

/** What two texts begin with, up to a space. */
function sameBegin(one, other) {
  let at = 0;
  while (at < one.length && one[at] === other[at]) at += 1;
  return one.slice(0, one.lastIndexOf(" ", at) + 1);
}

/** Names that fit into so many pixels each; those that would look alike without their middle are without what they begin with. */
export function shortened(names, pixels) {
  const unlike = [...new Set(names)];
  return names.map((name) => {
    const alike = unlike.filter((other) => short(other, pixels) === short(name, pixels));
    const begin = alike.reduce(sameBegin);
    return short(alike.length > 1 && begin ? `…${name.slice(begin.length)}` : name, pixels);
  });
}

function Drawing({ rungs, shown, floor, refer }) {
  const colours = usePalette();
  const all = rungs.flatMap((rung) => [rung.inSample, rung.heldOut]).filter((value) => value !== null);
  const top = 1.08 * Math.max(...all, floor ?? 0, 1e-9);
  const step = gridStep(top);
  const slots = Math.max(rungs.length, 3);
  const x = (i) => EDGE.left + ((WIDTH - EDGE.left - EDGE.right) * (i + 0.5)) / slots;
  const y = (value) => HEIGHT - EDGE.bottom - ((HEIGHT - EDGE.top - EDGE.bottom) * value) / top;
  const lines = Array.from({ length: Math.floor(top / step) + 1 }, (_, i) => i * step);
  const held = shown.map((rung, i) => [x(i), rung.heldOut]).filter(([, value]) => value !== null);
  const path = held.map(([at, value], i) => `${i ? "L" : "M"}${at.toFixed(1)},${y(value).toFixed(1)}`).join("");
  const room = (WIDTH - EDGE.left - EDGE.right) / slots + 2 * EDGE.right; // names stand in two rows, and reach over the edges
  const names = shortened(shown.map((rung) => rung.label), room);
  const label = { fontSize: 12, fill: colours.soft };
  return html`<svg ref=${refer} class="wb-ladder" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} width=${WIDTH} height=${HEIGHT}
      xmlns="http://www.w3.org/2000/svg" font-family="system-ui, 'Segoe UI', 'Liberation Sans', sans-serif" aria-hidden="true">
    <rect class="wb-paper" width=${WIDTH} height=${HEIGHT} fill="none" />
    ${lines.map((value) => html`<g key=${value}>
      <line x1=${EDGE.left} x2=${WIDTH - EDGE.right} y1=${y(value)} y2=${y(value)} stroke=${colours.grid} />
      <text ...${label} x=${EDGE.left - 7} y=${y(value) + 4} text-anchor="end" font-size="12">${plain(value)}</text>
    </g>`)}
    <text ...${label} x=${WIDTH - 4} y="11" text-anchor="end" font-size="11">${labelled("RMS [deg/h]")}</text>
    <path d=${path} fill="none" stroke=${colours.heldOut} stroke-width="2" />
    ${shown.map((rung, i) => html`<g key=${i}>
      ${rung.inSample !== null && html`<circle cx=${x(i)} cy=${y(rung.inSample)} r="8" fill="none" stroke=${colours.inSample} stroke-width="2.5" />`}
      ${rung.heldOut !== null && html`<circle cx=${x(i)} cy=${y(rung.heldOut)} r="5" fill=${colours.heldOut} />`}
      ${headline(rung) !== null && html`<text x=${x(i)} y=${Math.max(11, y(Math.max(rung.heldOut ?? 0, rung.inSample ?? 0)) - 13)} text-anchor="middle"
        font-size="12.5" font-weight="600" fill=${colours.ink} stroke=${colours.raised} stroke-width="4" paint-order="stroke" stroke-linejoin="round">${number(headline(rung))}</text>`}
      <text ...${label} x=${x(i)} y=${HEIGHT - EDGE.bottom + (i % 2 ? 32 : 17)} text-anchor="middle" font-size="12">${names[i]}<title>${rung.label}</title></text>
    </g>`)}
    ${floor !== null && html`<g>
      <line x1=${EDGE.left} x2=${WIDTH - EDGE.right} y1=${y(floor)} y2=${y(floor)} stroke=${colours.floor} stroke-width="2" stroke-dasharray="7 5" />
      <text x=${WIDTH - EDGE.right} y=${y(floor) + 16} text-anchor="end" font-size="12" fill=${colours.good}>${t("workbench.ladder.floor")} ${number(floor)}</text>
    </g>`}
  </svg>`;
}

/** Change of the error on unseen data by the last step, as text. */
function Change({ before, last }) {
  if (!before || before.heldOut === null || last.heldOut === null || before.heldOutBy !== last.heldOutBy) return null;
  const percent = Math.round(100 * (last.heldOut / before.heldOut - 1));
  if (percent === 0) return html`<p class="wb-fell">${t("workbench.ladder.same")}</p>`;
  const lower = percent < 0;
  return html`<p class=${`wb-fell ${lower ? "wb-good" : "wb-bad"}`}>${lower ? "↓" : "↑"} ${" "}
    ${lower ? t("workbench.ladder.fell", { percent: -percent }) : t("workbench.ladder.rose", { percent })}</p>`;
}

/** `rungs`: [{label, inSample, heldOut, heldOutBy}] [deg/h], oldest first; `floor` [deg/h] or null. */
export function Ladder({ rungs, floor, name }) {
  const drawing = useRef(null);
  const last = rungs[rungs.length - 1];
  const before = rungs[rungs.length - 2];
  const fell = before && headline(last) !== null && headline(before) !== null && headline(last) < headline(before);
  const progress = useFall(`${rungs.length} ${last?.label}`, Boolean(fell));
  if (!last) return null;
  const recent = rungs.slice(-MOST_STEPS);
  const shown = falling(recent, progress);
  const svg = () => {
    const copy = drawing.current.cloneNode(true);
    copy.querySelector(".wb-paper").setAttribute("fill", palette().paper);
    return new XMLSerializer().serializeToString(copy);
  };
  const table = [
    ["model", "in_sample_rms_dph", "held_out_rms_dph", "noise_floor_dph"],
    ...rungs.map((rung) => [rung.label, rung.inSample, rung.heldOut, floor]),
  ];
  const tell = (rung) => t("workbench.ladder.rung", { model: rung.label, inside: number(rung.inSample), outside: number(rung.heldOut) });
  return html`<figure class="wb-figure" aria-label=${t("workbench.ladder.title")}>
    <div class="wb-ladder-frame"><${Drawing} rungs=${recent} shown=${shown} floor=${floor} refer=${drawing} /></div>
    <${Change} before=${before} last=${last} />
    <ol class="unseen">${rungs.map((rung, i) => html`<li key=${i}>${tell(rung)}</li>`)}</ol>
    <p class="wb-tools" role="group" aria-label=${t("workbench.ladder.title")}>
      <button type="button" class="narrow" onClick=${() => savePng(name, svg(), [WIDTH, HEIGHT])}>PNG</button>
      <button type="button" class="narrow" onClick=${() => saveSvg(name, svg())}>SVG</button>
      <button type="button" class="narrow" onClick=${() => saveCsv(name, table)}>CSV</button>
    </p>
  </figure>`;
}
