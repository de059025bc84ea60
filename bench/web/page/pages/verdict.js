// The verdict fills the screen: word, sentence, next step. A fault: what happened, what the bench did, what to do.
import { html, useEffect, useRef, useState } from "../lib/preact.js";
import { compute, get, query, url } from "../lib/api.js";
import { useLive } from "../lib/live.js";
import { Busy, Lamp, Shape, Trouble, Unknown } from "../lib/parts.js";
import { navigate } from "../lib/router.js";
import { may, useOutcome } from "../lib/store.js";
import { asGiven, joined, moment, quantityWord, sig, sign, symbols, t } from "../lib/words.js";
import { limitsName, planName, runName } from "../lib/names.js";
import { GoOn } from "./live/resume.js";
import { achieved, advice, repeats, stands } from "./verdict/advice.js";
import { judged, margin, outcomeWord, toneOf, worstFirst } from "./verdict/judged.js";
import { Said } from "../lib/said.js";

const LOOK_MS = 2000;
/** How the cause begins of a run whose process was killed: it can go on. */
const KILLED = "the bench was killed";
/** The guard that ends a run of which a unit is not heard any more. */
const SILENT = "unit silent";

/** The end of a run: from the stream if it is live, else polled until its analysis is done. */
function useEnd(params) {
  const wanted = `${params.unit}/${params.run}`;
  const told = useLive((now) => Object.values(now.ended).find((end) => end.run === wanted || end.runs?.includes(wanted)));
  const [seen, setSeen] = useState(/** @type {{run?: any, end?: any, error?: any}} */ ({}));
  useEffect(() => {
    let timer = 0;
    let left = false;
    const look = async () => {
      try {
        const run = await get(url`/live/${params.unit}/${params.run}`);
        if (left) return;
        setSeen({ run, end: run.ended });
        if (!run.ended || run.ended.analysing || run.ended.units.some(({ analysed }) => !analysed)) timer = setTimeout(look, LOOK_MS);
      } catch (error) {
        if (!left) setSeen((before) => (before.end ? before : { error }));
        if (!left) timer = setTimeout(look, LOOK_MS);
      }
    };
    look();
    return () => {
      left = true;
      clearTimeout(timer);
    };
  }, [wanted, told?.analysing]);
  const end = told && (!seen.end || (seen.end.analysing && !told.analysing)) ? told : seen.end ?? told;
  return { run: seen.run ?? told, end, error: seen.error };
}

