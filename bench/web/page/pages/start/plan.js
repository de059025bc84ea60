// Choice of the plan: each with its temperature curve, duration and purpose.
import { html, useState } from "../../lib/preact.js";
import { Curve, range } from "../../lib/curve.js";
import { between, degrees, forecast, number, searched, t } from "../../lib/words.js";
import { Said } from "../../lib/said.js";
import { isOffered, isOwn, planPurpose, planTitle } from "../../lib/names.js";

const MOST = 24;

const fits = (plan, words) => {
  const text = searched(`${plan.id} ${planTitle(plan)} ${planPurpose(plan)}`);
  return words.toLowerCase().split(/\s+/).every((word) => text.includes(word));
};

const can = (station, plan) => !plan.problem && (plan.kind === "temperature" || (plan.kind === "imu" ? station.fixture : station.rate_table));

/** Whole calibrations first, then single runs, then what a diagnosis proposed. */
export function PlanQuestion({ plans, calibrations, station, answer }) {
  const [words, setWords] = useState("");
  const possible = plans.filter((plan) => can(station, plan) && isOffered(plan));
  const found = possible.filter((plan) => fits(plan, words));
  const [shown, proposed] = [found.filter((plan) => !plan.proposed), found.filter((plan) => plan.proposed)];
  const whole = calibrations.filter((plan) => can(station, plan) && fits(plan, words));
  const broken = [...calibrations, ...plans].filter((plan) => plan.problem);
  return html`
    ${possible.length > 9 && html`<p><label class="unseen" for="plan-filter">${t("plan.filter")}</label>
      <input id="plan-filter" class="filter" type="search" placeholder=${t("plan.filter")} value=${words} onInput=${(event) => setWords(event.target.value)} /></p>`}
    ${whole.length > 0 && html`<h2>${t("plan.whole")}</h2>
      <div class="plans">${whole.map((plan) => html`<${PlanCard} key=${plan.id} plan=${plan} choose=${() => answer({ calibration: plan.id, plan: null })} />`)}</div>
      <h2>${t("plan.single")}</h2>`}
    <div class="plans">
      ${shown.slice(0, MOST).map((plan) => html`<${PlanCard} key=${plan.id} plan=${plan} choose=${() => answer({ plan: plan.id, calibration: null })} />`)}
    </div>
    ${shown.length > MOST && html`<p class="soft">${t("plan.more", { n: shown.length - MOST })}</p>`}
    ${proposed.length > 0 && html`<details open=${words !== ""}><summary>${t("plan.proposed", { n: proposed.length })}</summary>
      <div class="plans">${proposed.slice(0, MOST).map((plan) => html`<${PlanCard} key=${plan.id} plan=${plan} choose=${() => answer({ plan: plan.id, calibration: null })} />`)}</div>
      ${proposed.length > MOST && html`<p class="soft">${t("plan.more", { n: proposed.length - MOST })}</p>`}</details>`}
    ${!found.length && !whole.length && html`<p class="soft">${t("plan.none")}</p>`}
    ${broken.length > 0 && html`<details><summary>${t("plan.broken", { n: broken.length })}</summary>
      <ul>${broken.map((plan) => html`<li key=${plan.id}><code>${plan.id}</code>: <${Said} text=${plan.problem} /></li>`)}</ul></details>`}`;
}

function PlanCard({ plan, choose }) {
  const [low, high] = range(plan.curve);
  return html`<button type="button" class="plan" onClick=${choose}>
    <strong>${planTitle(plan)}</strong>
    <${Curve} curve=${plan.curve} />
    <span class="facts figures"><b>${t("plan.takes", { time: forecast(plan.nominal_s) })}</b><span>${low === high ? degrees(low, 0) : between(number(low, 0), degrees(high, 0))}</span></span>
    <span class="purpose soft">${isOwn(plan) ? plan.summary : html`<${Said} text=${planPurpose(plan)} />`}</span>
  </button>`;
}
