// The engineer's workbench: choose a run, see where the model fails and what is missing, add it, compare the error.
import { html, t, api, number, runTitle, useEffect, useRef, useState, unitOf, Waiting } from "./parts.js";
import { Chooser } from "./chooser.js";
import { Chosen } from "./chosen.js";
import { Compare } from "./compare.js";
import { FOLLOWING_MODEL, START_MODEL, isOpen } from "./first.js";
import { NextExperiment } from "./experiment.js";
import { Ladder, floorWord } from "./ladder.js";
import { ModelPanel, useModels } from "./model.js";
import { Notes } from "./notes.js";
import { Pictures } from "./pictures.js";
import { ask, companions, known, likelyRole, useJob, useSession } from "./session.js";
import { labelOf, labelWord, same } from "./state.js";
import { timesFloor } from "../../lib/floor.js";
import { runName } from "../../lib/names.js";
import { Unknown } from "../../lib/parts.js";
import { joined, sign } from "../../lib/words.js";
import { Suspects, pictureOf } from "./suspects.js";
import { Said, Written } from "../../lib/said.js";

/** Body of an analysis of one model. */
const analysisOf = (runs, model) => ({ ...runs, models: [model] });

/** A rung of the ladder from the analysis of a model, or null without one; `before`: the model before it. */
function rungOf(model, before, runs) {
  const found = known("/analyses", analysisOf(runs, model))?.models[0];
  return found ? { label: labelWord(labelOf(model, before)), inSample: found.rms_dph, heldOut: found.held_out_rms_dph, heldOutBy: found.held_out_by, why: found.held_out[0]?.reason } : null;
}

const WHERE = () => ({
  check: t("workbench.ladder.by_check"),
  blocks: t("workbench.ladder.by_blocks"),
  segments: t("workbench.ladder.by_segments"),
  soaks: t("workbench.ladder.by_blocks"),
});

function Tile({ value, floor, title, mark, hint, where }) {
  return html`<div class="wb-tile"><span class="wb-tile-what"><span class=${`wb-mark wb-mark-${mark}`} aria-hidden="true"></span>${title}</span>
    <b>${number(value)}</b>
    <span class="wb-soft">${hint ?? (value && floor ? timesFloor(value, floor) : "")}</span>
    ${where && html`<span class="wb-soft">${where}</span>`}</div>`;
}

/** The error of each part of the run, as multiples of the floor, or in deg/h where no floor is known. */
function BySegment({ segments }) {
  if (!segments?.length) return null;
  const floor = segments.some((one) => one.floor_ratio !== null);
  const of = (one) => (floor ? one.floor_ratio : one.rms_dph);
  const most = Math.max(floor ? 1 : 0, ...segments.map((one) => of(one) ?? 0)) || 1;
  return html`<details class="wb-segments"><summary>${t(floor ? "workbench.ladder.segments" : "workbench.ladder.segments_dph")}</summary>
    <ul>${segments.map((one, i) => html`<li key=${i}><span><${Written} segment text=${one.name} /></span>
      <span class="wb-bar" aria-hidden="true"><span class="wb-fill" style=${{ width: `${(100 * (of(one) ?? 0)) / most}%` }}></span></span>
      <b>${floor ? `${number(one.floor_ratio, 2)} ×` : number(one.rms_dph)}</b></li>`)}</ul></details>`;
}

/** A message that begins with the folder of a run: without it, or with its title where there are several. */
function ofRuns(message, { runs }) {
  const run = runs.find((one) => message.startsWith(`${one.split("/").pop()}: `));
  const text = run && message.slice(run.split("/").pop().length + 2);
  return !run ? message : runs.length > 1 ? `${runTitle(run)}: ${text}` : text;
}

