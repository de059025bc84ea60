// The operator's start page: asks for unit, plan and confirmation, one question at a time.
import { html, useEffect, useLayoutEffect, useRef, useState } from "../lib/preact.js";
import { get } from "../lib/api.js";
import { Pin } from "../lib/bar.js";
import { useLive } from "../lib/live.js";
import { Busy, Shape, TextField, Trouble } from "../lib/parts.js";
import { may, remembered, session, store, useStore } from "../lib/store.js";
import { inSlot, repeated, serialOf, slotOf } from "../lib/units.js";
import { t } from "../lib/words.js";
import { PlanQuestion } from "./start/plan.js";
import { planTitle, stationName } from "../lib/names.js";
import { Ready } from "./start/ready.js";
import { Doubled, doubledIn, wrongIn } from "./start/slots.js";
import { UnitQuestion } from "./start/unit.js";

const NOTHING = { units: [], station: null, plan: null, calibration: null, limits: null, models: null, anew: false };
/** The answers so far; kept while the operator views another page. */
const order = store(NOTHING);
/** Station of the last start in this browser. */
const lastStation = remembered("station", null);

const question = ({ units, station, plan, calibration }) => (!units.length || !station ? "unit" : !plan && !calibration ? "plan" : "ready");

/** Plans and stations, read once when the page opens. */
function useChoices() {
  const [choices, setChoices] = useState(/** @type {any} */ ({}));
  const load = () => {
    Promise.all([get("/plans"), get("/calibration-plans"), get("/stations"), get("/limits").catch(() => ({ limits: [] }))]).then(
      ([{ plans }, { plans: calibrations }, { stations }, { limits }]) => setChoices({
        plans, stations, limits, calibrations: calibrations.map((plan) => ({ ...plan, calibration: true, models: [], limits: "" })),
      }),
      (error) => setChoices({ error }),
    );
  };
  useEffect(load, []);
  return { ...choices, load };
}

/** When the answers began to be given: those of a run that has been started are not asked again. */
let since = Date.now();

/** Nothing is answered; what is in the history is not asked again. */
function forget() {
  since = Date.now();
  order.set(NOTHING);
}

/** Who has given the answers: somebody else at the same screen begins anew. */
let whose = "";
function useOwn(name) {
  useLayoutEffect(() => {
    if (!may("operator")) return;
    if (whose && whose !== name) {
      forget();
      keep(NOTHING);
    }
    whose = name;
  }, [name]);
}

/** Answers, kept with the entry of the history, or with a new one. */
function keep(next, how = "replaceState") {
  history[how]({ order: next, since }, "");
  order.set(next);
}

/** Each question is an entry of the history with its answers: Back asks the one before again. */
function useBack() {
  useEffect(() => {
    const back = ({ state }) => state?.order && order.set(state.since === since ? state.order : NOTHING);
    keep(order.get());
    addEventListener("popstate", back);
    return () => removeEventListener("popstate", back);
  }, []);
}

/** The answers in the address, if they exist: `/start?unit=…&station=…&plan=…&limits=…&models=…` or `…&calibration=…&anew=true`. */
function asked({ unit, station, plan, calibration, limits = null, models, anew }, { plans, calibrations, stations }) {
  const units = unit ? unit.split(",") : [];
  const there = stations.filter((one) => units.length && units.every((each) => one.units.includes(slotOf(each))));
  // Never another one than is named, by its file or, where a terminal began the run, by the name in it.
  const named = there.filter(({ title }) => !station || title === station);
  const place = there.find(({ id }) => id === station) ?? (named.length === 1 ? named[0] : null);
  return {
    units: place ? units : [],
    station: place?.id ?? null,
    plan: plans.some((one) => one.id === plan) ? plan : null,
    calibration: calibrations.some((one) => one.id === calibration) ? calibration : null,
    limits, models: models?.split(",").filter(Boolean) ?? null, anew: anew === "true",
  };
}

/** A scan while a button has the focus takes it away: the Enter of the scanner presses nothing. */
function useUnpressed(heading) {
  useEffect(() => {
    const typed = ({ key }) => key.length === 1 && key !== " " && document.activeElement?.closest(".question button") && heading.current?.focus();
    document.addEventListener("keydown", typed);
    return () => document.removeEventListener("keydown", typed);
  }, []);
}