export default function Verdict({ params }) {
  const { run, end, error } = useEnd(params);
  useEffect(() => {
    if (run?.condition && run.condition !== "ended" && !end) navigate(`/live/${params.unit}/${params.run}`, { replace: true });
    if (run?.job && end && !end.analysing && !end.units?.some(({ analysed }) => analysed)) navigate(`/calibrations/${run.job}`, { replace: true }); // its calibration judges it
    if (run?.profile === "lot") navigate(`/runs/${params.unit}/${params.run}`, { replace: true }); // made of other runs: nothing was measured
  }, [run, end]);
  const units = end?.units?.length ? inOrder(end.units) : [{ unit: params.unit, run: `${params.unit}/${params.run}` }];
  const words = end ? units.map((unit) => judged(end, unit)) : [];
  const word = words.includes("analysing") ? "analysing" : worstFirst(words)[0]; // of all units: a worse one may come
  const shown = units[words.indexOf(word)];
  useOutcome(word ? t(`verdict.${word}`) : "");
  const answers = useJudged(units);
  const answer = answers[shown?.run];
  if (!end && error?.status === 404) return html`<div class="page stack"><${Unknown} title=${params.unit} what=${t("live.unknown", { run: runName(`${params.unit}/${params.run}`) })} way="/units" words=${t("units.all")} /></div>`;
  if (!end && error?.status === 409) return html`<div class="page stack"><${Unknown} title=${params.unit} what=${t("verdict.no_end", { run: runName(`${params.unit}/${params.run}`) })} way=${`/runs/${params.unit}/${params.run}`} words=${t("run.open")} /><${GoOn} run=${`${params.unit}/${params.run}`} /></div>`;
  if (!end) return html`<div class="page">${error ? html`<${Trouble} error=${error} />` : html`<${Busy} />`}</div>`;
  const fault = end.state !== "done";
  const kind = kindOf(answer);
  const twice = kind && answer.limits?.results?.some(({ name, value }) => name === "residual_rms_dph" && value !== null); // its sentence says it again
  const unlimited = !fault && !run?.job && units.every(({ analysed, limits, verified }) => analysed && !limits && !verified);
  const alike = units.filter((_, index) => words[index] === word);
  const steps = stepsOf(units, words, (one, unit) => next(one, end, answers[unit.run]));
  const good = units.filter((unit, index) => ["pass", "marginal"].includes(words[index]) && answers[unit.run]);
  const named = (some) => some.length < units.length && html`<b>${joined(some.map(({ unit }) => unit))}${sign(": ")}</b>`;
  return html`<article class=${`verdict tone-${toneOf(word)}`}>
    <${Word} word=${word} />
    <div class="verdict-about">
      <p class="verdict-who"><b>${units.length > 2 ? t("start.all_units", { n: units.length }) : units.map(({ unit }) => unit).join(", ")}</b> · ${planName(run ?? end)}${run?.started && html` · <time datetime=${run.started}>${moment(run.started)}</time>`}</p>
      <p class="verdict-sentence">${named(alike)}${t(`verdict.${word}.sentence`, { n: alike.length })}</p>
      ${units.length > 1 && html`<${Units} units=${units} words=${words} />`}
      ${answer?.limits && word !== "not_started" && html`<${Reasons} limits=${answer.limits} kind=${kind} of=${units.length > 1 && shown.unit} />`}
      ${good.length > 0 && html`<${Achieved} run=${answers[good[0].run]} whose=${named(good)} />`}
      ${fault ? html`<${Fault} end=${end} />` : !twice && units.length === 1 && units[0].sentence && html`<p class="verdict-detail"><${Said} text=${units[0].sentence} /></p>`}
      ${unlimited && html`<p class="verdict-detail">${t("verdict.no_limits")}${sign(" ")}${may("operator") && run?.runs && html`<a href=${repeat(run)}>${t("verdict.no_limits.choose")}</a>`}</p>`}
      <section class="verdict-next" aria-labelledby="next"><h2 id="next">${t("verdict.next")}</h2>
        ${run?.runs && !run.job && may("operator") && end.cause?.startsWith(KILLED) ? html`<${GoOn} run=${end.run} />` : steps.map(([step, some]) => html`<p key=${step}>${named(some)}${t(step, { n: some.length })}</p>`)}
        ${!fault && !end.analysing && units.some(({ analysed }) => !analysed) && may("operator") && html`<${Analyse} units=${units} again=${run?.again} />`}</section>
      <${Ways} units=${units} run=${run} reported=${answer?.report !== false} step=${steps[0][0]} />
      ${units.filter(({ run: other }) => other !== shown.run && answers[other]?.limits).map((unit) => html`<${Reasons} key=${unit.unit} limits=${answers[unit.run].limits} kind=${kindOf(answers[unit.run])} of=${unit.unit} />`)}
    </div>
  </article>`;
}

/** Makes the reports that are missing, with the models and limits of the start; the page sees them when they are there. */
function Analyse({ units, again }) {
  const [state, setState] = useState(/** @type {{busy?: boolean, error?: any}} */ ({}));
  const analyse = async () => {
    setState({ busy: true });
    try {
      for (const { run } of units.filter(({ analysed }) => !analysed)) await compute(`/runs/${run}/report`, { models: again?.models ?? [], limits: again?.limits ?? null });
    } catch (error) {
      setState({ error });
    }
  };
  return html`<p role="status">${state.busy ? html`<${Busy} />` : html`<button type="button" class="primary" onClick=${analyse}>${t("verdict.analyse")}</button>`}</p>
    <${Trouble} error=${state.error} />`;
}

/** Units by serial number, whichever of their runs the address names. */
const inOrder = (units) => [...units].sort((one, other) => one.unit.localeCompare(other.unit, undefined, { numeric: true }));

const kindOf = (answer) => (answer?.manifest?.purpose === "verification" ? "verification" : "");

/** The next step; with an unverified safe state, go to the chamber first. */
const next = (word, end, answer) => {
  if (end.state !== "done" && (end.safe === false || (end.state === "failed" && !end.safe))) return "verdict.equipment_failed.next_unsafe";
  return end.cause?.includes(SILENT) ? "verdict.not_started.next" : advice(word, answer);
};

/** What is to be done, worst first, each with its units: [key, units]. */
function stepsOf(units, words, stepOf) {
  const found = new Map();
  for (const word of worstFirst(words)) {
    for (const unit of units.filter((_, index) => words[index] === word)) {
      const step = stepOf(word, unit);
      found.set(step, [...(found.get(step) ?? []), unit]);
    }
  }
  return [...found];
}

