// Two runs side by side, of one unit or of two: only the differences, largest first.
import { duration, html, or, t, number, runTitle, unitOf, Waiting } from "./parts.js";
import { Chooser } from "./chooser.js";
import { Picture, linked } from "./pictures.js";
import { useJob } from "./session.js";
import { saveCsv } from "../../lib/download.js";
import { Said, Written } from "../../lib/said.js";
import { planTitle, stationName, limitsName } from "../../lib/names.js";
import { quantityWord, sign, symbols } from "../../lib/words.js";

const MOST_ROWS = 40;
const PARTS = () => ({
  quantities: t("workbench.compare.quantities"),
  coefficients: t("workbench.compare.coefficients"),
  segments: t("workbench.compare.segments"),
  facts: t("workbench.compare.facts"),
  losses: t("workbench.compare.losses"),
  profile: t("workbench.compare.profile"),
  station: t("workbench.compare.station"),
  versions: t("workbench.compare.versions"),
});

const OPEN = ["quantities", "coefficients"];

/** Content of a cell as text: 4 digits, a value with its interval, outcome and duration of a segment, `key value` of another object. */
function cell(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "number") return number(value, 4);
  if (typeof value === "boolean") return value ? "✓" : "✕";
  if (Array.isArray(value)) return value.map(cell).join(sign(", "));
  if (typeof value !== "object") return String(value);
  if ("value" in value) {
    const { value: middle, low, high, reason } = value;
    const spread = low !== null && high !== null && low !== high ? `${sign(" (")}${number(low, 3)} … ${number(high, 3)}${sign(")")}` : "";
    return middle === null ? html`<${Said} text=${reason || "–"} />` : `${number(middle, 4)}${spread}`;
  }
  if ("duration_s" in value) return `${or(`units.state.${value.outcome}`, value.outcome)}${sign(", ")}${duration(value.duration_s)}`;
  return Object.entries(value).map(([key, inner]) => `${placed(key)} ${VALUES[key]?.(inner) ?? cell(inner)}`).join(sign(", "));
}

const plainOf = (value) => (value && typeof value === "object" ? value.value ?? JSON.stringify(value) : value);

/** Columns of the tables; of the others the header is their key. */
const HEADS = () => ({
  quantity: t("verdict.head.quantity"), unit: t("verdict.head.unit"), a: "A", b: "B", apart: t("workbench.compare.apart"), key: t("workbench.compare.coefficients"),
  a_std: "A σ", b_std: "B σ", segment: t("workbench.compare.segment"), where: t("workbench.compare.where"), counter: t("workbench.compare.losses"),
});
const NAMES = {
  quantity: quantityWord, unit: symbols, counter: (name) => or(`loss.${name}`, name.replaceAll("_", " ")),
  segment: (text) => html`<${Written} segment text=${text} />`, where: placed,
};

/** A place in a file of settings (`segments[0].to_degc`) in words, as far as the page has them. */
function placed(where) {
  return where.split(".").map((part) => {
    const [, name, index] = part.match(/^(.*?)(?:\[(\d+)\])?$/);
    const word = or(`workbench.compare.at.${name}`, name.replaceAll("_", " "));
    return index === undefined ? word : `${word} ${Number(index) + 1}`;
  }).join(" › ");
}

/** Values that the page has words for, by the last part of their place. */
const VALUES = {
  name: (id) => planTitle({ id, title: id }), station: stationName, limits: (id) => limitsName(id), kind: (kind) => or(`workbench.compare.kind.${kind}`, kind),
  state: (state) => or(`units.state.${state}`, state), purpose: (kind) => or(`units.kind.${kind}`, kind),
};

function valueOf(row, key) {
  if (NAMES[key]) return NAMES[key](row[key]) ?? cell(row[key]);
  const word = typeof row[key] === "string" && VALUES[row.where?.split(".").pop()];
  return word ? word(row[key]) : typeof row[key] === "string" ? html`<${Said} text=${row[key]} />` : cell(row[key]);
}

/** A part of the answer as rows; for an object that contains a list, that list. */
function rowsOf(part) {
  if (Array.isArray(part)) return part.map((row) => (row && typeof row === "object" ? row : { value: row }));
  const list = Object.values(part ?? {}).find((value) => Array.isArray(value));
  return list ?? Object.entries(part ?? {}).map(([name, value]) => ({ name, value }));
}

