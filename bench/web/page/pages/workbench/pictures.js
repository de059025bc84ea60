// The figures of the chosen runs: one at a time, under tabs. Zooming in time or temperature fetches finer data.
import { html, runName, t, useEffect, useLayoutEffect, useRef, useState } from "./parts.js";
import { useJob } from "./session.js";
import { Drawn, saveCsv } from "../../lib/figure.js";

const KINDS = ["time", "temperature", "map", "loop", "allan", "channels"];
const TABS = () => ({
  time: t("workbench.figure.time"),
  temperature: t("workbench.figure.temperature"),
  map: t("workbench.figure.map"),
  loop: t("workbench.figure.loop"),
  allan: t("workbench.figure.allan"),
  channels: t("workbench.figure.channels"),
});
const HOUR_S = 3600;
const ZOOM_PAUSE_MS = 250;
const WIDTHS = [400, 800, 1200, 1600, 2000];

/** Number of points to fetch for the width of an element; in steps, so that answers can be cached. */
const pointsFor = (element) => WIDTHS.find((width) => width >= (element?.clientWidth || 800)) ?? WIDTHS[WIDTHS.length - 1];

/** A figure with its words, keys and files. `figure`: {figure, words, csv}; `onZoom(range|null)`. */
export function Picture({ answer, name, title, running, waiting, onZoom, keep }) {
  const place = useRef(null);
  const drawn = useRef(null);
  const [failed, setFailed] = useState("");
  const tell = useRef(onZoom);
  tell.current = onZoom;
  useLayoutEffect(() => {
    drawn.current = new Drawn(place.current, (range) => tell.current?.(range));
    return () => drawn.current.end();
  }, []);
  useEffect(() => {
    if (!answer) return;
    drawn.current.show(answer.figure, keep).then(() => setFailed(""), (error) => setFailed(error.message));
  }, [answer]);
  const key = (event) => {
    if (!event.ctrlKey && !event.metaKey && !event.altKey && drawn.current.key(event.key)) event.preventDefault();
  };
  const save = (kind) => drawn.current.save(kind, name).catch((error) => setFailed(error.message));
  const none = !answer;
  return html`<figure class="wb-figure">
    <div class=${`wb-picture ${none ? "wb-none" : running ? "wb-busy" : ""}`} aria-busy=${running ? "true" : "false"}>
      <div class="wb-plot" ref=${place} tabindex="0" role="group" aria-roledescription=${t("workbench.figure.role")} aria-label=${`${title}. ${t("workbench.figure.keys")}`} onKeyDown=${key}></div>
      ${waiting && html`<p class="wb-veil" role="status"><span class="wb-pulse" aria-hidden="true"></span>${t("workbench.figure.waiting")}</p>`}
    </div>
    <figcaption>
      <p class="wb-words" lang="en">${failed ? html`<span class="wb-bad">${failed}</span>` : answer?.words ?? ""}</p>
      <p class="wb-tools">
        <button type="button" class="narrow" disabled=${none} onClick=${() => drawn.current.reset()}>${t("workbench.figure.reset")}</button>
        <button type="button" class="narrow" disabled=${none} onClick=${() => save("PNG")}>PNG</button>
        <button type="button" class="narrow" disabled=${none} onClick=${() => save("SVG")}>SVG</button>
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

/** Range of x in the form of the API; figures over other quantities are always complete. */
function spanOf(kind, range) {
  if (!range) return {};
  if (kind === "time") return { from_s: Math.max(0, range[0] * HOUR_S), to_s: range[1] * HOUR_S };
  return kind === "temperature" || kind === "loop" ? { from_degc: range[0], to_degc: range[1] } : {};
}

/** Choice of the drawn run, and of bias or residual in the loop. */
function Choices({ runs, kind, of, onOf, left, onLeft }) {
  const all = [...runs.runs, ...runs.check];
  return html`<div class="wb-choices">
    ${all.length > 1 && kind !== "allan" && html`<label class="wb-inline"><span class="unseen">${t("workbench.figure.shown")}</span>
      <select value=${of} onChange=${(event) => onOf(event.target.value)}>
        ${all.map((run) => html`<option key=${run} value=${run} selected=${run === of}>${runName(run)}${runs.check.includes(run) ? ` (${t("workbench.role.check")})` : ""}</option>`)}
      </select></label>`}
    ${kind === "loop" && html`<label class="wb-inline"><input type="checkbox" checked=${left} onChange=${(event) => onLeft(event.target.checked)} />${t("workbench.figure.left")}</label>`}
  </div>`;
}

/** Figures of `runs` {runs, check, static} under `model`; `picked` {id, title, answer} is a figure of the diagnosis that replaces them. */
export function Pictures({ runs, model, picked, onPickedOff }) {
  const [kind, setKind] = useState("time");
  const [asked, setOf] = useState(null);
  const [left, setLeft] = useState(false);
  const [zoomed, setZoomed] = useState({ what: null, span: {} });
  const frame = useRef(null);
  const timer = useRef(0);
  const of = [...runs.runs, ...runs.check].includes(asked) ? asked : runs.runs[0];
  // The same figure keeps its zoom while finer data arrive and while the model changes.
  const what = picked ? `picked ${picked.id}` : JSON.stringify([kind, of, left, runs]);
  const span = zoomed.what === what ? zoomed.span : {};
  const body = picked ? null : { kind, ...runs, of, model: kind === "loop" && !left ? null : model, ...span, width: pointsFor(frame.current) };
  const job = useJob("/figures", body);
  const last = useRef({ what: null, answer: null });
  const keep = last.current.what === what;
  const fresh = picked?.answer ?? job.result;
  if (fresh) last.current = { what, answer: fresh };
  // A figure of another kind must not be shown under this tab, even while its own figure is loading.
  const answer = last.current.what === what ? last.current.answer : null;
  useEffect(() => () => clearTimeout(timer.current), []);
  const zoom = (range) => {
    const next = spanOf(kind, range);
    if (picked || (range && !Object.keys(next).length)) return;
    clearTimeout(timer.current);
    timer.current = setTimeout(() => setZoomed({ what, span: next }), ZOOM_PAUSE_MS);
  };
  const words = { ...TABS(), picked: picked?.title };
  const shown = picked ? "picked" : kind;
  const pick = (next) => {
    if (next === "picked") return;
    if (picked) onPickedOff();
    setKind(next);
  };
  const title = words[shown];
  return html`<section class="wb-card wb-pictures" ref=${frame} aria-label=${t("workbench.figure.title")}>
    <div class="wb-head">
      <${Tabs} kinds=${picked ? [...KINDS, "picked"] : KINDS} words=${words} kind=${shown} onKind=${pick} />
      ${!picked && html`<${Choices} runs=${runs} kind=${kind} of=${of} onOf=${setOf} left=${left} onLeft=${setLeft} />`}</div>
    <div id="wb-panel" role="tabpanel" aria-labelledby=${`wb-tab-${shown}`}>
      ${job.failed && html`<p class="wb-bad" role="alert">${job.failed}</p>`}
      ${answer?.note && html`<p class="wb-warn" role="alert">${t("workbench.figure.bare")} <span lang="en">${answer.note}</span></p>`}
      <${Picture} answer=${answer} running=${job.running} waiting=${job.running && !answer} title=${title} onZoom=${zoom} keep=${keep}
        name=${`${of} ${model.name} ${shown}`} />
    </div>
  </section>`;
}