export default function Start({ query }) {
  const choices = useChoices();
  const now = useStore(order);
  const who = useStore(session);
  const heading = useRef(null);
  const [unanswered, setUnanswered] = useState(query.unit && !query.station && !query.unit.includes(",") ? serialOf(query.unit) : "");
  const step = question(now);
  useOwn(who.name);
  useBack();
  useUnpressed(heading);
  const given = Boolean(query.unit || query.plan || query.calibration);
  useLayoutEffect(() => { // not after a question that the address has answered was drawn
    if (choices.plans && given) keep(asked(query, choices));
  }, [choices.plans]);
  useEffect(() => {
    if (step !== "unit") heading.current?.focus(); // there the field has it
  }, [step]);
  if (!may("operator")) return html`<div class="page stack"><div class="notice warn"><p>${t("start.not_allowed")}</p></div>${who.pins && !who.pin_s && html`<${Pin} id="pin-here" head="h1" />`}</div>`;
  const awaited = !choices.plans && (choices.error ? html`<${Trouble} error=${choices.error} retry=${choices.load} />` : html`<${Busy} />`);
  if (awaited && (given || step !== "unit")) return html`<div class="page">${awaited}</div>`;
  const answer = (more) => {
    const next = { ...now, ...more };
    setUnanswered("");
    keep(next, question(next) === step ? "replaceState" : "pushState");
  };
  const station = choices.stations?.find((one) => one.id === now.station);
  const plan = (now.calibration ? choices.calibrations : choices.plans)?.find((one) => one.id === (now.calibration ?? now.plan));
  return html`<div class="start">
    <${Steps} now=${now} step=${step} station=${station} plan=${plan} answer=${answer} />
    <section class="question" aria-labelledby="question">
      <${Already} />
      <h1 id="question" tabindex="-1" ref=${heading}>${t(`start.${step}.question`)}</h1>
      ${step === "unit" && query.station && choices.plans && !asked(query, choices).station && html`<div class="notice warn" role="alert"><p>${t("start.no_such_station", { station: stationName(query.station), unit: query.unit ?? "" })}</p></div>`}
      ${step === "unit" && html`<${UnitQuestion} stations=${choices.stations} last=${lastStation.get()} given=${unanswered} answer=${answer} />`}
      ${awaited}
      ${step === "plan" && html`<${PlanQuestion} plans=${choices.plans} calibrations=${choices.calibrations} station=${station} answer=${answer} />`}
      ${step === "ready" && html`<${Ready} order=${now} answer=${answer} plan=${plan} plans=${choices.plans} station=${station} limits=${choices.limits}
        begun=${() => {
          lastStation.set(now.station);
          forget();
        }} />`}
    </section>
  </div>`;
}

/** The questions and the answers; each answer can be changed. */
function Steps({ now, step, station, plan, answer }) {
  const steps = [
    ["unit", now.units.length > 0 && now.units.map((unit, at) => html`<span key=${unit}>${serialOf(unit)}${at < now.units.length - 1 ? ", " : ""}</span>`), () => answer({ units: [], station: null })],
    ["plan", plan && planTitle(plan), () => answer({ plan: null, calibration: null, limits: null, models: null, anew: false })],
    ["ready", "", null],
  ];
  const at = steps.findIndex(([name]) => name === step);
  return html`<ol class="steps" aria-label=${t("start.steps")}>
    ${steps.map(([name, given, change], index) => html`
      <li key=${name} class=${index < at || given ? "done" : index === at ? "now" : ""} aria-current=${index === at ? "step" : undefined}>
        <span class="mark">${given ? html`<${Shape} tone="good" />` : index + 1}</span>
        <div>
          <span class="what">${t(`start.${name}`)}</span>
          ${given && html`<strong>${given}</strong>`}
          ${name === "unit" && given && html`<span class="soft small">${stationName(station.title)}</span>`}
          ${given && index !== at && html`<button type="button" class="quiet narrow" onClick=${change}>${t("start.change")}<span class="unseen"> ${t(`start.${name}`)}</span></button>`}
          ${name === "unit" && given && html`<${Neighbours} now=${now} station=${station} answer=${answer} />`}
        </div>
      </li>`)}
  </ol>`;
}

/** The other slots of the station, for the same run: with the unit of the station file, or a new one. */
function Neighbours({ now, station, answer }) {
  const [wrong, setWrong] = useState("");
  const [doubled, setDoubled] = useState({ serial: "", slot: "" });
  if (station.units.length < 2) return null;
  const of = (slot) => now.units.find((unit) => slotOf(unit) === slot);
  const put = (slot, unit, meant = false) => {
    const units = station.units.map((one) => (one === slot ? unit : of(one))).filter(Boolean);
    const problem = wrongIn(station.units, Object.fromEntries(units.map((one) => [slotOf(one), serialOf(one)])));
    const twice = unit && !meant && doubledIn([slot], { [slot]: serialOf(unit) }, [slot]);
    setWrong(problem);
    setDoubled(twice ? { serial: serialOf(unit), slot } : { serial: "", slot: "" });
    if (units.length && !problem && !twice) answer({ units });
  };
  const all = now.units.length === station.units.length;
  return html`<fieldset class="neighbours"><legend>${t("start.together")}</legend>
    ${station.units.map((slot) => html`<div key=${slot} class="tick">
      <input type="checkbox" aria-label=${slot} checked=${Boolean(of(slot))} disabled=${now.units.length === 1 && of(slot)} onChange=${() => put(slot, of(slot) ? null : slot)} />
      <${TextField} class="mono" aria-label=${t("start.serial_in", { slot })} value=${serialOf(of(slot) ?? slot)} maxlength="64" onGiven=${(serial) => put(slot, inSlot(serial, slot))} /></div>`)}
    <div aria-live="assertive">${wrong && html`<p class="tone-bad small">${wrong}</p>`}
      ${doubled.slot && html`<${Doubled} serial=${doubled.serial} single=${repeated(doubled.serial, station.units)} take=${(serial) => {
        put(doubled.slot, inSlot(serial, doubled.slot), true);
        document.getElementById("question").focus(); // START takes it from there
      }} />`}</div>
    ${!all && html`<button type="button" class="narrow" onClick=${() => answer({ units: station.units.map((slot) => of(slot) ?? slot) })}>${t("start.all_units", { n: station.units.length })}</button>`}
  </fieldset>`;
}

/** Links to the live runs; one that was cut off does not go on. */
function Already() {
  const runs = useLive((now) => now.runs).filter(({ condition }) => condition !== "gone");
  if (!runs.length) return null;
  return html`<p class="already"><a class="button" href=${runs.length === 1 ? `/live/${runs[0].run}` : "/live"}>
    <${Shape} tone="link" /> ${t("start.already", { n: runs.length, units: runs.flatMap((run) => run.units?.map((unit) => unit.serial) ?? [run.unit]).join(", ") })}
  </a></p>`;
}
