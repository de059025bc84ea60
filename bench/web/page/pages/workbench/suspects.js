// Missing effects: the verdict, the suspects in order of evidence, and their actions.
import { html, or, t, useState, measured, number, Waiting, uneven } from "./parts.js";
import { parameterWord, quantity, sentences } from "./sentence.js";
import { between, effectWord, effectsWord, joined, sign, symbols } from "../../lib/words.js";
import { Said } from "../../lib/said.js";
import { outcomeWord, toneOf } from "../verdict/judged.js";

const SHOWN = 4;

/** Evidence as a bar with a mark at the threshold. */
function Evidence({ value, threshold, most, found }) {
  const share = (x) => `${Math.max(0, Math.min(100, (100 * x) / most))}%`;
  const beyond = value > threshold;
  const word = beyond ? "workbench.suspect.beyond" : found ? "workbench.suspect.borne" : "workbench.suspect.chance";
  return html`<div class="wb-evidence">
    <div class="wb-bar" aria-hidden="true">
      <span class=${beyond ? "wb-fill" : "wb-fill wb-faint"} style=${{ width: share(value) }}></span>
      <span class="wb-threshold" style=${{ left: share(threshold) }}></span>
    </div>
    <span class="wb-evidence-word">${t("workbench.suspect.evidence", { value: number(value) })}${sign(", ")}
      ${t(word, { threshold: number(threshold, 2) })}</span>
  </div>`;
}

function Parameters({ parameters }) {
  const names = Object.keys(parameters ?? {});
  if (!names.length) return null;
  return html`<dl class="wb-parameters">${names.map((name) => html`<div key=${name}>
    <dt title=${name}>${parameterWord(name)}</dt>
    <dd>${measured(parameters[name])}${parameters[name].interval && (parameters[name].at_bound || !uneven(parameters[name]))
      ? html` <span class="wb-soft">[${parameters[name].interval.map((end) => number(end)).join(" … ")}]</span>` : null}
      ${parameters[name].at_bound ? html` <span class="wb-warn">${t("workbench.suspect.at_bound")}</span>` : null}</dd>
  </div>`)}</dl>`;
}

/** What the errors of a diagnosis are on: they are not those of the comparison. */
const seenOn = ({ held_out_by }) => t(held_out_by === "check" ? "workbench.suspect.on_check" : "workbench.suspect.on_blocks");

/** Change of the error on unseen data when it is added. */
function Gain({ suspect, found }) {
  if (suspect.held_out_rms_dph === null) return suspect.reason ? html`<p class="wb-soft"><${Said} text=${suspect.reason} /></p>` : null;
  return html`<p><b>${number(suspect.held_out_before_dph)} → ${number(suspect.held_out_rms_dph)} ${symbols("deg/h")}</b> ${seenOn(found)}${
    suspect.removes === null ? "" : `, ${t("workbench.suspect.removes", { percent: Math.round(100 * suspect.removes) })}`}</p>`;
}

/** What comes with a suspect or a formula: it was judged beside these. */
const Beside = ({ effects }) => effects.length > 0 && html`<p>${t("workbench.formula.beside", { effects: effects.map(effectWord).join(", ") })}</p>`;

/** Whether a unit's memory can hold a suspect or a formula. */
const Held = ({ unheld }) => html`<p class="wb-soft">${unheld ? html`${t("workbench.suspect.unheld")} <${Said} text=${unheld} />` : `✓ ${t("workbench.suspect.held")}`}</p>`;

function Suspect({ suspect, first, found, most, busy, picked, onAdd, onPicture }) {
  const name = effectWord(suspect.effect);
  const whole = suspect.found || picked;
  return html`<li class=${`wb-suspect ${suspect.found ? "wb-found" : ""}`}>
    <div class="wb-suspect-head">
      <h4 title=${`effect: ${suspect.effect}`}>${name} ${whole && html`<code>${suspect.effect}</code>`}</h4>
      ${suspect.partial && html`<button type="button" class="wb-link" aria-pressed=${picked ? "true" : "false"}
        aria-label=${`${picked ? t("workbench.suspect.picture_off") : t("workbench.suspect.picture")}${sign(": ")}${name}`}
        onClick=${() => onPicture(picked ? "" : suspect.effect)}>${picked ? t("workbench.suspect.picture_off") : t("workbench.suspect.picture")}</button>`}
      <button type="button" class=${first ? "primary narrow" : "narrow"} disabled=${busy} onClick=${() => onAdd(suspect)}
        aria-label=${t("workbench.suspect.add_named", { effect: name })}>${t("workbench.suspect.add")}</button>
    </div>
    <${Evidence} value=${suspect.evidence} threshold=${found.threshold} most=${most} found=${suspect.found} />
    ${whole && html`<${Gain} suspect=${suspect} found=${found} />
      <${Beside} effects=${suspect.add.slice(0, -1).map(({ effect }) => effect)} />
      <${Parameters} parameters=${suspect.parameters} />
      <${Held} unheld=${suspect.unheld} />
      <p class="wb-soft">${or(`workbench.summary.${suspect.effect}`, suspect.summary)}</p>`}
    ${suspect.look_alikes.length > 0 && html`<p class="wb-warn">⇄ ${t("workbench.suspect.look_alikes", { effects: joined(suspect.look_alikes.map(effectWord)) })}</p>`}
  </li>`;
}