/** Errors of the model: numbers, ladder, undo; `whole`: the run whose unit is calibrated as a whole. */
function Standing({ session, analysis, floor, whole }) {
  const { steps, runs, act, undone } = session;
  const [, redraw] = useState(0);
  useEffect(() => {
    for (const { model } of steps.slice(0, -1)) if (!known("/analyses", analysisOf(runs, model))) ask("/analyses", analysisOf(runs, model)).then(() => redraw((count) => count + 1), () => {});
  }, [steps, runs]);
  const rungs = steps.map(({ model }, i) => rungOf(model, steps[i - 1]?.model, runs)).filter(Boolean);
  const last = rungs[rungs.length - 1];
  return html`<section class="wb-card wb-standing" aria-labelledby="wb-ladder-title" aria-busy=${analysis.running ? "true" : "false"}>
    <div class="wb-card-head"><h2 id="wb-ladder-title">${t("workbench.ladder.title")}</h2>
      ${(steps.length > 1 || undone > 0) && html`<span class="row">
        <button type="button" class="narrow" disabled=${steps.length < 2} aria-keyshortcuts="Control+Z" onClick=${() => act({ type: "undo" })}>↶ ${t("workbench.model.undo")}</button>
        <button type="button" class="narrow" disabled=${!undone} aria-keyshortcuts="Control+Shift+Z" onClick=${() => act({ type: "redo" })}>↷ ${t("workbench.model.redo")}</button></span>`}</div>
    ${analysis.failed && html`<p class="wb-bad" role="alert"><${Said} text=${ofRuns(analysis.failed, runs)} whole />${whole && html` <a href=${`/runs/${whole}`}>${t("workbench.whole")}</a>`}</p>`}
    ${last && html`<div class="wb-tiles" role="status">
      <${Tile} value=${last.heldOut} floor=${floor} title=${t("workbench.ladder.held_out")} mark="held" where=${`${WHERE()[last.heldOutBy]}${last.heldOutBy === "check" ? ` ${joined(runs.check.map(runTitle))}` : ""}`} />
      <${Tile} value=${last.inSample} floor=${floor} title=${t("workbench.ladder.in_sample")} mark="in" />
      <${Tile} value=${floor} title=${t("workbench.ladder.floor")} mark="floor" hint=${t(floorWord(last, floor))} />
    </div>`}
    ${last && [["held_out", last.heldOut, last.why], ["floor", floor, analysis.result?.floor_reason]].filter(([, value, why]) => value === null && why).map(([name, , why]) => html`<p key=${name} class="wb-warn small">${t(`workbench.ladder.${name}`)}${sign(": ")}<${Said} text=${why} /></p>`)}
    ${last && analysis.result?.left_out.map((text) => html`<p key=${text} class="wb-warn small"><${Said} text=${text} whole /></p>`)}
    ${last && html`<${Ladder} rungs=${rungs} floor=${floor} name=${`${runs.runs[0]} ladder`} />`}
    <${BySegment} segments=${analysis.result?.models[0].segments} />
    <${Waiting} job=${analysis}>${t("workbench.analysis.running")}<//>
  </section>`;
}

/** Scroll a part into view, so that the effect of a click is visible. */
const show = (part) => part.current?.scrollIntoView({ block: "nearest", behavior: "smooth" });

/** Ctrl+Z and Ctrl+Shift+Z, except where a text is typed, which has its own. */
function useUndoKeys(act) {
  useEffect(() => {
    const key = (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.altKey || !/^[zy]$/i.test(event.key) || event.target.closest("input, textarea, select")) return;
      event.preventDefault();
      act({ type: event.shiftKey || /y/i.test(event.key) ? "redo" : "undo" });
    };
    addEventListener("keydown", key);
    return () => removeEventListener("keydown", key);
  }, []);
}

/** The report may find nothing missing where the model to begin with lacks an effect: it is of another one. */
const Reported = ({ model, act }) => model && html`<p>${t("workbench.reported", { model: model.name })} <button type="button" class="narrow" onClick=${() => act({ type: "model", model: model.model })}>${t("workbench.reported.take")}</button></p>`;

