// The figures of the chosen runs: one at a time, under tabs. Zooming in time or temperature fetches finer data.
import { html, t, useEffect, useRef, useState } from "./parts.js";
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
  partial: t("workbench.figure.partial"),
});
const HOUR_S = 3600;
const ZOOM_PAUSE_MS = 250;
const WIDTHS = [400, 800, 1200, 1600, 2400];

/** Number of points worth fetching for an element so wide; in steps, so that answers can be kept. */
const pointsFor = (element) => WIDTHS.find((width) => width >= (element?.clientWidth || 800)) ?? WIDTHS[WIDTHS.length - 1];

/** A figure with its words, keys and files. `figure`: {figure, words, csv}; `onZoom(range|null)`. */
export function Picture({ answer, name, title, running, onZoom, keep }) {
  const place = useRef(null);
  const drawn = useRef(null);
  const [failed, setFailed] = useState("");
  const tell = useRef(onZoom);
  tell.current = onZoom;
  useEffect(() => {
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
    <div class="wb-picture ${running ? "wb-busy" : ""}" aria-busy=${running ? "true" : "false"}>
      <div class="wb-plot" ref=${place} tabindex="0" role="group" aria-roledescription=${t("workbench.figure.role")} aria-label=${`${title}. ${t("workbench.figure.keys")}`} onKeyDown=${key}></div>
      ${none && html`<p class="wb-veil" role="status"><span class="wb-pulse" aria-hidden="true"></span>${t("workbench.figure.waiting")}</p>`}
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

function Tabs({ kinds, kind, onKind }) {
  const words = TABS();
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

/** Range of x as the API's from_s and to_s. */
const spanOf = (range) => (range ? { from_s: Math.max(0, range[0] * HOUR_S), to_s: range[1] * HOUR_S } : {});

/** Figures of `runs` {runs, check, static} under `model`; `partial` is the suspect whose picture is asked for. */
export function Pictures({ runs, model, partial, onPartialOff }) {
  const [kind, setKind] = useState("time");
  const [span, setSpan] = useState({});
  const frame = useRef(null);
  const timer = useRef(0);
  const shown = partial ? "partial" : kind;
  const zoomable = shown === "time";
  const body = partial ? null : { kind, ...runs, model, ...(zoomable ? span : {}), width: pointsFor(frame.current) };
  const job = useJob("/figures", body);
  const lastKind = useRef(shown);
  const whole = useRef(body && JSON.stringify([kind, runs]));
  useEffect(() => setSpan({}), [runs, kind]);
  const zoom = (range) => {
    if (!zoomable) return;
    clearTimeout(timer.current);
    timer.current = setTimeout(() => setSpan(spanOf(range)), ZOOM_PAUSE_MS);
  };
  useEffect(() => () => clearTimeout(timer.current), []);
  // A figure of another kind must not be seen under this tab's name, not even while its own is on the way.
  const key = partial ? `partial ${partial.effect}` : JSON.stringify([kind, runs]);
  const stays = whole.current === key || lastKind.current === shown;
  const latest = useRef({ key: null, answer: null });
  if (partial) latest.current = { key, answer: { figure: partial.partial.figure ?? partial.partial, words: partial.partial.words ?? partial.why ?? "", csv: partial.partial.csv ?? csvOf(partial.partial.figure ?? partial.partial) } };
  else if (job.result) latest.current = { key, answer: job.result };
  const answer = latest.current.key === key ? latest.current.answer : null;
  whole.current = key;
  lastKind.current = shown;
  const words = TABS();
  const pick = (next) => {
    if (partial) onPartialOff();
    if (next !== "partial") setKind(next);
  };
  const title = partial ? `${words.partial}: ${partial.effect}` : words[kind];
  return html`<section class="wb-card wb-pictures" ref=${frame} aria-label=${t("workbench.figure.title")}>
    <${Tabs} kinds=${partial ? [...KINDS, "partial"] : KINDS} kind=${shown} onKind=${pick} />
    <div id="wb-panel" role="tabpanel" aria-labelledby=${`wb-tab-${shown}`}>
      ${job.failed && html`<p class="wb-bad" role="alert">${job.failed}</p>`}
      <${Picture} key=${shown === "partial" ? "partial" : kind} answer=${answer} running=${job.running} title=${title} onZoom=${zoom} keep=${stays}
        name=${`${runs.runs[0]} ${model.name} ${shown}`} />
    </div>
  </section>`;
}

/** The points of a figure's lines as rows, where the server sent no table. */
export function csvOf(figure) {
  const rows = [["trace", "x", "y"]];
  for (const trace of figure.data) (trace.x ?? []).forEach((x, i) => rows.push([trace.name ?? "", x, trace.y?.[i]]));
  return rows;
}
