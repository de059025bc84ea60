// One ended run: what the commands do with it. Export, replay, certificate, difference; flash and verify its unit.
import { html, useEffect, useRef, useState } from "../lib/preact.js";
import { finished, post, remove, url } from "../lib/api.js";
import { Busy, Lamp, Trouble, Unknown } from "../lib/parts.js";
import { navigate } from "../lib/router.js";
import { startAct, startRun } from "../lib/starts.js";
import { may } from "../lib/store.js";
import { duration, moment, sign, t } from "../lib/words.js";
import { Signed } from "./calibrations/signed.js";
import { OperatorField, operatorOf } from "./start/operator.js";
import { isOffered, limitsName, planName, planTitle, runName, runTitle, stationName } from "../lib/names.js";
import { Outcome, useGet, Verdict } from "./stock/parts.js";
import { Said } from "../lib/said.js";
import { inSlot } from "../lib/units.js";

/** A job of the server that a button asks for: {result, error, busy}, `act(path, body)`, and `cancel()`. */
export function useAct() {
  const [state, setState] = useState(/** @type {{result?: any, error?: any, busy?: boolean}} */ ({}));
  const going = useRef(/** @type {{stop?: AbortController, job?: string}} */ ({}));
  const cancel = () => {
    going.current.stop?.abort();
    if (going.current.job) remove(url`/jobs/${going.current.job}`).catch(() => {});
    going.current = {};
  };
  useEffect(() => cancel, []);
  const act = async (path, body) => {
    cancel();
    const stop = new AbortController();
    going.current = { stop };
    setState({ busy: true });
    try {
      const { job } = await post(path, body, { signal: stop.signal });
      going.current.job = job;
      const result = await finished(job, { signal: stop.signal });
      going.current = {};
      setState({ result });
    } catch (error) {
      if (going.current.stop === stop) going.current = {};
      setState(error.name === "AbortError" ? {} : { error });
    }
  };
  return { ...state, act, cancel };
}

/** Shown while a job goes on, with a way to stop waiting; its error after it. */
export const Going = ({ job }) => html`<div role="status">${job.busy && html`<div class="row"><${Busy} /><button type="button" class="narrow" onClick=${job.cancel}>${t("run.cancel")}</button></div>`}</div>
  <${Trouble} error=${job.error} />`;

const Part = ({ name, children }) => html`<section class="panel stack" aria-labelledby=${`run-${name}`}><h2 id=${`run-${name}`}>${t(`run.${name}`)}</h2>
  <p class="small soft">${t(`run.${name}.what`)}</p>${children}</section>`;

