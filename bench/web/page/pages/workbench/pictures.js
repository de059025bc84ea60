// The figures of the chosen runs: one at a time, under tabs. Zooming in time or temperature fetches finer data.
import { Waiting, duration, html, number, runTitle, t, unitOf, useEffect, useMemo, useLayoutEffect, useRef, useState } from "./parts.js";
import { haunted } from "./ghost.js";
import { momentOf, placeOf, pointed } from "./moment.js";
import { useJob } from "./session.js";
import { quantity } from "./sentence.js";
import { symbols } from "../../lib/words.js";
import { caption, spoken } from "../../lib/spoken.js";
import { saveCsv } from "../../lib/download.js";
import { useDrawn } from "../../lib/drawn.js";
import { Said } from "../../lib/said.js";

const KINDS = ["time", "temperature", "map", "loop", "axes", "allan", "channels"];
const TABS = () => ({
  time: t("workbench.figure.time"),
  temperature: t("workbench.figure.temperature"),
  map: t("workbench.figure.map"),
  loop: t("workbench.figure.loop"),
  axes: t("workbench.figure.axes"),
  allan: t("workbench.figure.allan"),
  channels: t("workbench.figure.channels"),
});
/** Figures with a residual. */
const RESIDUALS = ["time", "temperature", "loop", "axes"];
/** In the place of a run: all of them in one figure. */
const EVERY = "all";
const HOUR_S = 3600;
const ZOOM_PAUSE_MS = 250;
const WIDTHS = [400, 800, 1200, 1600, 2000];

/** Number of points to fetch for the width of an element; in steps, so that answers can be cached. */
const pointsFor = (element) => WIDTHS.find((width) => width >= (element?.clientWidth || 800)) ?? WIDTHS[WIDTHS.length - 1];

