// Choice of the unit: typed, scanned (a scanner types and sends Enter) or chosen from those of the stations.
import { html, useEffect, useRef, useState } from "../../lib/preact.js";
import { Trouble, useTyping } from "../../lib/parts.js";
import { inSlot, repeated, same } from "../../lib/units.js";
import { stationName } from "../../lib/names.js";
import { t } from "../../lib/words.js";
import { session } from "../../lib/store.js";
import { Doubled, isBadge, NoBadge, SlotsForm } from "./slots.js";

/** Characters that a serial number may have. */
const LONGEST = 64;

/** Stations that have this unit, with its serial number as written there. */
export const whereIs = (stations, serial) =>
  stations.flatMap((station) => {
    const found = station.units.find((unit) => same(unit, serial));
    return found ? [{ station, serial: found }] : [];
  });

/** Asks for the unit; what is entered before the `stations` are there, or was `given` by the address, waits for them. */
export function UnitQuestion({ stations, last, given, answer }) {
  const [asked, setAsked] = useState(null);
  const [wrong, setWrong] = useState("");
  const [doubled, setDoubled] = useState({ serial: "", single: "" });
  const [chosen, setChosen] = useState("");
  const [refused, setRefused] = useState("");
  const [filling, setFilling] = useState(null);
  const [early, setEarly] = useState(given);
  const sound = (stations ?? []).filter((station) => !station.problem);
  const take = (serial, meant = false) => {
    if (!stations) return setEarly(serial);
    const tooLong = serial.trim().length > LONGEST;
    const places = tooLong ? [] : whereIs(sound, serial);
    const place = places.length === 1 ? places[0] : null;
    const read = places.length || meant ? "" : repeated(serial, sound.flatMap((station) => station.units));
    const single = tooLong && !whereIs(sound, read).length ? "" : read;
    setDoubled({ serial: serial.trim(), single });
    const own = isBadge(serial);
    setRefused(own ? t("start.own_badge", { name: session.get().name }) : tooLong && !single ? t("start.serial_long", { most: LONGEST }) : "");
    setWrong(places.length || tooLong || single || own ? "" : serial.trim());
    if (place) answer({ units: [place.serial], station: place.station.id });
    else if (places.length) setAsked(places);
    return own && !places.length;
  };
  useEffect(() => {
    if (stations && early) take(early);
  }, [stations]);
  if (filling) return html`<${SlotsForm} station=${filling} answer=${answer} back=${() => setFilling(null)} />`;
  if (asked) return html`<${WhichStation} places=${asked} last=${last} answer=${answer} back=${() => setAsked(null)} />`;
  return html`<${SerialField} take=${take} />
    <div aria-live="assertive">${refused && html`<div class="notice warn"><p>${refused}</p></div>`}${wrong && html`<div class="notice warn"><p>${t("start.unknown_unit", { serial: wrong })}</p><${NoBadge} /></div>`}
      ${doubled.single && html`<${Doubled} ...${doubled} take=${(serial) => {
        take(serial, true);
        setChosen(serial);
      }} />`}</div>
    ${wrong ? html`<${Slots} stations=${sound} last=${last} serial=${wrong} chosen=${wrong === chosen} answer=${answer} />` : stations && html`<h2>${t("start.or_choose")}</h2>`}
    <div class="stations" hidden=${Boolean(wrong)}>
      ${sound.map((station) => html`<${Place} key=${station.id} station=${station}>
        ${station.units.map((serial) => html`<button type="button" key=${serial} class="mono" onClick=${() => answer({ units: [serial], station: station.id })}>${serial}</button>`)}
        ${station.units.length > 1 && html`<button type="button" onClick=${() => answer({ units: station.units, station: station.id })}>${t("start.all_units", { n: station.units.length })}</button>
        <button type="button" onClick=${() => setFilling(station)}>${t("start.slots_fill", { n: station.units.length })}</button>`}
      <//>`)}
    </div>
    ${stations?.filter((station) => station.problem).map((station) => html`<${Trouble} key=${station.id} error=${`${station.id}: ${station.problem}`} />`)}`;
}

/** A station with what can be chosen at it. */
function Place({ station, children }) {
  return html`<section class="station" aria-label=${stationName(station.title)} title=${station.title}>
    <h3>${stationName(station.title)}${station.simulated && html` <span class="soft small">${t("start.simulated")}</span>`}${station.rate_table && html` <span class="soft small">${t("start.rate_table")}</span>`}</h3>
    <div class="row">${children}</div>
  </section>`;
}

/** The slots for a new unit, those of the station that was used last first; they are next where the serial number was `chosen`. */
function Slots({ stations, last, serial, chosen, answer }) {
  const heading = useRef(null);
  useEffect(() => chosen && heading.current.focus(), []);
  const sorted = [...stations].sort((one, other) => Number(other.id === last) - Number(one.id === last));
  return html`<h2 tabindex="-1" ref=${heading}>${t("start.slots", { serial })}</h2>
    <div class="stations">${sorted.map((station) => html`<${Place} key=${station.id} station=${station}>
      ${station.units.map((slot) => html`<button type="button" key=${slot} class="mono" onClick=${() => answer({ units: [inSlot(serial, slot)], station: station.id })}>${t("start.slot", { slot })}</button>`)}
    <//>`)}</div>`;
}

/** A big field that has the focus, and takes it again when typing (or a scan) starts elsewhere. */
function SerialField({ take }) {
  const field = useRef(null);
  useTyping(() => field.current);
  const submit = (event) => {
    event.preventDefault();
    if (field.current.value.trim() && take(field.current.value)) field.current.value = ""; // nobody else shall read a badge
    field.current.select();
  };
  return html`<form class="serial" onSubmit=${submit}>
    <label for="serial">${t("start.serial")}</label>
    <div class="serial-row">
      <input id="serial" ref=${field} name="serial" autocomplete="off" autocapitalize="characters" spellcheck="false" aria-describedby="scan" />
      <button type="submit" class="primary">${t("start.next")}</button>
    </div>
    <p id="scan" class="soft">${t("start.scan")}</p>
  </form>`;
}

function WhichStation({ places, last, answer, back }) {
  const first = useRef(null);
  useEffect(() => first.current?.focus(), []);
  const sorted = [...places].sort((one, other) => Number(other.station.id === last) - Number(one.station.id === last));
  return html`<p class="lead">${t("start.which_station", { serial: places[0].serial })}</p>
    <div class="choices">
      ${sorted.map(({ station, serial }, index) => html`<button type="button" key=${station.id} class="choice" ref=${index ? null : first}
        onClick=${() => answer({ units: [serial], station: station.id })}>
        <strong title=${station.title}>${stationName(station.title)}</strong>
        <span class="soft">${t("start.station_units", { n: station.units.length })}${station.rate_table ? ` · ${t("start.rate_table")}` : ""}${station.simulated ? ` · ${t("start.simulated")}` : ""}</span>
      </button>`)}
    </div>
    <p><button type="button" class="quiet" onClick=${back}>${t("start.back")}</button></p>`;
}
