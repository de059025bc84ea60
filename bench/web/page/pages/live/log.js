// What has happened in a live run: segments, requests, guards, holds, each with its time.
import { html, useEffect, useState } from "../../lib/preact.js";
import { get, url } from "../../lib/api.js";
import { duration, moment, number, or, sign, t } from "../../lib/words.js";
import { segmentText } from "./words.js";
import { Said } from "../../lib/said.js";

const AGAIN_MS = 5000;

/** The events of a run, fetched when its state changes and every few seconds. */
function useEvents(run) {
  const [events, setEvents] = useState([]);
  const state = JSON.stringify([run.run, run.state, run.segment?.index, run.holding, (run.guards ?? []).map((guard) => guard.state)]);
  useEffect(() => {
    const [unit, folder] = run.run.split("/");
    const look = () => get(url`/live/${unit}/${folder}/events`).then((seen) => setEvents(seen.events), () => {}); // between two runs there is none
    look();
    const timer = setInterval(look, AGAIN_MS);
    return () => clearInterval(timer);
  }, [state]);
  return events;
}

/** An event as text. */
function What({ event: { kind, phase, segment, text } }) {
  if (kind === "segment" && segment && (phase === "start" || segment.outcome === "done")) return html`${phase === "start" ? "▶" : "✓"} ${segmentText(segment)}`;
  if (segment?.outcome === "held") return html`${segmentText(segment)}${sign(": ")}<${Said} text="held" />`;
  return html`<${Said} text=${text} />`;
}

/** What a decision about the end of the run rests on: the error to be expected of each unit, beside the limit. */
const Figures = ({ event: { units, limit_dph: limit } }) => html`<ul class="figures soft">${Object.entries(units).map(
  ([unit, { error_dph: error, low_dph: low, high_dph: high, seen }]) => html`<li key=${unit}>${t("live.expected", {
    unit, error: number(error, 3), low: number(low, 3), high: number(high, 3), limit: number(limit, 3), seen: number(100 * seen, 0),
  })}</li>`)}</ul>`;

export function Log({ run }) {
  const events = useEvents(run);
  return html`<section class="panel log" aria-labelledby="log-title"><h2 id="log-title">${t("live.log")}</h2>
    <ol tabindex="0" aria-labelledby="log-title">${events.map((event) => html`<li key=${`${event.t_s} ${event.kind} ${event.text}`} class=${event.kind}>
      <span class="figures soft" title=${moment(event.utc)}>${duration(event.t_s)}</span>
      <span><b>${or(`live.event.${event.kind}`, event.kind.replaceAll("_", " "))}</b> <${What} event=${event} />
      ${event.units && html`<${Figures} event=${event} />`}</span></li>`)}</ol>
  </section>`;
}