/** Answers of GET /runs/… about the units' runs that were judged, by run. */
function useJudged(units) {
  const [seen, setSeen] = useState(/** @type {Record<string, any>} */ ({}));
  const judgedNow = units.filter(({ limits, run }) => limits && run);
  useEffect(() => {
    for (const { run } of judgedNow) {
      const [serial, folder] = run.split("/");
      get(url`/runs/${serial}/${folder}`).then((answer) => setSeen((before) => ({ ...before, [run]: answer })), () => {});
    }
  }, [judgedNow.map(({ run, analysed }) => `${run} ${analysed}`).join()]); // values are there before the report is written
  return seen;
}

function Word({ word }) {
  const heading = useRef(null);
  useEffect(() => heading.current.focus({ preventScroll: true }), [word]);
  const wide = (text) => [...text].reduce((sum, letter) => sum + (letter.codePointAt(0) > 0x2e80 ? 1.6 : 1), 0);
  const text = t(`verdict.${word}`);
  const sized = (element) => {
    element?.style.setProperty("--letters", wide(text));
    element?.style.setProperty("--longest", Math.max(...text.split(" ").map(wide)));
  };
  return html`<header class="verdict-word" ref=${sized}>
    ${word === "analysing" ? html`<span class="spinner"></span>` : html`<${Shape} tone=${toneOf(word)} />`}
    <h1 tabindex="-1" ref=${heading} aria-live="assertive">${text}</h1>
  </header>`;
}

/** The workbench handles one unit at a time. */
const workbench = ({ run }) => `/workbench?run=${encodeURIComponent(run)}`;

const Units = ({ units, words }) => html`<ul class="verdict-units">
  ${units.map((unit, index) => html`<li key=${unit.unit} class=${`tone-${toneOf(words[index])}`}>
    <${Shape} tone=${toneOf(words[index])} /><div><b class="mono">${unit.unit}</b><strong>${t(`verdict.${words[index]}`)}</strong>
      ${unit.sentence && html`<span class="soft small"><${Said} text=${unit.sentence} /></span>`}
      ${unit.run && unit.analysed && html`${!unit.verified && html`<a class="small" href=${`/api/v1/runs/${unit.run}/report`} target="_blank" rel="noopener">${t("verdict.report")}</a>`}
        ${may("engineer") && html`<a class="small" href=${workbench(unit)}>${t("verdict.workbench")}</a>`}
        <a class="small" href=${`/runs/${unit.run}`}>${t("run.open")}</a>`}</div>
  </li>`)}
</ul>`;

/** What was passed: the limits by name, the steps that are done, and those that are missing before the unit goes on. */
function Achieved({ run, whose }) {
  const { done, missing } = achieved(run);
  const named = (steps) => joined(steps.map((step) => t(`verdict.step.${step}`)));
  return html`<ul class="findings verdict-reasons" aria-label=${t("verdict.achieved")}>
    ${done.length > 0 && html`<li><span class="tone-good"><${Shape} tone="good" /></span><span>${whose}${run.limits?.name ? t("verdict.done", { steps: named(done), limits: limitsName(run.limits.name) }) : t("verdict.done_by_rule", { steps: named(done) })}</span></li>`}
    ${missing.length > 0 && html`<li><span class="tone-warn"><${Shape} tone="warn" /></span><span>${whose}${t("verdict.missing", { steps: named(missing) })}</span></li>`}
  </ul>`;
}

/** Refusals, and every quantity beside its limits with what is left to the nearest of them; `of`: whose, where there are several units. */
function Reasons({ limits, kind, of }) {
  const head = ["quantity", "value", "limits", "margin", "verdict"];
  return html`<div class="verdict-reasons">
    ${limits.refusals?.length > 0 && html`<ul class="findings" aria-label=${t("verdict.reasons")}>${limits.refusals.map((text) => html`
      <li key=${text}><span class="tone-warn"><${Shape} tone="warn" /></span><span>${of && html`<b>${of}${sign(": ")}</b>`}<${Said} text=${text} whole=${!of} /></span></li>`)}</ul>`}
    ${!limits.results?.length && limits.decision_rule && html`<p class="soft"><${Said} text=${limits.decision_rule} /></p>`}
    ${limits.results?.length > 0 && html`<div class="scroll" tabindex="0" role="region" aria-label=${`${of ? `${of}${sign(": ")}` : ""}${t("verdict.table")}`}><table>${of && html`<caption class="mono">${of}</caption>`}<thead><tr>${head.map((key) => html`<th key=${key} scope="col" class=${["value", "limits", "margin"].includes(key) ? "n" : undefined}>${t(`verdict.head.${key}`)}</th>`)}</tr></thead>
      <tbody>${limits.results.map((result) => html`<${Judged} key=${result.name} result=${result} kind=${kind} counts=${!limits.refusals?.length} />`)}</tbody></table></div>`}
  </div>`;
}