/** `turned`: whether a rate table may have turned the unit; the model to begin with then gets a scale factor. `reported`: name of the model of the run's report. */
function Bench({ session, models, turned, whole, reported }) {
  const { runs, model, steps, act } = session;
  useUndoKeys(act);
  const turning = turned && same(model, START_MODEL);
  const analysis = useJob("/analyses", turning ? { ...analysisOf(runs, model), turning } : analysisOf(runs, model));
  // All numbers and pictures shall be of one model: the diagnosis waits until the data have chosen it and its options.
  const open = isOpen(model) || (turning && !analysis.failed && analysis.result?.turned !== false);
  const settled = open ? analysis.result?.models[0].model : null;
  useEffect(() => settled && act({ type: "settle", model: settled }), [settled]);
  // The data choose the model where they do not determine the first one, or a part of them does not: nothing could be held out.
  const followed = useRef("");
  const unfit = analysis.failed || analysis.result?.models[0].held_out.some(({ reason }) => reason);
  useEffect(() => {
    if (!unfit || !same(model, START_MODEL) || followed.current === runs.runs.join()) return;
    followed.current = runs.runs.join();
    act({ type: "settle", model: FOLLOWING_MODEL });
  }, [unfit, model]);
  // What is missing is told first; the pictures of it are many times as large and follow.
  const diagnosis = useJob("/diagnoses", open ? null : { ...runs, model, brief: true });
  const pictured = useJob("/diagnoses", diagnosis.result ? { ...runs, model } : null);
  const found = pictured.result ?? diagnosis.result;
  const floor = (analysis.result ?? analysis.stale)?.floor_dph ?? null;
  const [standing, pictures] = [useRef(null), useRef(null)];
  // What is wrong with a model is told beside its errors, and not again by the diagnosis and the figure.
  const once = (failed) => (failed === analysis.failed ? "" : failed);
  const untold = analysis.failed && !found && !once(diagnosis.failed) && !diagnosis.running;
  useEffect(() => analysis.failed && show(standing), [analysis.failed]);
  const picked = pictureOf(found, session.picture);
  const add = (missing) => {
    act({ type: "add", effects: missing.add, model: missing.model });
    show(standing);
  };
  const pick = (picture) => {
    act({ type: "view", view: { picture } });
    if (picture) show(pictures);
  };
  return html`<div class="wb-bench">
    <div class="wb-side">
      <div ref=${standing}><${Standing} session=${session} analysis=${analysis} floor=${floor} whole=${whole} /></div>
      ${!untold && html`<section class="wb-card" aria-labelledby="wb-missing-title"><h2 id="wb-missing-title">${t("workbench.diagnosis.title")}</h2>
        ${steps.length === 1 && model.name !== reported && html`<${Reported} model=${models.known.find(({ name }) => name === reported)} act=${act} />`}
        <${Suspects} found=${found} failed=${once(diagnosis.failed)} waiting=${open ? analysis : diagnosis} busy=${analysis.running} picked=${picked?.id} onAdd=${add} onPicture=${pick} />
        ${!pictured.result && html`<${Waiting} job=${pictured}>${t("workbench.diagnosis.drawing")}<//>`}
        ${pictured.failed && html`<p class="wb-bad" role="alert"><${Said} text=${pictured.failed} /></p>`}
      </section>`}
      <${NextExperiment} next=${found?.next_experiment} unit=${unitOf(runs.runs[0])} />
      <${ModelPanel} models=${models} model=${model} fitted=${analysis.result?.models[0]} steps=${steps} busy=${analysis.running} act=${act} runs=${runs} />
      <${Notes} key=${runs.runs[0]} run=${runs.runs[0]} address=${session.address} />
    </div>
    <div class="wb-main" ref=${pictures}><${Pictures} session=${session} picked=${picked} once=${once} /></div>
  </div>`;
}

/** What the server tells of the chosen runs by their ids; null for one that it does not have, as after a mistyped address. */
function useTold(chosen) {
  const [states, setStates] = useState({});
  useEffect(() => {
    for (const { run } of chosen) {
      const [unit, folder] = run.split("/");
      const told = (found) => setStates((before) => ({ ...before, [run]: found }));
      api.get(api.url`/runs/${unit}/${folder ?? ""}`).then(told, (error) => told(error.status === 404 ? null : { state: "done" }));
    }
  }, [chosen.map(({ run }) => run).join()]);
  return states;
}