/** Whether a formula is what to add first: the catalogue does not hold what is missing. */
export const leads = ({ verdict, formulas }) => verdict === "unknown_effect" && formulas?.length > 0;

/** Formulas for what the catalogue does not hold. */
function Formulas({ found, lead, busy, picked, onAdd, onPicture }) {
  if (!found.formulas?.length) return null;
  const shown = found.formulas.slice(0, SHOWN);
  const held = shown.find(({ unheld }) => !unheld);
  return html`<h3>${t("workbench.formula.title")}</h3><ol class="wb-suspects">${shown.map((one, i) => html`<li key=${one.formula} class=${`wb-suspect ${i ? "" : "wb-found"}`}>
    <div class="wb-suspect-head"><h4><code>${one.formula}</code></h4>
      ${one.partial && html`<button type="button" class="wb-link" aria-pressed=${picked === one.formula ? "true" : "false"}
        aria-label=${`${picked === one.formula ? t("workbench.suspect.picture_off") : t("workbench.suspect.picture")}${sign(": ")}${one.formula}`}
        onClick=${() => onPicture(picked === one.formula ? "" : one.formula)}>${
          picked === one.formula ? t("workbench.suspect.picture_off") : t("workbench.suspect.picture")}</button>`}
      <button type="button" class=${lead && !i && !one.unheld ? "primary narrow" : "narrow"} disabled=${busy} onClick=${() => onAdd(one)}
        aria-label=${t("workbench.suspect.add_named", { effect: one.formula })}>${t("workbench.suspect.add")}</button></div>
    ${!i && one.unheld && held && html`<p class="wb-warn">${t("workbench.formula.next", { formula: held.formula, after: number(held.held_out_rms_dph), best: number(one.held_out_rms_dph) })}</p>`}
    <p><span class="wb-evidence-word">${t("workbench.suspect.evidence", { value: number(one.evidence) })}</span>${sign(", ")}
      <b>${number(one.held_out_before_dph)} → ${number(one.held_out_rms_dph)} ${symbols("deg/h")}</b> ${seenOn(found)}</p>
    <${Beside} effects=${one.beside} />
    <${Held} unheld=${one.unheld} />
    <p class="wb-soft"><${Said} text=${[one.words, one.like].filter(Boolean).join("; ")} /></p>
    ${one.equivalent.slice(0, 3).map((text) => html`<p key=${text} class="wb-warn">⇄ <code>${effectsWord(text)}</code></p>`)}
    ${one.caution && html`<p class="wb-warn"><${Said} text=${one.caution} /></p>`}
  </li>`)}</ol>`;
}

const FURTHER = () => ({
  map: t("workbench.diagnosis.map"),
  legs: t("workbench.diagnosis.legs"),
  misfit: t("workbench.diagnosis.misfit"),
});

/** The picture {id, title, answer} of a diagnosis: of a suspect or a formula over its coordinate, or one of all; null without it. */
export function pictureOf(found, id) {
  const suspect = found?.suspects.find(({ effect }) => effect === id);
  const formula = found?.formulas?.find((one) => one.formula === id);
  const answer = suspect?.partial ?? formula?.partial ?? found?.figures?.[id];
  if (!answer) return null;
  const title = suspect ? `${t("workbench.figure.partial")}${sign(": ")}${effectWord(id)}` : formula ? t("workbench.formula.picture") : FURTHER()[id];
  return { id, title, answer };
}

