// One unit: its memory, its calibration in force, trends of its quantities, its runs.
import { html, useState } from "../lib/preact.js";
import { url } from "../lib/api.js";
import { Busy, Lamp, Trouble, Unknown } from "../lib/parts.js";
import { Said } from "../lib/said.js";
import { may } from "../lib/store.js";
import { asGiven, day, duration, effectWord, moment, number, quantityWord, sig, sign, symbols, t } from "../lib/words.js";
import { limitsName, planName, runTitle, stationName } from "../lib/names.js";
import { Chart } from "./stock/chart.js";
import { alike } from "./stock/trend.js";
import { Outcome, Points, Spark, Tile, useFirst, useGet, Verdict, verdictPlace } from "./stock/parts.js";

/** Runs, calibrations and points of a trend that are asked for at first. */
const MOST = 100;
const RAIL = [-60, 120];
const STATUS_TONES = { in_unit: "good", newest: "link", superseded: "idle", not_passed: "bad" };

const api = (path) => `/api/v1${path}`;
const pdfOf = (serial, paper) => api(url`/units/${serial}/certificates/${paper.number}`);
const reportOf = (run) => api(url`/runs/${run.split("/")[0]}/${run.split("/")[1]}/report`);

/** Age as text. */
function age(days) {
  if (days === null || days === undefined) return "–";
  if (days < 1) return t("units.age.today");
  if (days < 60) return t("units.age.days", { n: Math.floor(days) });
  if (days < 730) return t("units.age.months", { n: Math.floor(days / 30.44) });
  return t("units.age.years", { n: Math.floor(days / 365.25) });
}

/** Temperature range of a calibration, on one scale for all. */
function Range({ validity }) {
  const held = validity.temperature;
  if (!held) return html`<span class="soft">${t("units.range.unknown")}</span>`;
  const x = (degc) => 8 + (284 * (Math.min(RAIL[1], Math.max(RAIL[0], degc)) - RAIL[0])) / (RAIL[1] - RAIL[0]);
  const [from, to] = [held.from, held.to].map((end) => number(end, 0));
  const middle = (x(held.from) + x(held.to)) / 2;
  return html`<svg class="st-range" viewBox="0 0 300 40" preserveAspectRatio="xMinYMid" role="img" aria-label=${t("units.range", { from, to })}>
    <line class="rail" x1="8" x2="292" y1="26" y2="26" /><line class="held" x1=${x(held.from)} x2=${x(held.to)} y1="26" y2="26" />
    <text x=${Math.min(230, Math.max(70, middle))} y="14" text-anchor="middle">${from} … ${to} °C</text>
    ${x(held.from) > 60 && html`<text class="soft" x="8" y="14">${number(RAIL[0], 0)}</text>`}
    ${x(held.to) < 240 && html`<text class="soft" x="292" y="14" text-anchor="end">${number(RAIL[1], 0)}</text>`}
  </svg>`;
}

function Calibration({ one, serial }) {
  const paper = one.certificate;
  return html`<li class=${`st-card ${one.status}`}>
    <div><div class="when">${day(one.created)} <span class="soft">· ${age(one.age_days)}</span></div>
      <${Lamp} tone=${STATUS_TONES[one.status]}>${t(`units.status.${one.status}`)}<//></div>
    <div><${Range} validity=${one.validity} />
      <div class="small">${effectWord(one.model)} · <${Verdict} word=${one.judged ?? one.verdict} />${one.limits && html` <span class="soft">${t("units.against", { limits: limitsName(one.limits) })}</span>`}</div></div>
    <div class="row">
      ${paper?.pdf && html`<a class="button narrow" href=${pdfOf(serial, paper)} target="_blank" rel="noopener">${t("units.open_pdf")}</a>`}
      ${paper && html`<span class="small soft mono">${paper.number}</span>`}
      ${!paper && html`<span class="small soft">${t("units.no_paper")}</span>`}
    </div></li>`;
}

function Memory({ unit }) {
  const held = unit.memory;
  const own = unit.counts?.status === "in_unit" && unit.counts.run; // of a whole unit the folder beside it is written
  const failed = unit.writes[0]?.state === "failed" ? unit.writes[0] : null;
  return html`<section class="panel stack" aria-labelledby="memory"><h2 id="memory">${t("units.memory")}</h2>
    ${failed && html`<div class="notice bad"><p>${t("units.memory.failed", { when: moment(failed.utc) })}${sign(" ")}<${Said} text=${failed.error} /></p></div>`}
    ${!held && html`<p>${t("units.memory.none")}</p>`}
    ${held && html`<dl class="st-facts">
      <dt>${t("units.memory.id")}</dt><dd class="mono">${held.calibration_id}</dd>
      <dt>${t("units.memory.written")}</dt><dd>${moment(held.utc)}${sign(", ")}<${Said} text=${held.operator ?? "–"} /></dd>
      <dt>${t("units.memory.of")}</dt><dd>${own ? html`<a href=${`/runs/${own}`}>${runTitle(own)}</a>` : held.run ? runTitle(held.run) : "–"}</dd>
      <dt>${t("units.memory.place")}</dt><dd>${t("units.memory.bank", { bank: held.bank, set: held.coefficient_set, words: held.words })}</dd>
      <dt>CRC</dt><dd class="mono">${held.crc}</dd>
      <dt>${t("units.memory.before")}</dt><dd class="mono">${held.before ?? t("units.memory.nothing")}</dd>
    </dl><p class="small soft">${t("units.memory.note")}</p>`}</section>`;
}