/** Runs that belong to this one, each with its role. */
function useCompanions(run) {
  const [offered, setOffered] = useState([]);
  useEffect(() => {
    let active = true;
    setOffered([]);
    if (run) {
      api.get(`/runs${api.query({ unit: unitOf(run), limit: 200 })}`)
        .then(({ runs }) => active && setOffered(companions(runs.find((one) => one.run === run) ?? { run, unit: unitOf(run) }, runs)), () => {});
    }
    return () => { active = false; };
  }, [run]);
  return offered;
}

export function Page({ query = {} }) {
  const session = useSession();
  const { chosen, act } = session;
  const [mode, setMode] = useState("compare" in query ? "compare" : "bench");
  const offered = useCompanions(chosen[0]?.run);
  const models = useModels();
  const begin = (row) => {
    act({ type: "choose", runs: [{ ...row, role: "fit" }] });
    setMode("bench");
  };
  const take = (row) => {
    act({ type: "take", run: { ...row, role: likelyRole(row, chosen) } });
    setMode("bench");
  };
  const compare = (run) => act({ type: "view", view: { compare: run } });
  const told = useTold(chosen);
  const unknown = chosen.find(({ run }) => told[run] === null)?.run;
  const first = told[chosen[0]?.run];
  const outputs = first?.outputs ?? [];
  // Somebody may type the name of a model in place of the model.
  const named = models.known.find(({ name }) => name === session.wrong);
  useEffect(() => named && act({ type: "model", model: named.model, silent: true }), [named]);
  const unread = session.wrong !== null && !named;
  const ready = session.wrong === null ? first !== undefined || !same(session.model, START_MODEL) : models.read && unread && first !== undefined;
  const unchosen = outputs.length > 0 && !outputs.includes(session.output);
  useEffect(() => {
    if (unchosen) act({ type: "output", output: outputs[0] });
  }, [unchosen]);
  const adding = mode === "add" && chosen.length > 0;
  const choosing = !chosen.length || mode === "other" || adding;
  const taken = new Set(chosen.map((one) => one.run));
  return html`<div class="wb">
    <h1 class=${choosing ? "" : "unseen"}>${t("workbench.title")}</h1>
    ${choosing && !adding && html`<p class="wb-lead">${t("workbench.lead")}</p>`}
    ${chosen.length > 0 && html`<${Chosen} chosen=${chosen} told=${told} outputs=${outputs} output=${session.output} offered=${offered} act=${act} onAdd=${() => setMode("add")} onOther=${() => setMode("other")} onCompare=${() => setMode("compare")} />`}
    ${choosing && html`<div class="wb-card"><${Chooser} taken=${taken} onChoose=${adding ? take : begin} label=${adding ? t("workbench.chooser.add") : null} />
      ${chosen.length > 0 && html`<p><button type="button" class="narrow" onClick=${() => setMode("bench")}>${t("workbench.chooser.back")}</button></p>`}</div>`}
    ${unread && models.read && html`<p class="wb-warn" role="alert">${t("workbench.address.wrong", { given: session.wrong.slice(0, 60), model: session.model.name })}</p>`}
    ${unknown && html`<${Unknown} what=${t("live.unknown", { run: runName(unknown) })} way=${() => act({ type: "choose", runs: [] })} words=${t("workbench.chosen.other")} />`}
    ${!choosing && !unknown && mode === "compare" && html`<${Compare} a=${chosen[0].run} b=${session.compare} setB=${compare} onClose=${() => { compare(""); setMode("bench"); }} />`}
    ${!choosing && !unknown && mode !== "compare" && (session.runs ? (ready && html`<${Bench} session=${session} models=${models} turned=${Boolean(first?.table)} whole=${outputs.length > 0 && first.calibration ? chosen[0].run : null} reported=${first?.diagnosis?.model} />`) : html`<p class="wb-warn" role="alert">${t("workbench.chosen.no_fit")}</p>`)}
  </div>`;
}

export default Page;