/** Pictures of the whole diagnosis: the map before and after, the evidence by segment, where it fails most. */
function Further({ figures, picked, onPicture }) {
  const words = FURTHER();
  const there = Object.keys(words).filter((key) => figures?.[key]);
  if (!there.length) return null;
  return html`<p class="wb-further">${there.map((key) => html`<button type="button" key=${key} class="wb-link" aria-pressed=${picked === key ? "true" : "false"}
    onClick=${() => onPicture(picked === key ? "" : key)}>${words[key]}</button>`)}</p>`;
}

/** Ends of a place, with enough digits to distinguish them. */
function span({ from, to, unit }) {
  const digits = [4, 6, 8].find((many) => number(from, many) !== number(to, many)) ?? 8;
  return between(number(from, digits), `${number(to, digits)} ${symbols(unit)}`.trim());
}

const dph = (value) => `${number(value)} ${symbols("deg/h")}`;

/** Places: what is systematic there, and the RMS beside the floor, which may be below 1 where a misfit is certain. */
function Where({ places }) {
  if (!places?.length) return null;
  return html`<details class="wb-where" open><summary>${t("workbench.where.title")}</summary><ul>
    ${places.slice(0, 5).map((place, i) => html`<li key=${i}>
      <b>${quantity(place.channel)}</b> ${span(place)}${sign(": ")}
      ${t("workbench.where.misfit", { misfit: dph(place.misfit_dph) })}${sign(", ")}
      ${place.floor_ratio === null ? `${t("figure.label.RMS")} ${dph(place.rms_dph)}` : t("workbench.where.ratio", { ratio: number(place.floor_ratio, 2) })}
      ${place.note ? html` <span class="wb-soft"><${Said} text=${place.note} /></span>` : null}</li>`)}
  </ul></details>`;
}

/** `found`: content of `bench diagnose`, or null while `waiting` for it; `failed`: its message. */
export function Suspects({ found, failed, waiting, busy, picked, onAdd, onPicture }) {
  const [all, setAll] = useState(false);
  if (failed) return html`<p class="wb-bad" role="alert"><${Said} text=${failed} /></p>`;
  if (!found) return html`<${Waiting} job=${waiting}>${t("workbench.diagnosis.running")}<//>`;
  const most = Math.max(found.threshold * 1.5, ...found.suspects.map((suspect) => suspect.evidence ?? 0));
  const [first, ...rest] = sentences(found);
  const lead = leads(found);
  const shown = all ? found.suspects : found.suspects.slice(0, Math.max(SHOWN, found.suspects.filter((s) => s.found).length));
  return html`<div class="wb-diagnosis">
    <div class=${`wb-verdict wb-${toneOf(found.verdict)}`} role="status">
      <p class="wb-word">${outcomeWord(found.verdict)}</p>
      <p>${first}</p>
      ${found.verdict === "adequate" && found.noise_finding && html`<p><${Said} text=${found.noise_finding} whole /></p>`}
      ${rest.length > 0 && html`<details><summary>${t("workbench.diagnosis.whole")}</summary><p>${rest.join(sign(" "))}</p></details>`}
    </div>
    <${Formulas} found=${found} lead=${lead} busy=${busy} picked=${picked} onAdd=${onAdd} onPicture=${onPicture} />
    ${found.suspects.length > 0 && html`<h3>${t("workbench.suspect.title")}</h3>`}
    <ol class="wb-suspects">${shown.map((suspect, i) => html`<${Suspect} key=${suspect.effect} ...${{ suspect, found, most, busy, onAdd, onPicture }}
      first=${i === 0 && suspect.found && !lead} picked=${picked === suspect.effect} />`)}</ol>
    ${found.suspects.length > shown.length && html`<button type="button" class="wb-link" onClick=${() => setAll(true)}>
      ${t("workbench.suspect.more", { count: found.suspects.length - shown.length })}</button>`}
    <${Further} figures=${found.figures} picked=${picked} onPicture=${onPicture} />
    <${Where} places=${found.verdict === "unknown_effect" && found.suspects.some((suspect) => suspect.found) ? [...found.unexplained, ...found.where] : found.where} />
    ${(found.notes?.length > 0 || found.not_excited?.length > 0) && html`<details><summary>${t("workbench.diagnosis.notes")}</summary><ul>
      ${found.verdict !== "adequate" && found.noise_finding && html`<li><${Said} text=${found.noise_finding} /></li>`}
      ${found.notes.map((note) => html`<li key=${note}><${Said} text=${note} /></li>`)}
      ${found.not_excited.map((one) => html`<li key=${one.effect}>${effectWord(one.effect)}${sign(": ")}<${Said} text=${one.reason} /></li>`)}</ul></details>`}
  </div>`;
}
