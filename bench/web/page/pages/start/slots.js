// One serial number for each slot of a station: scanned or typed, Enter goes to the next slot.
import { useTyping } from "../../lib/parts.js";
import { html, useRef, useState } from "../../lib/preact.js";
import { badge, session } from "../../lib/store.js";
import { stationName } from "../../lib/names.js";
import { inSlot, repeated, same } from "../../lib/units.js";
import { t } from "../../lib/words.js";

/** Whether it is the badge, or PIN, by which this page was given to its operator; that of anybody else only the server could know, and must not tell. */
export const isBadge = (text) => Boolean(session.get().pin_s) && text.trim() === badge.get();

/** What is wrong with the serial numbers by slot, in words; empty where nothing is. */
export function wrongIn(slots, serials) {
  const given = slots.map((slot) => (serials[slot] ?? "").trim());
  if (given.some(isBadge)) return t("start.own_badge", { name: session.get().name });
  const twice = given.find((serial, index) => serial && given.findIndex((other) => same(serial, other)) < index);
  if (twice) return t("start.slots_twice", { serial: twice });
  const at = given.findIndex((serial, index) => slots.some((slot, other) => other !== index && same(serial, slot)));
  return at < 0 ? "" : t("start.slots_other", { serial: given[at], slot: slots.find((slot) => same(slot, given[at])) });
}

/** The slot whose serial number repeats one, none of the `meant` ones. */
export const doubledIn = (slots, serials, meant) => slots.find((slot) => serials[slot] && !meant.includes(serials[slot]) && repeated(serials[slot], slots));

/** Asks for the serial number that is meant: the one that is repeated, or the whole as it was typed. */
export const Doubled = ({ serial, single, take }) => html`<div class="notice warn"><p>${t("start.doubled", { serial, single })}</p>
  <div class="row">${[single, serial].map((one) => html`<button type="button" key=${one} class="mono" onClick=${() => take(one)}>${one}</button>`)}</div></div>`;

/** What to do with a badge that was read where a serial number is asked for. The server is not asked whether it is one: that would tell who guesses. */
export const NoBadge = () => session.get().pin_s && html`<p>${t("start.unknown_badge", { leave: t("pin.leave") })}</p>`;

/** The units, each in its slot, as the API names them. */
export const unitsIn = (slots, serials) => slots.filter((slot) => serials[slot]?.trim())
  .map((slot) => inSlot(serials[slot], slot));

/** Form for the slots of `station`; `answer({units, station})` gets those that have a unit. */
export function SlotsForm({ station, answer, back }) {
  const [serials, setSerials] = useState({});
  const [wrong, setWrong] = useState("");
  const [doubled, setDoubled] = useState("");
  const [meant, setMeant] = useState([]);
  const form = useRef(null);
  useTyping(() => [...form.current.querySelectorAll("input")].find((field) => !field.value) ?? form.current.querySelector("input"));
  const submit = (event) => {
    event.preventDefault();
    const fields = [...form.current.querySelectorAll("input")];
    const next = fields[fields.indexOf(document.activeElement) + 1];
    const problem = wrongIn(station.units, serials);
    const twice = doubledIn(station.units, serials, meant);
    setWrong(problem);
    setDoubled(twice);
    if (problem || twice) return fields.find((field) => field === document.activeElement)?.select();
    if (next && event.submitter?.type !== "submit") return next.focus();
    const units = unitsIn(station.units, serials);
    if (units.length) answer({ units, station: station.id });
    return undefined;
  };
  const take = (serial) => {
    const fields = [...form.current.querySelectorAll("input")];
    setSerials({ ...serials, [doubled]: serial });
    setMeant([...meant, serial]);
    setDoubled("");
    (fields[station.units.indexOf(doubled) + 1] ?? form.current.querySelector("[type=submit]")).focus();
  };
  // Enter in a field is not a click on the button: it goes to the next slot, from the last one to the next question.
  const enter = (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    submit({ preventDefault() {}, submitter: null });
  };
  return html`<form class="slots" ref=${form} onSubmit=${submit} aria-labelledby="slots-title">
    <h2 id="slots-title">${t("start.slots_title", { station: stationName(station.title) })}</h2>
    <p class="soft" id="slots-hint">${t("start.slots_hint")}</p><${NoBadge} />
    ${station.units.map((slot) => html`<div key=${slot} class="field"><label for=${`slot-${slot}`}>${t("start.slot", { slot })}</label>
      <input id=${`slot-${slot}`} class="mono" autocomplete="off" autocapitalize="characters" spellcheck=${false} maxlength="64" aria-describedby="slots-hint" value=${serials[slot] ?? ""}
        onKeyDown=${enter} onInput=${(event) => setSerials({ ...serials, [slot]: event.target.value })} /></div>`)}
    <div aria-live="assertive">${wrong && html`<div class="notice warn"><p>${wrong}</p></div>`}
      ${doubled && html`<${Doubled} serial=${serials[doubled]} single=${repeated(serials[doubled], station.units)} take=${take} />`}</div>
    <div class="row"><button type="submit" class="primary" disabled=${!unitsIn(station.units, serials).length}>${t("start.next")}</button>
      <button type="button" class="quiet" onClick=${back}>${t("start.back")}</button></div>
  </form>`;
}
