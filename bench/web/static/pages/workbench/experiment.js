// The next experiment: why the runs so far cannot decide, the temperature that would, and its start.
import { html, t, api, duration, useEffect, useState } from "./parts.js";
import { effectWord } from "./effects.js";
import { palette, onTheme } from "../../lib/figure.js";

const WIDTH = 420;
const HEIGHT = 150;
const EDGE = { left: 38, right: 10, top: 10, bottom: 26 };

/** Temperature over time, `curve` [[t_s, degc]...]. */
export function Curve({ curve, label }) {
  const [, repaint] = useState(0);
  useEffect(() => onTheme(() => repaint((n) => n + 1)), []);
  if (!curve?.length) return null;
  const colours = palette();
  const times = curve.map(([time]) => time);
  const temperatures = curve.map(([, degc]) => degc);
  const [low, high] = [Math.min(...temperatures), Math.max(...temperatures)];
  const end = Math.max(...times) || 1;
  const x = (time) => EDGE.left + ((WIDTH - EDGE.left - EDGE.right) * time) / end;
  const y = (degc) => HEIGHT - EDGE.bottom - ((HEIGHT - EDGE.top - EDGE.bottom) * (degc - low)) / (high - low || 1);
  const path = curve.map(([time, degc], i) => `${i ? "L" : "M"}${x(time).toFixed(1)},${y(degc).toFixed(1)}`).join("");
  const text = { "font-size": 12, fill: colours.soft };
  return html`<svg class="wb-curve" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label=${label}>
    ${[low, high].map((degc) => html`<g key=${degc}>
      <line x1=${EDGE.left} x2=${WIDTH - EDGE.right} y1=${y(degc)} y2=${y(degc)} stroke=${colours.grid} />
      <text ...${text} x=${EDGE.left - 6} y=${y(degc) + 4} text-anchor="end">${Math.round(degc)}°</text></g>`)}
    <path d=${path} fill="none" stroke=${colours.heldOut} stroke-width="2.2" stroke-linejoin="round" />
    <text ...${text} x=${EDGE.left} y=${HEIGHT - 6}>0</text>
    <text ...${text} x=${WIDTH - EDGE.right} y=${HEIGHT - 6} text-anchor="end">${duration(end)}</text>
  </svg>`;
}

/** Asks for the station, then starts the proposed run; it moves equipment, so it is never one click. */
function Start({ plan, unit, onClose }) {
  const [stations, setStations] = useState([]);
  const [station, setStation] = useState("");
  const [units, setUnits] = useState(unit);
  const [busy, setBusy] = useState(false);
  const [failed, setFailed] = useState("");
  useEffect(() => {
    api.get("/stations").then(({ stations: found }) => {
      setStations(found);
      const own = found.find((one) => one.units.includes(unit)) ?? found[0];
      if (own) choose(own);
    }, (error) => setFailed(error.message));
  }, []);
  const choose = (one) => {
    setStation(one.id);
    setUnits(one.units.includes(unit) ? unit : one.units[0] ?? unit);
  };
  const start = async () => {
    setBusy(true);
    try {
      await api.post("/starts", { plan, station, units: [units] });
      globalThis.location.assign("/live");
    } catch (error) {
      setFailed(error.message);
      setBusy(false);
    }
  };
  const offered = stations.find((one) => one.id === station)?.units ?? [];
  return html`<div class="wb-start" role="group" aria-label=${t("workbench.next.run")}>
    <label>${t("workbench.next.station")}<select value=${station} onChange=${(event) => choose(stations.find((one) => one.id === event.target.value))}>
      ${stations.map((one) => html`<option key=${one.id} value=${one.id} selected=${one.id === station}>${one.title || one.id}</option>`)}</select></label>
    <label>${t("workbench.next.unit")}<select value=${units} onChange=${(event) => setUnits(event.target.value)}>
      ${[...new Set([...offered, ...(offered.length ? [] : [unit])])].map((one) => html`<option key=${one} value=${one} selected=${one === units}>${one}</option>`)}</select></label>
    ${!offered.includes(unit) && offered.length > 0 && html`<p class="wb-warn">${t("workbench.next.other_unit", { unit })}</p>`}
    ${failed && html`<p class="wb-bad" role="alert">${failed}</p>`}
    <p><button type="button" class="primary narrow" disabled=${busy || !station} onClick=${start}>${t("workbench.next.start")}</button>${" "}
      <button type="button" class="narrow" onClick=${onClose}>${t("workbench.next.cancel")}</button></p>
  </div>`;
}

/** `next`: `next_experiment` of a diagnosis. */
export function NextExperiment({ next, unit }) {
  const [asked, setAsked] = useState(false);
  if (!next) return null;
  const rivals = next.separates.map(effectWord).join(" ⇄ ");
  return html`<section class="wb-card wb-next" aria-labelledby="wb-next-title">
    <h3 id="wb-next-title">${t("workbench.next.title")}</h3>
    <p class="wb-lead">⇄ ${t("workbench.next.cannot", { effects: rivals })}</p>
    <p lang="en">${next.why}</p>
    <${Curve} curve=${next.curve} label=${t("workbench.next.curve", { duration: duration(60 * next.duration_min) })} />
    ${next.probability_after !== null && next.probability_after !== undefined && html`<p class="wb-soft">
      ${t("workbench.next.chance", { before: Math.round(100 * (next.probability_before ?? 0)), after: Math.round(100 * next.probability_after) })}</p>`}
    ${next.plan && (asked
      ? html`<${Start} plan=${next.plan} unit=${unit} onClose=${() => setAsked(false)} />`
      : html`<button type="button" class="primary narrow" onClick=${() => setAsked(true)}>${t("workbench.next.run")} (${duration(60 * next.duration_min)})</button>`)}
  </section>`;
}