/** A figure with its words, keys and files. `answer`: {figure, words, csv}; `job` computes it; `onZoom(range|null)`; `range` of x to begin with. */
export function Picture({ answer, job = null, name, title, onZoom, onPoint = null, keep, range = null, mark = null }) {
  const { place, onKeyDown, failed, reset, save } = useDrawn(answer, (one) => spoken(one.figure), { onZoom, onPoint }, { keep, range, mark });
  const none = !answer;
  const running = Boolean(job?.running);
  return html`<figure class="wb-figure">
    <div class=${`wb-picture ${none ? "wb-none" : running ? "wb-busy" : ""}`} aria-busy=${running ? "true" : "false"}>
      <div class="wb-plot" ref=${place} tabindex="0" role="group" aria-roledescription=${t("workbench.figure.role")} aria-label=${`${title}. ${t("workbench.figure.keys")}`} onKeyDown=${onKeyDown}></div>
      ${none && job && html`<div class="wb-veil"><${Waiting} job=${job}>${t("workbench.figure.waiting")}<//></div>`}
    </div>
    <figcaption>
      <p class="wb-words">${failed ? html`<span class="wb-bad"><${Said} text=${failed} /></span>` : answer ? caption(answer) : ""}</p>
      <p class="wb-tools">
        <button type="button" class="narrow" disabled=${none} onClick=${reset}>${t("workbench.figure.reset")}</button>
        <button type="button" class="narrow" disabled=${none} onClick=${() => save("PNG", name)}>PNG</button>
        <button type="button" class="narrow" disabled=${none} onClick=${() => save("SVG", name)}>SVG</button>
        ${answer?.csv && html`<button type="button" class="narrow" onClick=${() => saveCsv(name, answer.csv)}>CSV</button>`}
      </p>
    </figcaption>
  </figure>`;
}

function Tabs({ kinds, words, kind, onKind }) {
  const bar = useRef(null);
  const key = (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = kinds[(kinds.indexOf(kind) + step + kinds.length) % kinds.length];
    event.preventDefault();
    onKind(next);
    bar.current.querySelector(`[data-kind="${next}"]`).focus();
  };
  return html`<div class="wb-tabs" role="tablist" aria-label=${t("workbench.figure.title")} ref=${bar} onKeyDown=${key}>
    ${kinds.map((one) => html`<button type="button" role="tab" key=${one} id=${`wb-tab-${one}`} data-kind=${one} aria-controls="wb-panel"
      aria-selected=${one === kind ? "true" : "false"} tabindex=${one === kind ? 0 : -1} onClick=${() => onKind(one)}>${words[one]}</button>`)}
  </div>`;
}

/** What the abscissa of a figure is, where its range is a selection that holds in the other figures, too. */
const AXES = { time: "h", temperature: "degC", loop: "degC" };
const BOTH = ["h", "degC"];
/** Selections that a figure heeds. */
const HEEDS = { time: ["h"], temperature: BOTH, loop: BOTH, axes: BOTH };
/** The same for the free abscissa: that of no other figure has its own name. */
const FREE = { time: "h", temperature: "degC" };

/** The selection of an address, `h:1,2`, `degC:-10,20` or that of another quantity, `dT_dt:-1,1`; null without one. */
function selectionOf(zoom) {
  const [axis, ends = ""] = zoom.split(":");
  const range = ends.split(",").map(Number);
  return axis && range.length === 2 && range.every(Number.isFinite) ? { axis, range } : null;
}

/** A selection in the form of the API. */
function spanOf(selection) {
  if (!BOTH.includes(selection?.axis)) return {};
  const [low, high] = selection.range;
  return selection.axis === "h" ? { from_s: Math.max(0, low * HOUR_S), to_s: high * HOUR_S } : { from_degc: low, to_degc: high };
}

/** A selection, `heeded` by this figure or not. */
function Selection({ selection, heeded, act }) {
  const range = `${selection.range.map((end) => number(end)).join(" … ")} ${symbols(selection.axis)}`;
  return html`<span class="wb-chip">${t(heeded ? "workbench.figure.only" : "workbench.figure.whole", { range })} <button type="button" class="wb-x" aria-label=${t("workbench.figure.reset")} onClick=${() => act({ type: "zoom", zoom: "" })}>×</button></span>`;
}

/** Choice of the drawn run, of bias or residual in the loop, of the abscissa. */
function Choices({ session, kind, of, axes }) {
  const { runs, over, left, act } = session;
  const all = [...runs.runs, ...runs.check];
  const units = new Set(all.map(unitOf));
  const titled = (run) => (units.size > 1 ? `${unitOf(run)} ${runTitle(run)}` : runTitle(run));
  const view = (change) => act({ type: "view", view: change });
  return html`<div class="wb-choices">
    ${all.length > 1 && kind !== "allan" && html`<label class="wb-inline"><span class="unseen">${t("workbench.figure.shown")}</span>
      <select value=${of} onChange=${(event) => view({ of: event.target.value })}>
        ${kind === "axes" && html`<option value=${EVERY} selected=${of === EVERY}>${t("workbench.figure.all_runs")}</option>`}
        ${all.map((run) => html`<option key=${run} value=${run} selected=${run === of}>${titled(run)}${runs.check.includes(run) ? ` (${t("workbench.role.check")})` : ""}</option>`)}
      </select></label>`}
    ${kind === "loop" && html`<label class="wb-inline"><input type="checkbox" checked=${left !== ""} onChange=${(event) => view({ left: event.target.checked ? "yes" : "" })} />${t("workbench.figure.left")}</label>`}
    ${kind === "axes" && html`<label class="wb-inline">${t("workbench.figure.over")}
      <select value=${over} onChange=${(event) => view({ over: event.target.value })}>
        ${[...new Set([over, ...axes])].map((name) => html`<option key=${name} value=${name} selected=${name === over}>${quantity(name)}</option>`)}
      </select></label>`}
  </div>`;
}

/** The moment that the mouse points at, for the other figures: {mark, onPoint, told}. `answer` is of the run `of`, or has several in its table. */
export function linked(view, kind, answer, of) {
  const moment = pointed.get();
  const several = answer?.csv?.[0]?.[0] === "run";
  const mark = answer && moment && moment.view !== view && (several || moment.of === of) ? placeOf(kind, answer.csv, moment.time_s, moment.of) : null;
  const onPoint = (point) => {
    const run = several ? point.data.legendgroup : of;
    const time_s = answer ? momentOf(kind, answer.csv, point, run) : null;
    if (time_s !== null) pointed.set({ of: run, view, time_s });
  };
  const told = mark !== null && html`<p class="wb-soft">┊ ${t("workbench.figure.moment", { time: duration(moment.time_s) })}${several ? ` ${runTitle(moment.of)}` : ""}</p>`;
  return { mark, onPoint, told };
}

/** Figures of the session's runs under its model; `picked` {id, title, answer} is a figure of the diagnosis that replaces them; `once` drops a message told elsewhere. */
export function Pictures({ session, picked, once }) {
  const { runs, model, before, over, left, zoom, act } = session;
  const kind = KINDS.includes(session.figure) ? session.figure : KINDS[0];
  const frame = useRef(null);
  const timer = useRef(0);
  const told = useRef("");
  const axes = useRef([]);
  const all = [...runs.runs, ...runs.check];
  const every = kind === "axes" && session.of === EVERY && all.length > 1;
  const of = every || all.includes(session.of) ? session.of : runs.runs[0];
  const selection = selectionOf(zoom);
  const axis = kind === "axes" ? FREE[over] ?? over : AXES[kind];
  const heeded = selection && (selection.axis === axis || HEEDS[kind]?.includes(selection.axis)) ? selection : null;
  const range = heeded && heeded.axis === axis ? heeded.range : null;
  // The same figure keeps its zoom while finer data arrive and while the model changes.
  const what = picked ? `picked ${picked.id}` : JSON.stringify([kind, of, left, over, runs]);
  const bodyOf = (fitted) => ({ kind, ...runs, of: every ? null : of, every, over, model: fitted, ...spanOf(heeded), width: pointsFor(frame.current) });
  // Its width is known when it stands there; what is asked before would be asked again.
  const [stands, setStands] = useState(false);
  useLayoutEffect(() => setStands(true), []);
  const job = useJob("/figures", picked || !stands ? null : bodyOf(kind === "loop" && !left ? null : model));
  const ghost = useJob("/figures", !picked && stands && before && !every && RESIDUALS.includes(kind) && (left || kind !== "loop") ? bodyOf(before) : null).result;
  const last = useRef({ what: null, zoom: "", answer: null });
  // A range that the figure has not told is one of the address: of a link, back or forward.
  const keep = last.current.what === what && (zoom === last.current.zoom || zoom === told.current);
  const fresh = picked?.answer ?? job.result;
  const drawn = useMemo(() => (fresh && ghost ? { ...fresh, figure: haunted(fresh.figure, ghost.figure) } : fresh), [fresh, ghost]);
  if (drawn) last.current = { what, zoom, answer: drawn };
  if (fresh?.axes) axes.current = fresh.axes;
  // A figure of another kind must not be shown under this tab, even while its own figure is loading.
  const answer = last.current.what === what ? last.current.answer : null;
  useEffect(() => () => clearTimeout(timer.current), []);
  const onZoom = (next) => {
    clearTimeout(timer.current);
    if (picked || (next && !axis)) return;
    told.current = next ? `${axis}:${next.map((end) => Number(end.toPrecision(8))).join()}` : "";
    timer.current = setTimeout(() => act({ type: "zoom", zoom: told.current }), ZOOM_PAUSE_MS);
  };
  const { mark, onPoint, told: moment } = linked(`${kind} ${kind === "axes" ? over : ""} ${every}`, kind, picked ? null : answer, of);
  const words = { ...TABS(), picked: picked?.title };
  const shown = picked ? "picked" : kind;
  const title = words[shown];
  return html`<section class="wb-card wb-pictures" ref=${frame} aria-label=${t("workbench.figure.title")}>
    <div class="wb-head">
      <${Tabs} kinds=${picked ? [...KINDS, "picked"] : KINDS} words=${words} kind=${shown} onKind=${(next) => next !== "picked" && act({ type: "view", view: { figure: next } })} />
      ${!picked && html`<${Choices} session=${session} kind=${kind} of=${of} axes=${axes.current} />`}</div>
    <div id="wb-panel" role="tabpanel" aria-labelledby=${`wb-tab-${shown}`}>
      ${once(job.failed) && html`<p class="wb-bad" role="alert"><${Said} text=${job.failed} /></p>`}
      ${!picked && BOTH.includes(selection?.axis) && (!range || job.failed) && html`<p><${Selection} selection=${selection} heeded=${heeded} act=${act} /></p>`}
      ${answer?.note && html`<p class="wb-warn" role="alert">${once(answer.note) ? html`${t("workbench.figure.bare")} <${Said} text=${answer.note} />` : t("workbench.figure.bare_only")}</p>`}
      ${moment}
      <${Picture} answer=${answer} job=${job} title=${title} onZoom=${onZoom} keep=${keep} range=${picked ? null : range} onPoint=${onPoint} mark=${mark}
        name=${`${of} ${model.name} ${shown}`} />
    </div>
  </section>`;
}