function Table({ part, caption, name, open }) {
  const rows = rowsOf(part);
  if (!rows.length && !part?.reason) return null;
  const keys = [...new Set(rows.flatMap((row) => Object.keys(row)))];
  const shown = keys.filter((key) => key !== "meaning");
  const heads = HEADS();
  const csv = [keys, ...rows.map((row) => keys.map((key) => plainOf(row[key])))];
  return html`<details class="wb-card wb-table" open=${open}>
    <summary><h3>${caption}</h3> <span class="wb-soft">${rows.length || "–"}</span></summary>
    ${part?.reason && html`<p class="wb-soft"><${Said} text=${part.reason} /></p>`}
    ${rows.length > 0 && html`<div class="wb-scroll" tabindex="0" role="region" aria-label=${caption}><table><thead><tr>${shown.map((key) => html`<th key=${key} scope="col">${heads[key] ?? key}</th>`)}</tr></thead>
      <tbody>${rows.slice(0, MOST_ROWS).map((row, i) => html`<tr key=${i} title=${row.meaning}>${shown.map((key) => html`<td key=${key} class=${typeof row[key] === "number" ? "wb-n" : ""}>${valueOf(row, key)}</td>`)}</tr>`)}</tbody></table></div>`}
    ${rows.length > MOST_ROWS && html`<p class="wb-soft">${t("workbench.compare.more", { count: String(rows.length - MOST_ROWS) })}</p>`}
    ${rows.length > 0 && html`<p><button type="button" class="narrow" onClick=${() => saveCsv(name, csv)}>CSV</button></p>`}
  </details>`;
}

/** Both runs in one figure; the difference of their model curves if both have one. */
function Pictured({ a, b, difference }) {
  const both = useJob("/figures", { kind: "temperature", runs: [a], check: [b], model: null });
  const { mark, onPoint, told } = linked("pair", "temperature", both.result, "");
  return html`<div class="wb-pair-pictures">
    <section class="wb-card"><h3>${t("workbench.figure.temperature")}</h3>${both.failed && html`<p class="wb-bad" role="alert"><${Said} text=${both.failed} /></p>`}
      ${told}
      <${Picture} answer=${both.result} job=${both} onPoint=${onPoint} mark=${mark} title=${t("workbench.figure.temperature")} name=${`${a} ${b}`} /></section>
    ${difference?.figure && html`<section class="wb-card"><h3>${t("workbench.compare.curves")}</h3>
      <${Picture} answer=${difference} title=${t("workbench.compare.curves")} name=${`${a} ${b} curves`} /></section>`}
  </div>`;
}

/** `a` and `b` are run ids; `setB` chooses the other one, none at first. */
export function Compare({ a, b, setB, onClose }) {
  const job = useJob("/differences", b ? { a, b } : null);
  const parts = PARTS();
  const told = (run) => html`<b>${unitOf(run)}</b> ${runTitle(run)}`;
  const found = job.result;
  const differing = found ? Object.keys(parts).filter((key) => found[key] && (rowsOf(found[key]).length || found[key].reason)) : [];
  return html`<div class="wb-compare">
    <div class="wb-card-head"><h2>${t("workbench.compare.title")}</h2><button type="button" class="narrow" onClick=${onClose}>${t("workbench.compare.close")}</button></div>
    <p class="wb-pair"><span>A ${told(a)}</span> ${b && html`<span>B ${told(b)} <button type="button" class="wb-link" onClick=${() => setB("")}>${t("workbench.compare.another")}</button></span>`}</p>
    ${!b && html`<${Chooser} label=${t("workbench.compare.choose")} taken=${new Set([a])} onChoose=${(row) => row.run !== a && setB(row.run)} />`}
    ${b && html`<${Pictured} a=${a} b=${b} difference=${found?.figure} />`}
    <${Waiting} job=${job}>${t("workbench.compare.running")}<//>
    ${job.failed && html`<p class="wb-bad" role="alert"><${Said} text=${job.failed} /></p>`}
    ${found && !differing.length && html`<p role="status">${t("workbench.compare.same")}</p>`}
    ${differing.map((key) => html`<${Table} key=${key} part=${found[key]} caption=${parts[key]} open=${OPEN.includes(key)} name=${`${a} ${b} ${key}`} />`)}
  </div>`;
}