function Export({ path }) {
  const { data, again } = useGet(`${path}/exports`);
  const [format, setFormat] = useState("c");
  const job = useAct();
  useEffect(() => job.result && again(), [job.result]);
  const made = job.result?.files ?? [];
  return html`<${Part} name="export">
    <div class="row"><label for="format">${t("run.format")}</label>
      <select id="format" value=${format} onChange=${(event) => setFormat(event.target.value)}>${(data?.formats ?? []).map((one) => html`<option key=${one} value=${one} selected=${one === format}>${one}</option>`)}</select>
      ${may("engineer") && html`<button type="button" class="primary" disabled=${job.busy} onClick=${() => job.act(`${path}/exports`, { format })}>${t("run.export.do")}</button>`}</div>
    <${Going} job=${job} />
    ${data?.files.length > 0 && html`<ul class="run-files">${data.files.map((name) => html`<li key=${name}><a class="mono" href=${`/api/v1${path}/exports/${encodeURIComponent(name)}`} download>${name}</a>${made.includes(name) && html` <${Lamp} tone="good">${t("run.export.new")}<//>`}</li>`)}</ul>`}
    <p><a href=${`/api/v1${path}/data.csv`} download>${t("run.means")}</a></p>
  <//>`;
}

/** Content of a change as short text. */
const cell = (value) => (value === null || value === undefined ? "–" : typeof value === "object" ? JSON.stringify(value) : String(value));

function Replay({ path }) {
  const job = useAct();
  const { result } = job;
  const changes = result ? [...result.tampered, ...result.differences] : [];
  return html`<${Part} name="replay">
    ${may("engineer") && html`<p><button type="button" disabled=${job.busy} onClick=${() => job.act(`${path}/replay`, {})}>${t("run.replay.do")}</button></p>`}
    <${Going} job=${job} />
    ${result && html`<p role="status"><${Lamp} tone=${result.identical ? "good" : "bad"}>${t(result.identical ? "run.replay.same" : "run.replay.other", { n: changes.length })}<//></p>
      <p class="small soft">${t(result.from_frames ? "run.replay.frames" : "run.replay.tables")}</p>
      ${result.failed && html`<p><${Said} text=${result.failed} /></p>`}
      ${changes.length > 0 && html`<div class="scroll" tabindex="0" role="region" aria-label=${t("run.replay")}><table><thead><tr>${Object.keys(changes[0]).map((key) => html`<th key=${key} scope="col">${t(`run.replay.${key}`)}</th>`)}</tr></thead><tbody>
        ${changes.slice(0, 40).map((change, index) => html`<tr key=${index}>${Object.entries(change).map(([key, value]) => html`<td key=${key} class="mono small">${cell(value)}</td>`)}</tr>`)}</tbody></table></div>`}`}
  <//>`;
}

function Certificate({ path, run, again }) {
  const job = useAct();
  useEffect(() => job.result && again(), [job.result]);
  const station = run.manifest.station ? `?station=${encodeURIComponent(run.manifest.station)}` : "";
  return html`<${Part} name="certificate">
    <div class="row">
      ${run.certificate && html`<a class="button primary" href=${`/api/v1${path}/certificate`} download>${t("run.certificate.get")}</a>`}
      ${may("engineer") && html`<button type="button" disabled=${job.busy} onClick=${() => job.act(`${path}/certificate`, {})}>${t(run.certificate ? "run.certificate.again" : "run.certificate.do")}</button>
        <button type="button" class="quiet" disabled=${job.busy} onClick=${() => job.act(`${path}/certificate`, { draft: true })}>${t("run.certificate.draft")}</button>`}</div>
    <${Going} job=${job} />
    ${job.error && html`<p><a href=${`/laboratory${station}`}>${t("papers.title")}</a></p>`}
    ${job.result && html`<p role="status"><${Lamp} tone=${job.result.draft ? "warn" : "good"}>${t(job.result.draft ? "run.certificate.drafted" : "run.certificate.issued", { number: job.result.number ?? "" })}<//> ${job.result.verdict && html`<${Verdict} word=${job.result.verdict} />`}
      ${job.result.draft && html` <a href=${`/api/v1${path}/certificate?draft=true`} download>${t("run.certificate.get_draft")}</a>`}</p>
      ${!job.result.draft && html`<p class="small"><${Signed} signer=${job.result.signer} /></p>`}`}
  <//>`;
}

/** Whether this is the calibration of a lot, or of a unit by its lot: its rows alone do not give it again. */
const ofLot = (run) => run?.manifest.profile === "lot";

/** Flash and verify: what moves equipment, at the station that has the unit; one that no station file has is in the slot of its run, or in one that people choose. */
function InTheUnit({ path, run }) {
  const { data: stations } = useGet("/stations");
  const { data: plans } = useGet("/plans");
  const { data: limits } = useGet("/limits");
  const [place, setPlace] = useState("");
  const [plan, setPlan] = useState("");
  const [limit, setLimit] = useState(/** @type {string | null} */ (null));
  const [state, setState] = useState(/** @type {{busy?: boolean, done?: boolean, error?: any}} */ ({}));
  const every = stations?.stations ?? [];
  const known = every.filter((one) => one.units.includes(run.unit));
  const places = known.length ? known.map((one) => ({ one, slot: run.unit })) : ofLot(run) ? [] : every.flatMap((one) => one.units.map((slot) => ({ one, slot })));
  const { station, gyro } = run.manifest;
  const itsOwn = places.find(({ one, slot }) => one.title === station && (known.length || one.wires[one.units.indexOf(slot)] === `${gyro?.bus} ${gyro?.number}`));
  const there = place ? places[place] : itsOwn ?? (known.length ? places[0] : null);
  const at = there && { station: there.one.id, ...(known.length ? {} : { slot: inSlot(run.unit, there.slot) }) };
  const own = plans?.plans.find((one) => one.name === run.manifest.profile);
  const others = (plans?.plans ?? []).filter((one) => !one.problem && isOffered(one) && one !== own && one.kind === (own?.kind ?? "temperature"));
  const chosen = plan || (others.find(({ id }) => id === own?.verification) ?? others[0])?.id;
  const within = limit ?? own?.limits ?? "";
  const begin = async (act) => {
    setState({ busy: true });
    try {
      setState(await act());
    } catch (error) {
      setState({ error });
    }
  };
  const flash = () => begin(async () => ({ done: Boolean(await startAct(`${path}/flash`, { ...at, ...operatorOf() })) }));
  const verify = () => begin(async () => {
    const live = await startRun(url`/units/${run.unit}/verification`, { ...at, plan: chosen, ...(within ? { limits: within } : {}), ...operatorOf() });
    navigate(live ? `/live/${live}` : "/calibrations");
    return {};
  });
  if (!may("operator")) return null;
  const options = (all, current) => all.map((one) => html`<option key=${one.id} value=${one.id} selected=${one.id === current}>${one.kind ? planTitle(one) : limitsName(one.id, one.title)}</option>`);
  return html`<${Part} name="unit">
    ${stations && !known.length && html`<p>${t(ofLot(run) ? "run.unit.lot" : itsOwn ? "run.unit.as_run" : "run.unit.nowhere", { unit: run.unit })}</p>`}
    ${places.length > 0 && html`<div class="run-fields">
      <div class="field"><label for="run-station">${t("papers.station")}</label><select id="run-station" onChange=${(event) => setPlace(event.target.value)}>${!known.length && html`<option value="" selected=${!there}></option>`}
        ${places.map(({ one, slot }, i) => html`<option key=${i} value=${i} selected=${there === places[i]} title=${one.title}>${stationName(one.title)}${known.length ? "" : `${sign(": ")}${t("start.slot", { slot })}`}</option>`)}</select></div>
      <${OperatorField} /></div>
      <p><button type="button" disabled=${state.busy || !at} onClick=${flash}>${t("run.flash.do")}</button></p>
      <div class="run-fields">
        <div class="field"><label for="run-plan">${t("run.verify.plan")}</label><select id="run-plan" value=${chosen} onChange=${(event) => setPlan(event.target.value)}>${options(others, chosen)}</select></div>
        <div class="field"><label for="run-limits">${t("ready.limits")}</label><select id="run-limits" value=${within} onChange=${(event) => setLimit(event.target.value)}><option value="" selected=${!within}>${t("ready.no_limits")}</option>${options(limits?.limits ?? [], within)}</select></div></div>
      <p><button type="button" disabled=${state.busy || !at} onClick=${verify}>${t("run.verify.do")}</button></p>`}
    <div role="status">${state.busy && html`<${Busy}>${t("ready.starting_long")}<//>`}${state.done && html`<${Lamp} tone="good">${t("run.flash.done")}<//>`}</div>
    <${Trouble} error=${state.error} />
  <//>`;
}

export default function Run({ params }) {
  const path = url`/runs/${params.unit}/${params.run}`;
  const { data: run, error, again } = useGet(path);
  const unit = run?.unit ?? params.unit;
  const head = html`<p class="small"><a href=${`/units${ofLot(run) ? "?q=" : "/"}${encodeURIComponent(unit)}`}>← ${unit}</a></p>`;
  if (error?.status === 404) return html`<div class="page stack">${head}<${Unknown} title=${params.unit} what=${t("live.unknown", { run: runName(`${params.unit}/${params.run}`) })} way="/units" words=${t("units.all")} /></div>`;
  if (!run) return html`<div class="page stack">${head}${error ? html`<${Trouble} error=${error} retry=${again} />` : html`<${Busy} />`}</div>`;
  const { manifest } = run;
  const about = manifest.profile ? [planName(manifest), moment(manifest.created)] : [runTitle(run.run)]; // a run that goes on has no manifest
  if (Number.isFinite(manifest.duration_s)) about.push(duration(manifest.duration_s));
  const link = encodeURIComponent(run.run);
  return html`<div class="page stack run">${head}
    <div class="st-head"><h1>${run.unit}</h1><span class="soft">${about.join(" · ")}</span>
      <${Outcome} run=${{ state: run.state, judged: run.limits?.verdict, verdict: run.verdict }} /></div>
    <p class="mono small soft">${run.run}</p>
    ${run.sentence && html`<p><${Said} text=${run.sentence} /></p>`}
    <p class="row">${run.report && html`<a class="button" href=${`/api/v1${path}/report`} target="_blank" rel="noopener">${t("verdict.report")}</a>`}
      ${may("engineer") && html`<a class="button" href=${`/workbench?run=${link}`}>${t("verdict.workbench")}</a>
      <a class="button" href=${`/workbench?run=${link}&compare=`}>${t("run.compare")}</a>`}</p>
    ${!run.calibration && html`<p>${t("run.no_calibration")}${sign(" ")}${run.verifies && html`<a href=${`/runs/${run.verifies}`}>${t("run.verifies")}</a> `}<a href=${`/api/v1${path}/data.csv`} download>${t("run.means")}</a></p>`}
    <div class="run-parts">
      ${run.calibration && html`${!ofLot(run) && html`<${Certificate} path=${path} run=${run} again=${again} />`}<${Export} path=${path} />
      <${InTheUnit} path=${path} run=${run} />`}${!ofLot(run) && html`<${Replay} path=${path} />`}
    </div>
  </div>`;
}
