// Two runs side by side, of one unit or of two: only what differs, worst first.
import { html, t, number, runName, unitOf, useState } from "./parts.js";
import { Chooser } from "./chooser.js";
import { useJob } from "./session.js";
import { saveCsv } from "../../lib/download.js";

const MOST_ROWS = 40;
const PARTS = () => ({
  curves: t("workbench.compare.curves"),
  quantities: t("workbench.compare.quantities"),
  coefficients: t("workbench.compare.coefficients"),
  segments: t("workbench.compare.segments"),
  facts: t("workbench.compare.facts"),
  losses: t("workbench.compare.losses"),
  profile: t("workbench.compare.profile"),
  station: t("workbench.compare.station"),
  versions: t("workbench.compare.versions"),
});

const cell = (value) => {
  if (value === null || value === undefined) return "–";
  if (typeof value === "number") return number(value, 4);
  if (typeof value === "boolean") return value ? "✓" : "✕";
  return typeof value === "object" ? JSON.stringify(value) : String(value);
};

/** A list of objects as a table of their keys. */
function Table({ rows, caption, name }) {
  const list = Array.isArray(rows) ? rows : Object.entries(rows ?? {}).map(([key, value]) => ({ name: key, value }));
  if (!list.length) return null;
  const flat = list.map((row) => (row && typeof row === "object" ? row : { value: row }));
  const keys = [...new Set(flat.flatMap((row) => Object.keys(row)))].filter((key) => !Array.isArray(flat[0][key]) || typeof flat[0][key][0] !== "number");
  const csv = [keys, ...flat.map((row) => keys.map((key) => (typeof row[key] === "object" && row[key] !== null ? JSON.stringify(row[key]) : row[key])))];
  return html`<section class="wb-card wb-table">
    <div class="wb-card-head"><h3>${caption}</h3><button type="button" class="narrow" onClick=${() => saveCsv(name, csv)}>CSV</button></div>
    <div class="wb-scroll" tabindex="0" role="region" aria-label=${caption}><table><thead><tr>${keys.map((key) => html`<th key=${key} scope="col">${key.replaceAll("_", " ")}</th>`)}</tr></thead>
      <tbody>${flat.slice(0, MOST_ROWS).map((row, i) => html`<tr key=${i}>${keys.map((key) => html`<td key=${key} class=${typeof row[key] === "number" ? "wb-n" : ""}>${cell(row[key])}</td>`)}</tr>`)}</tbody></table></div>
    ${flat.length > MOST_ROWS && html`<p class="wb-soft">${t("workbench.compare.more", { count: String(flat.length - MOST_ROWS) })}</p>`}
  </section>`;
}

/** `a` is a run id; the other one is chosen here. */
export function Compare({ a, onClose }) {
  const [b, setB] = useState(null);
  const job = useJob("/differences", b ? { a, b } : null);
  const parts = PARTS();
  const told = (run) => html`<b>${unitOf(run)}</b> ${runName(run)}`;
  const found = job.result;
  const differing = found ? Object.keys(parts).filter((key) => found[key] && Object.keys(found[key]).length) : [];
  return html`<div class="wb-compare">
    <div class="wb-card-head"><h2>${t("workbench.compare.title")}</h2><button type="button" class="narrow" onClick=${onClose}>${t("workbench.compare.close")}</button></div>
    <p class="wb-pair"><span>A ${told(a)}</span> ${b && html`<span>B ${told(b)} <button type="button" class="wb-link" onClick=${() => setB(null)}>${t("workbench.compare.another")}</button></span>`}</p>
    ${!b && html`<${Chooser} label=${t("workbench.compare.choose")} taken=${new Set([a])} onChoose=${(row) => row.run !== a && setB(row.run)} />`}
    ${job.running && html`<p class="wb-waiting" role="status"><span class="wb-pulse" aria-hidden="true"></span>${t("workbench.compare.running")}</p>`}
    ${job.failed && html`<p class="wb-bad" role="alert">${job.failed}</p>`}
    ${found && !differing.length && html`<p role="status">${t("workbench.compare.same")}</p>`}
    ${differing.map((key) => html`<${Table} key=${key} rows=${found[key]} caption=${parts[key]} name=${`${a} ${b} ${key}`} />`)}
  </div>`;
}
