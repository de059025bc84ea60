// All units, searchable by number or lot, with the status of the newest calibration.
import { html, useEffect, useState } from "../lib/preact.js";
import { post, query } from "../lib/api.js";
import { Busy, Trouble } from "../lib/parts.js";
import { remember } from "../lib/router.js";
import { may } from "../lib/store.js";
import { day, effectWord, moment, t } from "../lib/words.js";
import { runTitle, stationName } from "../lib/names.js";
import { NoRegistry, useGet, Verdict, verdictPlace } from "./stock/parts.js";

const STANDINGS = ["pass", "fail", "unjudged", "uncalibrated"];
const PAGE = 200;
/** So many are listed; others are searched for. */
const MOST = 1000;

/** A value that follows another one after a pause, so that typing sends one request. */
function useRested(value, rest_ms) {
  const [rested, setRested] = useState(value);
  useEffect(() => {
    const timer = setTimeout(() => setRested(value), rest_ms);
    return () => clearTimeout(timer);
  }, [value]);
  return rested;
}

function Standings({ counts, chosen, choose }) {
  return html`<div class="st-chips" role="group" aria-label=${t("units.standing")}>
    ${STANDINGS.filter((name) => counts[name] || name === chosen).map((name) => html`
      <button type="button" key=${name} class="narrow" aria-pressed=${name === chosen} onClick=${() => choose(name === chosen ? "" : name)}>
        <${Verdict} word=${name} /> <span class="figures">${counts[name] ?? 0}</span></button>`)}
  </div>`;
}

function Line({ one }) {
  return html`<tr>
    <th scope="row"><a class="st-serial" href=${`/units/${encodeURIComponent(one.serial)}`}>${one.serial}</a></th>
    <td><${Verdict} word=${one.standing} />${one.unjudged && html` <a class="small" href=${verdictPlace(one.unjudged)} title=${runTitle(one.unjudged)}>${t("units.newer")}</a>`}</td>
    <td class="broad">${one.lot ?? html`<span class="soft">–</span>`}</td>
    <td class="n broad">${one.runs}</td>
    <td class="n broad">${one.calibrations}</td>
    <td class="broad">${day(one.calibrated)}</td>
    <td class="wide">${one.model ? effectWord(one.model) : "–"}</td>
    <td class="whole">${moment(one.last)}</td>
    <td class="wide" title=${one.station}>${stationName(one.station) ?? "–"}</td>
    <td class="wide">${one.certificate ?? html`<span class="soft">–</span>`}</td>
  </tr>`;
}

function List({ found }) {
  if (!found.units.length) return html`<p class="soft">${t(found.total ? "units.nothing" : "units.empty")}</p>`;
  const head = [["units.serial"], ["units.standing"], ["units.lot", "broad"], ["units.runs", "n broad"], ["units.calibrations", "n broad"], ["units.calibrated", "broad"],
    ["units.model", "wide"], ["units.last", "whole"], ["units.station", "wide"], ["units.certificate", "wide"]];
  return html`<div class="scroll"><table class="st-table lines">
    <thead><tr>${head.map(([key, kind]) => html`<th key=${key} scope="col" class=${kind}>${t(key)}</th>`)}</tr></thead>
    <tbody>${found.units.map((one) => html`<${Line} key=${one.serial} one=${one} />`)}</tbody>
  </table></div>`;
}

export default function Units({ query: initial }) {
  const [text, setText] = useState(initial.q ?? "");
  const [standing, setStanding] = useState(initial.standing ?? "");
  const [sort, setSort] = useState(initial.sort ?? "newest");
  const [most, setMost] = useState(PAGE);
  const [building, setBuilding] = useState(/** @type {{busy?: boolean, error?: Error}} */ ({}));
  const q = useRested(text, 150);
  const { data, error, again } = useGet(`/units${query({ q, standing, sort, limit: most })}`);
  useEffect(() => remember({ q, standing, sort: sort === "newest" ? "" : sort }), [q, standing, sort]);
  const build = async () => {
    setBuilding({ busy: true });
    try {
      await post("/registry");
      setBuilding({});
      again();
    } catch (trouble) {
      setBuilding({ error: trouble });
    }
  };
  return html`<div class="page stack">
    <div class="row spread"><h1>${t("units.title")}</h1>
      ${data?.registry && html`<p class="soft" role="status">${t("units.count", { matched: data.matched, total: data.total })}</p>`}</div>
    <${Trouble} error=${error ?? building.error} retry=${again} />
    ${!data && !error && html`<${Busy} />`}
    ${data && !data.registry && html`<${NoRegistry} build=${build} busy=${building.busy} may=${may("engineer")} />`}
    ${data?.registry && html`
      <div class="row st-filter">
        <input type="search" autofocus aria-label=${t("units.search")} placeholder=${t("units.search")} value=${text} onInput=${(event) => setText(event.target.value)} />
        <select aria-label=${t("units.sort")} value=${sort} onChange=${(event) => setSort(event.target.value)}>
          ${["newest", "oldest", "serial"].map((name) => html`<option key=${name} value=${name} selected=${name === sort}>${t(`units.sort.${name}`)}</option>`)}
        </select>
        <${Standings} counts=${data.standings} chosen=${standing} choose=${setStanding} />
      </div>
      <${List} found=${data} />
      ${data.matched > data.units.length && (most < MOST ? html`<button onClick=${() => setMost(most + PAGE)}>${t("units.more")}</button>` : html`<p class="soft">${t("units.first", { n: data.units.length })}</p>`)}`}
  </div>`;
}