/** One quantity; its verdict has no colour where the run gives no result and it does not count. */
function Judged({ result, kind, counts }) {
  const { name, value, low, high, unit, lower, upper, reason, verdict } = result;
  const [tone, left] = [counts ? toneOf(verdict) : "idle", margin(result)];
  const sides = [lower !== null && `≥\u00a0${asGiven(lower)}`, upper !== null && `≤\u00a0${asGiven(upper)}`].filter(Boolean).join(", ");
  return html`<tr><th scope="row">${quantityWord(name, kind)}${reason && html`<div class="soft small"><${Said} text=${reason} /></div>`}</th>
    <td class="n figures">${sig(value)}\u00a0<small>${symbols(unit)}</small>${verdict === "MARGINAL" && low !== undefined && html`<div class="soft small">${low === null ? "−∞" : sig(low)} … ${high === null ? "∞" : sig(high)}</div>`}</td><td class="n figures">${sides}</td><td class="n figures">${left === null ? "–" : sig(left)}</td>
    <td>${verdict ? html`<${Lamp} tone=${tone}>${outcomeWord(verdict)}<//>` : "–"}</td></tr>`;
}

/** What happened and what the bench did, from the run's events. */
function Fault({ end }) {
  const steps = end.safe_state ?? [];
  const safe = end.safe === true ? "good" : end.safe === false ? "bad" : "warn";
  return html`<div class="fault">
    <section><h2>${t("fault.happened")}</h2>
      <p>${end.cause ? html`<${Said} text=${end.cause} />` : t("fault.unknown")}</p></section>
    <section><h2>${t("fault.did")}</h2>
      <p><${Lamp} tone=${safe}>${t(safe === "good" && !steps.length ? "fault.still" : `fault.safe.${safe}`)}<//></p>
      ${steps.length > 0 && html`<details><summary>${t("fault.steps", { n: steps.length })}</summary><ul class="findings">
        ${steps.map(({ text, ok }) => html`<li key=${text}><span class=${`tone-${ok ? "good" : "bad"}`}><${Shape} tone=${ok ? "good" : "bad"} /></span><span><${Said} text=${text} /></span></li>`)}
      </ul></details>`}
    </section>
  </div>`;
}

/** The start page with the same answers as for this run. */
function repeat(run) {
  const { plan, station, units, limits, models } = run.again ?? { plan: run.profile, station: run.station, units: run.runs.map((each) => each.split("/")[0]) };
  return `/start?${new URLSearchParams({ unit: units.join(","), station, plan, ...(run.again ? { limits: limits ?? "", models: models.join(",") } : {}) })}`;
}

function Ways({ units, run, reported, step }) {
  const one = units[0];
  const written = one.analysed && one.run;
  const repeatable = may("operator") && run?.runs && !run.job;
  const repeated = repeatable && repeats(step); // the main button does what the next step says
  return html`<div class="verdict-ways">
    ${repeated && html`<a class="button primary" href=${repeat(run)}>${t("verdict.repeat")}</a>`}
    ${may("operator") && html`<a class=${repeated || stands(step) ? "button" : "button primary"} href="/">${t("verdict.next_unit", { n: units.length })}</a>`}
    ${repeatable && !repeated && html`<a class="button" href=${repeat(run)}>${t("verdict.repeat")}</a>`}
    ${run?.job && html`<a class="button" href=${`/calibrations/${run.job}`}>${t("live.of_calibration")}</a>`}
    <button type="button" onClick=${() => window.print()}>${t("verdict.print")}</button>
    ${written && reported && units.length === 1 && html`<a class="button" href=${`/api/v1/runs/${one.run}/report`} target="_blank" rel="noopener">${t("verdict.report")}</a>`}
    ${may("engineer") && written && units.length === 1 && html`<a class="button" href=${workbench(one)}>${t("verdict.workbench")}</a>`}
    ${written && units.length === 1 && html`<a class="button" href=${`/runs/${one.run}`}>${t("run.open")}</a>`}
    ${units.length === 1 && html`<a class="button" href=${url`/units/${one.unit}` + query({ run: one.run })}>${t("verdict.unit")}</a>`}
  </div>`;
}