function Trends({ unit }) {
  const [chosen, choose] = useState(unit.trends[0]?.name);
  const one = unit.trends.find((trend) => trend.name === chosen);
  const { data, error, again } = useGet(one ? url`/units/${unit.serial}/trends/${chosen}` : null);
  if (!one) return html`<p class="soft">${t("units.tile.no_calibration")}</p>`;
  const words = t("units.trends.words", { name: quantityWord(one.name), n: one.of, last: `${sig(one.last)} ${symbols(one.unit)}` });
  return html`<div class="st-two">
    <div class="scroll st-scroll" tabindex="0" role="region" aria-label=${t("units.quantity")}><table class="st-table st-quantities">
      <thead><tr><th scope="col">${t("units.quantity")}</th><th scope="col" class="broad">${t("units.course")}</th><th scope="col" class="n">${t("units.newest_value")}</th><th scope="col" class="n">${t("units.limit")}</th></tr></thead>
      <tbody>${unit.trends.map((trend) => html`<tr key=${trend.name} aria-current=${trend.name === chosen ? "true" : undefined}>
        <th scope="row"><button type="button" aria-pressed=${trend.name === chosen} onClick=${() => choose(trend.name)}>${quantityWord(trend.name)}</button></th>
        <td class="broad"><${Spark} values=${alike(trend).map((point) => point.value)} lower=${trend.lower} upper=${trend.upper} /></td>
        <td class="n">${trend.outside ? html`<${Lamp} tone="bad">${sig(trend.last)}<//>` : sig(trend.last)} <span class="soft">${symbols(trend.unit)}</span></td>
        <td class="n">${[trend.lower !== null && `≥ ${asGiven(trend.lower)}`, trend.upper !== null && `≤ ${asGiven(trend.upper)}`].filter(Boolean).join(", ") || html`<span class="soft">–</span>`}</td>
      </tr>`)}</tbody></table></div>
    <div><h3>${quantityWord(one.name)}</h3>
      <${Trouble} error=${error} retry=${again} />
      ${data ? html`<${Chart} figure=${data.figure} words=${words} name=${`${unit.serial} ${one.name}`} height=${330} />` : !error && html`<${Busy} />`}
      <${Points} rows=${one.points.map(({ run, value }) => [run, runTitle(run), value])} /></div>
  </div>`;
}

function Calibrations({ unit, ask }) {
  const { first, more } = useFirst(unit.calibrations, 20, unit.of.calibrations, ask);
  return html`<ol class="st-cards">${first.map((one) => html`<${Calibration} key=${one.run} one=${one} serial=${unit.serial} />`)}</ol>${more}`;
}

function Runs({ unit, ask }) {
  const { first, more } = useFirst(unit.runs, MOST, unit.of.runs, ask);
  return html`<div class="scroll"><table class="st-table lines">
    <thead><tr>${["when", "kind", "profile", "outcome", "took"].map((key) => html`<th key=${key} scope="col" class=${key === "profile" ? "whole" : undefined}>${t(`units.run.${key}`)}</th>`)}
      <th scope="col" class="wide">${t("units.station")}</th><th scope="col" class="wide">${t("units.run.operator")}</th><th scope="col" class="whole"><span class="unseen">${t("units.run.open")}</span></th></tr></thead>
    <tbody>${first.map((run) => html`<tr key=${run.run}>
      <th scope="row">${moment(run.created)}</th>
      <td>${t(`units.kind.${run.kind}`)}</td>
      <td class="whole">${planName(run)}${run.simulated && html` <span class="small soft">(${t("units.simulated")})</span>`}</td>
      <td><${Outcome} run=${run} />${run.cause && run.state !== "done" && html`<div class="small soft"><${Said} text=${run.cause} /></div>`}</td>
      <td>${duration(run.duration_s)}</td><td class="wide" title=${run.station}>${stationName(run.station) ?? "–"}</td><td class="wide"><${Said} text=${run.operator ?? "–"} /></td>
      <td class="whole"><span class="st-links">${run.here ? html`<a href=${`/runs/${run.run}`}>${t("run.open")}</a> ${may("engineer") && html`<a href=${`/workbench?run=${encodeURIComponent(run.run)}`}>${t("nav.workbench")}</a>`}
        ${run.kind === "calibration" && html`<a href=${reportOf(run.run)} target="_blank" rel="noopener">${t("units.run.report")}</a>`}` : html`<span class="small soft">${t("units.elsewhere")}</span>`}</span></td>
    </tr>`)}</tbody></table></div>${more}`;
}

