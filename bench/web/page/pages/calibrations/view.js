// One calibration: its steps with their states, the run that is live now, what a person has to decide, and its end.
import { html, useEffect, useRef, useState } from "../../lib/preact.js";
import { post, url } from "../../lib/api.js";
import { traces, useLive } from "../../lib/live.js";
import { useLook } from "../../lib/look.js";
import { Busy, Lamp, Shape, Trouble, Unknown } from "../../lib/parts.js";
import { may, useOutcome } from "../../lib/store.js";
import { Trace } from "../../lib/trace.js";
import { duration, moment, sign, t } from "../../lib/words.js";
import { Actions } from "../live/actions.js";
import { Temperatures } from "../live/charts.js";
import { Headline, Segments, Troubles } from "../live/run.js";
import { operatorOf, OperatorField } from "../start/operator.js";
import { ofStep, passedOver, planOf, said, stateWord, stepTone, stepWord, toneOf } from "./words.js";
import { ofPlans } from "../../lib/names.js";
import { Said } from "../../lib/said.js";
import { Signed } from "./signed.js";

const LOOK_MS = 1000;
const STOPPED = ["interrupted", "failed"];
const EMPTY = new Trace();

export function CalibrationView({ id }) {
  const { data: job, error } = useLook(`/calibrations/${id}`, LOOK_MS);
  const run = useLive((now) => now.runs.find((one) => one.run === job?.live));
  const heading = useRef(null);
  const ended = job && ["ended", "held", "failed", "interrupted"].includes(job.state);
  useEffect(() => {
    if (ended) heading.current?.focus({ preventScroll: true });
  }, [job?.state]);
  useOutcome(job ? stateWord(job) : "");
  if (!job && error?.status === 404) return html`<div class="page stack"><${Unknown} title=${id.split("/")[0]} what=${t("job.unknown", { job: id })} way="/calibrations" words=${t("nav.calibrations")} /></div>`;
  if (!job) return html`<div class="page">${error ? html`<${Trouble} error=${error} />` : html`<${Busy} />`}</div>`;
  return html`<article class="job">
    <header class=${`headline tone-${toneOf(job)}`}>
      <span class="headline-state"><${Shape} tone=${toneOf(job)} /><b>${stateWord(job)}</b></span>
      <div class="headline-what"><h1 tabindex="-1" ref=${heading}>${job.unit}</h1>
        <span class="soft">${planOf(job.plan)}${job.start ? ` · ${t("live.by", { who: job.start.who.name })}` : ""} · ${moment(job.created)}</span></div>
    </header>
    <${Trouble} error=${error} />
    <div class="job-body">
      <ol class="job-steps" aria-label=${t("job.steps")}>
        ${job.steps.map((step, index) => html`<${Step} key=${step.name} step=${step} index=${index} job=${job} />`)}
        <li class=${job.certificate ? "now" : ""}><span class=${`tone-${job.certificate ? "link" : "idle"}`}><${Shape} tone=${job.certificate ? "link" : "idle"} /></span>
          <div><h2>${t("step.print")}</h2>${job.certificate ? html`<p class="mono">${job.certificate}</p>` : html`<p class="soft">${t("step.open")}</p>`}</div></li>
      </ol>
      <div class="job-now">
        <${Together} job=${job} />
        <${Ending} job=${job} />
        ${run && html`<section class="panel several-run" aria-label=${t("nav.live")}><${Headline} run=${run} link /><${Segments} run=${run} /><${Troubles} run=${run} />
          <${Temperatures} run=${run} trace=${traces.get(run.run) ?? EMPTY} /></section>`}
        ${!run && job.state === "running" && html`<${Busy}>${t("job.works")}<//>`}
        ${job.releases.length > 0 && html`<section><h2>${t("job.releases")}</h2><ul>${job.releases.map(({ reason, held }) => html`<li key=${reason}>${reason}${sign(" (")}<${Said} text=${held} />${sign(")")}</li>`)}</ul></section>`}
      </div>
    </div>
    ${run && html`<${Actions} run=${run} />`}
  </article>`;
}

/** All units that were started together: each step's state, and how each of them stands. */
function Together({ job }) {
  if (!job.together.length) return null;
  return html`<section><h2 id="together">${t("job.together")}</h2>
    <div class="scroll" tabindex="0" role="region" aria-labelledby="together"><table class="job-list job-mates">
      <thead><tr><th scope="col">${t("job.head.unit")}</th><th scope="col">${t("job.head.state")}</th>${job.steps.map(({ name }) => html`<th key=${name} scope="col">${t(`step.name.${name}`)}</th>`)}</tr></thead>
      <tbody>${job.together.map((mate) => html`<tr key=${mate.unit} aria-current=${mate.job === job.job ? "true" : undefined}>
        <th scope="row"><a class="mono" href=${`/calibrations/${mate.job}`}>${mate.unit}</a></th>
        <td><${Lamp} tone=${toneOf(mate)}>${stateWord(mate)}<//>${mate.certificate && html` <a href=${`/api/v1/calibrations/${mate.job}/certificate`} target="_blank" rel="noopener">${t("job.print")}</a>`}</td>
        ${job.steps.map(({ name }) => {
          const step = { name, state: "open", cases: [], ...mate.steps[name] };
          return html`<td key=${name} class=${`tone-${stepTone(step, mate)}`} title=${stepWord(step, mate)}><span aria-hidden="true">${step.state === "open" ? "·" : html`<${Shape} tone=${stepTone(step, mate)} />`}</span><span class="unseen">${stepWord(step, mate)}</span></td>`;
        })}</tr>`)}</tbody></table></div></section>`;
}

const took = ({ began, ended }) => (began && ended ? duration((Date.parse(ended) - Date.parse(began)) / 1000) : "");

function Step({ step, index, job }) {
  const tone = stepTone(step, job);
  const ready = step.run && step.state === "done";
  return html`<li class=${step.state === "begun" ? "now" : ""} aria-current=${step.state === "begun" ? "step" : undefined}>
    <span class=${`tone-${tone}`}>${step.state === "open" ? html`<span class="mark">${index + 1}</span>` : step.state === "begun" && job.state === "running" ? html`<span class="spinner"></span>` : html`<${Shape} tone=${tone} />`}</span>
    <div><h2>${t(`step.name.${step.name}`)} <small class="soft">${stepWord(step, job)}${took(step) && !passedOver(step) && ` · ${took(step)}`}</small></h2>
      ${step.sentence && !passedOver(step) && html`<p class="small">${said(step) || html`<${Said} text=${step.sentence} />`}</p>`}
      ${step.facts?.warnings?.map((text) => html`<p key=${text} class="small warning"><${Said} text=${ofPlans(text)} whole names=${[job.unit]} /></p>`)}
      ${step.name === "fit" && ["FAIL", "INVALID"].includes(step.verdict) && html`<p class="small"><a href=${`/verdict/${job.steps.find(({ name }) => name === "run").run}`}>${t("job.why")}</a></p>`}
      ${ready && html`<p class="small">${step.name === "verify" ? html`<a href=${`/runs/${step.run}`}>${t("run.open")}</a>` : html`<a href=${`/workbench?run=${encodeURIComponent(step.run)}`}>${t("verdict.workbench")}</a>`}</p>`}
    </div></li>`;
}

/** What the calibration waits for, or how it ended, and the ways on. */
function Ending({ job }) {
  if (job.state === "ended") return html`<${Ended} job=${job} />`;
  if (job.state === "held") return html`<${Held} job=${job} />`;
  if (STOPPED.includes(job.state)) return html`<${Stopped} job=${job} />`;
  return job.state === "waiting" && html`<p role="status">${t("job.waits")}</p>`;
}

/** The start page with the same answers, for a calibration that begins at its first step. */
function Repeat({ job: { start } }) {
  const answers = start && new URLSearchParams({ unit: start.units.join(","), station: start.station, calibration: start.plan, anew: "true" });
  return may("operator") && start && html`<a class="button" href=${`/start?${answers}`}>${t("verdict.repeat")}</a>`;
}

function Ended({ job }) {
  return html`<section class=${`notice ${toneOf(job)}`} role="status"><p class="job-word"><${Lamp} tone=${toneOf(job)}>${stateWord(job)}<//></p>
    <p>${t(job.certificate ? "job.passed" : "job.ended")}</p><p class="small"><${Said} text=${ofStep(job)} whole names=${[job.unit]} /></p>
    ${job.certificate && html`<p class="small"><${Signed} signer=${job.steps.find(({ name }) => name === "certificate").facts.signer} /></p>`}</section>
  <div class="verdict-ways">
    ${job.certificate && html`<a class="button primary" href=${`/api/v1/calibrations/${job.job}/certificate`} target="_blank" rel="noopener">${t("job.print")}</a>`}
    ${may("operator") && html`<a class="button" href="/">${t("verdict.next_unit", { n: 1 })}</a>`}
    <${Repeat} job=${job} />
    <a class="button" href=${url`/units/${job.unit}?job=${job.job}`}>${t("verdict.unit")}</a>
  </div>`;
}

/** Ask the server to go on; its error stays in sight. */
function useGoOn(job) {
  const [now, setNow] = useState(/** @type {{busy?: boolean, error?: Error}} */ ({}));
  const go = async (more) => {
    setNow({ busy: true });
    try {
      await post(`/calibrations/${job.job}/continue`, { ...operatorOf(), ...more });
      setNow({});
    } catch (error) {
      setNow({ error });
    }
  };
  return { ...now, go, forget: () => setNow({}) };
}

function Held({ job }) {
  const { busy, error, go, forget } = useGoOn(job);
  const [reason, setReason] = useState("");
  const submit = (event) => {
    event.preventDefault();
    if (reason.trim()) go({ release: reason });
  };
  return html`<section class="notice warn" role="status"><p><strong>${t("job.held")}</strong></p><p><${Said} text=${ofStep(job)} /></p></section>
    ${may("operator") && html`<form class="stack" onSubmit=${submit}><${OperatorField} />
      <div class="field"><label for="reason">${t("job.reason")}</label><textarea id="reason" rows="3" maxlength="500" value=${reason} onInput=${(event) => setReason(event.target.value)}></textarea></div>
      <${Trouble} error=${error} forget=${forget} />
      <button type="submit" class="go" disabled=${busy || !reason.trim()}>${t("job.release")}</button></form>
      <div class="verdict-ways"><${Repeat} job=${job} /></div>`}`;
}

function Stopped({ job }) {
  const { busy, error, go, forget } = useGoOn(job);
  const all = job.together.filter(({ state }) => STOPPED.includes(state)).map(({ unit }) => unit);
  const papers = job.exit_code === 2 && job.start && job.steps.some(({ name, state }) => name === "check" && state === "failed");
  return html`<section class="notice bad" role="status"><p><strong>${t(job.state === "failed" ? `job.failed.${job.exit_code}` : "job.interrupted")}</strong></p>
      <p><${Said} text=${job.sentence ? ofStep(job) : job.start?.message} /></p></section>
    <${Trouble} error=${error} forget=${forget} />
    ${may("operator") && html`<div class="verdict-ways">
      ${job.start && html`<button type="button" class="go" disabled=${busy} onClick=${() => go({})}>${t("job.go_on")}${all.length > 1 && `${sign(": ")}${all.join(", ")}`}</button>`}
      ${papers && html`<a class="button" href=${`/laboratory?station=${encodeURIComponent(job.start.station)}`}>${t("papers.title")}</a>`}
      <${Repeat} job=${job} />
      <a class="button" href="/">${t("verdict.next_unit", { n: 1 })}</a></div>`}`;
}
