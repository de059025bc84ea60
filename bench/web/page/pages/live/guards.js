// Guards as traffic lights: colour, shape and word; tripped ones first.
import { html } from "../../lib/preact.js";
import { Lamp, Shape } from "../../lib/parts.js";
import { or, t } from "../../lib/words.js";
import { Said } from "../../lib/said.js";
import { valueOf } from "./words.js";

const TONES = { ok: "good", waiting: "warn", tripped: "bad" };
const ORDER = Object.keys(TONES).reverse();

export const guardName = (guard) => or(`guard.${guard.name}`, guard.name);

/** `old`: the last known state, in which no light is green. */
export function Guards({ guards = [], old = false }) {
  const sorted = [...guards].sort((one, other) => ORDER.indexOf(one.state) - ORDER.indexOf(other.state));
  const worst = sorted[0]?.state;
  const toneOf = (state) => (old && state === "ok" ? "idle" : TONES[state]);
  const word = old ? "guards.old" : worst === "ok" ? "guards.all_ok" : `guards.${worst}`;
  return html`<section class="guards panel" aria-label=${t("live.guards")}>
    <header class="row spread"><h2>${t("live.guards")}</h2>
      ${worst && html`<${Lamp} tone=${toneOf(worst)}>${t(word)}<//>`}</header>
    <ul>${sorted.map((guard) => html`<li key=${guard.name} class=${guard.state}>
      <span class=${`tone-${toneOf(guard.state)}`}><${Shape} tone=${toneOf(guard.state)} /></span>
      <span class="guard-name">${guardName(guard)}<span class="unseen">: </span>
        ${guard.text && html`<small><${Said} text=${guard.text} /></small>`}</span>
      <span class="guard-state figures">${guard.state === "ok" ? valueOf(guard) || t("guards.ok") : html`<b class=${`tone-${TONES[guard.state]}`}>${t(`guards.${guard.state}`)}</b>`}</span>
    </li>`)}</ul>
  </section>`;
}