/** The error that a calibration leaves, the last of `points`, and its change since the first of them. */
function Left({ trend, points }) {
  const last = points[points.length - 1];
  const change = last.value - points[0].value;
  const outside = (trend.upper !== null && last.value > trend.upper) || (trend.lower !== null && last.value < trend.lower);
  const since = points.length < 2 ? t("units.tile.first") : t("units.tile.change", { change: `${change > 0 ? "+" : ""}${sig(change, 2)} ${symbols(trend.unit)}` });
  return html`<${Tile} what=${quantityWord(trend.name)} value=${sig(last.value)} unit=${symbols(trend.unit)} tone=${outside ? "bad" : undefined} more=${[runTitle(last.run), since].join(sign("; "))} />`;
}

function Summary({ unit }) {
  const { counts } = unit;
  const error = unit.trends.find((trend) => trend.name === "residual_rms_dph");
  const last = unit.runs[0];
  const same = error && (!counts || error.points.some(({ run }) => run === counts.run)) && alike(error, counts?.run);
  return html`<div class="st-tiles">
    <${Tile} what=${t("units.tile.counts")} value=${counts ? day(counts.created) : "–"} tone=${counts ? (counts.status === "in_unit" ? "good" : "warn") : "bad"}
      more=${counts ? `${t(`units.status.${counts.status}`)}${sign(", ")}${age(counts.age_days)}${sign("; ")}${runTitle(counts.run)}` : t("units.tile.no_calibration")} />
    <${Tile} what=${t("units.tile.holds")} value=${counts?.validity.temperature ? `${number(counts.validity.temperature.from, 0)} … ${number(counts.validity.temperature.to, 0)}` : "–"} unit="°C" more=${counts ? `${t("units.tile.holds_more")}${sign("; ")}${runTitle(counts.run)}` : t("units.tile.no_calibration")} />
    ${same && html`<${Left} trend=${error} points=${same} />`}
    <${Tile} what=${t("units.runs")} value=${unit.of.runs} more=${last && t("units.tile.last", { when: moment(last.created) })} />
  </div>`;
}

export default function Unit({ params, query }) {
  const [most, setMost] = useState(MOST);
  const ask = (wanted) => setMost(Math.max(most, wanted));
  const { data: unit, error, again } = useGet(`${url`/units/${params.serial}`}?most=${most}`);
  const head = html`<p class="small"><a href="/units">← ${t("units.title")}</a></p>`;
  if (error?.status === 404) {
    const from = query.run ? { way: verdictPlace(query.run), words: t("live.run") } : query.job && { way: `/calibrations/${query.job.split("/").map(encodeURIComponent).join("/")}`, words: t("live.of_calibration") };
    return html`<div class="page stack">${from
      ? html`<${Unknown} title=${params.serial} what=${t("units.unbegun", { serial: params.serial })} ...${from} />`
      : html`<${Unknown} title=${params.serial} what=${t("units.unknown", { serial: params.serial })} way="/units" words=${t("units.all")} />`}</div>`;
  }
  if (error) return html`<div class="page stack">${head}<h1>${params.serial}</h1><${Trouble} error=${error} retry=${again} /></div>`;
  if (!unit) return html`<div class="page stack">${head}<${Busy} /></div>`;
  return html`<div class="page stack">${head}
    <div class="st-head"><h1>${unit.serial}</h1>${unit.lot && html`<a class="soft" href=${`/units?q=${encodeURIComponent(unit.lot)}`}>${t("units.lot")} ${unit.lot}</a>`}</div>
    <${Summary} unit=${unit} />
    <section class="stack" aria-labelledby="calibrations"><h2 id="calibrations">${t("units.calibrations")}</h2>
      ${unit.calibrations.length ? html`<${Calibrations} unit=${unit} ask=${ask} />` : html`<p class="soft">${t("units.tile.no_calibration")}</p>`}</section>
    <section class="stack" aria-labelledby="trends"><h2 id="trends">${t("units.trends")}</h2><${Trends} unit=${unit} /></section>
    <${Memory} unit=${unit} />
    <section class="stack" aria-labelledby="runs"><h2 id="runs">${t("units.runs")}</h2><${Runs} unit=${unit} ask=${ask} /></section>
  </div>`;
}
