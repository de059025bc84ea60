// Components shared by the pages of units, fleet and imports.
import { html, useEffect, useState } from "../../lib/preact.js";
import { get } from "../../lib/api.js";
import { Lamp } from "../../lib/parts.js";
import { or, sig, t } from "../../lib/words.js";
import { analysed, outcomeWord, toneOf } from "../verdict/judged.js";

const AGAIN_MS = 5000;

/**
 * The answer of GET `path` as {data, error, busy}, and `again` to repeat it; older data is shown while newer is fetched.
 * An answer that is not `current` is fetched again.
 */
export function useGet(path) {
  const [state, setState] = useState(/** @type {{data?: any, error?: any, busy: boolean}} */ ({ busy: true }));
  const [turn, setTurn] = useState(0);
  useEffect(() => {
    if (path === null) return undefined;
    const stop = new AbortController();
    setState((now) => ({ ...now, busy: true, error: null }));
    get(path, { signal: stop.signal }).then(
      (data) => setState({ data, busy: false }),
      (error) => error.name !== "AbortError" && setState({ error, busy: false }),
    );
    return () => stop.abort();
  }, [path, turn]);
  const again = () => setTurn((count) => count + 1);
  useEffect(() => {
    if (state.data?.current !== false) return undefined;
    const timer = setTimeout(again, AGAIN_MS);
    return () => clearTimeout(timer);
  }, [state.data]);
  return { ...state, again };
}

/** The first of a long list of `of`, and a button that shows so many more of them; `ask(n)` gets those that are not here. */
export function useFirst(list, many, of, ask) {
  const [most, setMost] = useState(many);
  const further = () => {
    setMost(most + many);
    if (most + many > list.length && list.length < of) ask(most + many);
  };
  const more = of > most && html`<p><button type="button" onClick=${further}>${t("units.more")}</button></p>`;
  return { first: list.slice(0, most), more };
}

const STATES = { done: toneOf("measured"), running: "link", aborted: toneOf("aborted"), failed: "bad" };

/** A verdict or a status in colour, shape and word. */
export const Verdict = ({ word }) => word && html`<${Lamp} tone=${toneOf(word)}>${outcomeWord(word)}<//>`;

/** Result of a run: its verdict against limits, else that of the analysis, else its state. */
export function Outcome({ run }) {
  const word = run.judged ?? analysed(run.verdict, run.judged);
  if (run.state && (run.state !== "done" || !word)) return html`<${Lamp} tone=${STATES[run.state] ?? "warn"}>${or(`units.state.${run.state}`, run.state)}<//>`;
  return html`<${Verdict} word=${word} />`;
}

/** A small chart in a table; limits dashed, the last value a dot. */
export function Spark({ values, lower, upper }) {
  if (values.length < 2) return html`<span class="soft" aria-hidden="true">·</span>`;
  const inside = [lower, upper].filter((end) => end !== null && end !== undefined);
  const size = Math.max(...values.map(Math.abs));
  const near = inside.filter((end) => Math.abs(end) < 6 * size);
  const middle = (Math.min(...values) + Math.max(...values)) / 2;
  // The height is at least a tenth of the value, so that small changes do not look like a slope.
  const low = Math.min(...values, ...near, middle - 0.1 * size);
  const high = Math.max(...values, ...near, middle + 0.1 * size);
  const x = (i) => 3 + (114 * i) / (values.length - 1);
  const y = (value) => 25 - 22 * ((value - low) / (high - low || 1));
  const points = values.map((value, i) => `${x(i).toFixed(1)},${y(value).toFixed(1)}`).join(" ");
  return html`<svg class="st-spark" viewBox="0 0 120 28" aria-hidden="true">
    ${near.map((end) => html`<line class="limit" x1="0" x2="120" y1=${y(end)} y2=${y(end)} />`)}
    <polyline points=${points} /><circle cx=${x(values.length - 1)} cy=${y(values[values.length - 1])} r="3" />
  </svg>`;
}

/** One number on a card: name, value and meaning; a day may be broken between its parts. */
export const Tile = ({ what, value, unit, more, tone }) => html`<div class=${`st-tile ${tone ? `tone-${tone}` : ""}`}>
  <span class="what">${what}</span><b>${String(value).replaceAll("\u00a0", " ").replace("年", "年\u200b")} ${unit && value !== "–" && html`<small>${unit}</small>`}</b>${more && html`<span class="more">${more}</span>`}
</div>`;

/** Shown without a registry: an explanation, and a button for users who may create one. */
export function NoRegistry({ build, busy, may }) {
  return html`<div class="panel stack">
    <h2>${t("units.none.title")}</h2><p>${t("units.none.text")}</p>
    ${!may && html`<p>${t("units.none.engineer")}</p>`}
    ${may && html`<button class="primary" disabled=${busy} onClick=${build}>${t(busy ? "units.none.busy" : "units.none.build")}</button>`}
  </div>`;
}

/** Where the verdict of a run is. */
export const verdictPlace = (run) => `/verdict/${run.split("/").map(encodeURIComponent).join("/")}`;

/** Every point of a chart as a row, for keys and readers: [run, what it is, value]; its run opens. */
export const Points = ({ rows }) => html`<details><summary>${t("units.points", { n: rows.length })}</summary>
  <div class="scroll st-scroll"><table><thead><tr><th scope="col">${t("units.point")}</th><th scope="col" class="n">${t("verdict.head.value")}</th></tr></thead>
  <tbody>${[...rows].reverse().map(([run, what, value]) => html`<tr key=${run}><th scope="row"><a href=${verdictPlace(run)}>${what ?? run}</a></th><td class="n">${sig(value)}</td></tr>`)}</tbody></table></div></details>`;
