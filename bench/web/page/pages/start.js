// The operator's start page: asks for unit, plan and confirmation, one question at a time.
import { html, useEffect, useRef, useState } from "../lib/preact.js";
import { get } from "../lib/api.js";
import { useLive } from "../lib/live.js";
import { Busy, Shape, Trouble } from "../lib/parts.js";
import { may, remembered, store, useStore } from "../lib/store.js";
import { t } from "../lib/words.js";
import { PlanQuestion, planTitle } from "./start/plan.js";
import { Ready } from "./start/ready.js";
import { UnitQuestion } from "./start/unit.js";

const NOTHING = { units: [], station: null, plan: null };
/** The answers so far; kept while the operator views another page. */
const order = store(NOTHING);
/** Station of the last start in this browser. */
const lastStation = remembered("station", null);

const question = ({ units, station, plan }) => (!units.length || !station ? "unit" : !plan ? "plan" : "ready");

/** Plans and stations, read once when the page opens. */
function useChoices() {
  const [choices, setChoices] = useState(/** @type {any} */ ({}));
  const load = () => {
    Promise.all([get("/plans"), get("/stations"), get("/limits").catch(() => ({ limits: [] }))]).then(
      ([{ plans }, { stations }, { limits }]) => setChoices({ plans, stations, limits }),
      (error) => setChoices({ error }),
    );
  };
  useEffect(load, []);
  return { ...choices, load };
}

/** The answers in the address, if they exist: `/start?unit=…&station=…&plan=…`. */
function asked({ unit, station, plan }, { plans, stations }) {
  const units = unit ? unit.split(",") : [];
  const there = stations.filter((one) => units.length && units.every((serial) => one.units.includes(serial)));
  const place = there.find((one) => one.id === station) ?? (there.length === 1 ? there[0] : null);
  return {
    units: place ? units : [],
    station: place?.id ?? null,
    plan: plans.some((one) => one.id === plan) ? plan : null,
  };
}

export default function Start({ query }) {
  const choices = useChoices();
  const now = useStore(order);
  const heading = useRef(null);
  const step = question(now);
  useEffect(() => {
    if (choices.plans && (query.unit || query.plan)) order.set(asked(query, choices));
  }, [choices.plans]);
  useEffect(() => heading.current?.focus(), [step]);
  if (!may("operator")) return html`<div class="page"><div class="notice warn"><p>${t("start.not_allowed")}</p></div></div>`;
  if (choices.error) return html`<div class="page"><${Trouble} error=${choices.error} retry=${choices.load} /></div>`;
  if (!choices.plans) return html`<div class="page"><${Busy} /></div>`;
  const answer = (more) => order.set({ ...now, ...more });
  const station = choices.stations.find((one) => one.id === now.station);
  const plan = choices.plans.find((one) => one.id === now.plan);
  return html`<div class="start">
    <${Steps} now=${now} step=${step} station=${station} plan=${plan} answer=${answer} />
    <section class="question" aria-labelledby="question">
      <${Already} />
      <h1 id="question" tabindex="-1" ref=${heading}>${t(`start.${step}.question`)}</h1>
      ${step === "unit" && html`<${UnitQuestion} stations=${choices.stations} last=${lastStation.get()} answer=${answer} />`}
      ${step === "plan" && html`<${PlanQuestion} plans=${choices.plans} station=${station} answer=${answer} />`}
      ${step === "ready" && html`<${Ready} order=${now} plan=${plan} station=${station} limits=${choices.limits}
        begun=${() => {
          lastStation.set(now.station);
          order.set(NOTHING);
        }} />`}
    </section>
  </div>`;
}

/** The questions and the answers; each answer can be changed. */
function Steps({ now, step, station, plan, answer }) {
  const steps = [
    ["unit", now.units.join(", "), () => answer({ units: [], station: null })],
    ["plan", plan && planTitle(plan), () => answer({ plan: null })],
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
          ${name === "unit" && given && html`<span class="soft small">${station.title}</span>`}
          ${given && index !== at && html`<button type="button" class="quiet narrow" onClick=${change}>${t("start.change")}<span class="unseen"> ${t(`start.${name}`)}</span></button>`}
          ${name === "unit" && given && html`<${Neighbours} now=${now} station=${station} answer=${answer} />`}
        </div>
      </li>`)}
  </ol>`;
}

/** Other units of the station, for the same run. */
function Neighbours({ now, station, answer }) {
  if (station.units.length < 2) return null;
  const turn = (serial) => answer({
    units: station.units.filter((one) => (one === serial ? !now.units.includes(serial) || now.units.length === 1 : now.units.includes(one))),
  });
  const all = now.units.length === station.units.length;
  return html`<fieldset class="neighbours"><legend>${t("start.together")}</legend>
    ${station.units.map((serial) => html`<label key=${serial} class="tick">
      <input type="checkbox" checked=${now.units.includes(serial)} disabled=${now.units.length === 1 && now.units[0] === serial} onChange=${() => turn(serial)} /> ${serial}</label>`)}
    ${!all && html`<button type="button" class="narrow" onClick=${() => answer({ units: station.units })}>${t("start.all_units", { n: station.units.length })}</button>`}
  </fieldset>`;
}

/** Links to the live runs. */
function Already() {
  const runs = useLive((now) => now.runs);
  if (!runs.length) return null;
  return html`<p class="already"><a class="button" href=${runs.length === 1 ? `/live/${runs[0].run}` : "/live"}>
    <${Shape} tone="link" /> ${t("start.already", { n: runs.length, units: runs.flatMap((run) => run.units?.map((unit) => unit.serial) ?? [run.unit]).join(", ") })}
  </a></p>`;
}
