// Actions on a live run. Abort needs a confirmation; "keep running" has the focus, and Escape keeps the run.
import { html, useEffect, useRef, useState } from "../../lib/preact.js";
import { post, url } from "../../lib/api.js";
import { Dialog, Trouble } from "../../lib/parts.js";
import { may } from "../../lib/store.js";
import { sign, t } from "../../lib/words.js";
import { operatorOf } from "../start/operator.js";
import { GoOn, isResumed } from "./resume.js";
import { isOld } from "./words.js";

const POSSIBLE = { running: ["hold", "pause"], pausing: ["hold", "resume"], holding: ["resume"] };
const SIGNS = {
  hold: html`<path d="M8 5v14M16 5v14" />`,
  pause: html`<path d="M6 6v12M11 6v12" /><path d="M16 6l4 6-4 6" />`,
  resume: html`<path d="M7 5l12 7-12 7z" />`,
  abort: html`<path d="M8 3h8l5 5v8l-5 5H8l-5-5V8z" />`,
};
const Sign = ({ action }) => html`<svg class="sign" viewBox="0 0 24 24" aria-hidden="true">${SIGNS[action]}</svg>`;

/** What goes on now, and what a hold does to the segment. */
const note = ({ state, segment }) => [
  state === "pausing" && t("actions.pausing"), state === "holding" && t("actions.holding"),
  segment?.anew && state === "holding" && t("actions.anew"), segment?.anew && state === "running" && t("actions.would_anew"),
].filter(Boolean).join(sign("; "));

export function Actions({ run }) {
  const [requested, setRequested] = useState("");
  const [error, setError] = useState(null);
  const [sure, setSure] = useState(false);
  useEffect(() => {
    setRequested((action) => (action.startsWith("abort") ? action : ""));
    if (run.state === "ending") setError(null); // whatever was not known of an abort, it has arrived
  }, [run.state]);
  if (!may("operator")) return null;
  const ask = async (action) => {
    setRequested(action);
    setError(null);
    const [unit, folder] = run.run.split("/");
    try {
      await post(url`/live/${unit}/${folder}/${action}`, operatorOf());
      setRequested(action === "abort" ? "aborted" : "");
    } catch (problem) {
      // Whether an abort arrived is not known without an answer: the person must go to the equipment.
      setError(action === "abort" && (problem.status === 0 || problem.status >= 500) ? t("abort.offline") : problem);
      setRequested("");
    }
  };
  const reached = run.condition !== "gone";
  const ending = requested === "aborted" || run.state === "ending";
  const aborting = ending || requested === "abort";
  return html`<div class="actions" role="group" aria-label=${t("actions.label")}>
    <${Trouble} error=${error ?? (aborting && !ending && isOld(run) && t("abort.offline"))} forget=${() => setError(null)} />
    ${isResumed(run) ? html`<${GoOn} run=${run.run} />` : html`<div class="actions-row">
      ${!aborting && (POSSIBLE[run.state] ?? []).map((action) => html`
        <button type="button" key=${action} class=${action === "resume" ? "go" : ""} disabled=${!reached || requested !== ""} onClick=${() => ask(action)}>
          <${Sign} action=${action} /> ${t(action === "resume" && run.state === "pausing" ? "actions.go_on" : `actions.${action}`)}</button>`)}
      <span class="actions-gap soft">${aborting ? t(ending ? "actions.ending" : "actions.asked") : note(run)}</span>
      <button type="button" class="stop" disabled=${!reached || aborting} onClick=${() => setSure(true)}><${Sign} action="abort" /> ${t("actions.abort")}</button>
    </div>`}
    ${sure && html`<${Sure} run=${run} close=${() => setSure(false)} abort=${() => {
      setSure(false);
      ask("abort");
    }} />`}
  </div>`;
}

function Sure({ run, close, abort }) {
  const keep = useRef(null);
  useEffect(() => keep.current.focus(), []);
  return html`<${Dialog} label=${t("abort.question")} onClose=${close}>
    <h2>${t("abort.question")}</h2>
    <p>${t(run.job ? "abort.consequence_job" : "abort.consequence")}</p>
    ${run.units?.length > 1 && html`<p><strong>${t("abort.all", { n: run.units.length })}</strong></p>`}
    <div class="dialog-row">
      <button type="button" ref=${keep} onClick=${close}>${t("abort.keep")}</button>
      <button type="button" class="stop" onClick=${abort}>${t("abort.abort")}</button>
    </div>
  <//>`;
}
