// Many units: yield, capability, control charts with their signals, drifts of stations and lots, outliers.
import { html, useEffect, useRef, useState } from "../lib/preact.js";
import { post, query, url } from "../lib/api.js";
import { beginOf } from "../lib/days.js";
import { Busy, Lamp, Trouble } from "../lib/parts.js";
import { navigate, remember } from "../lib/router.js";
import { Said } from "../lib/said.js";
import { pointName } from "../lib/spoken.js";
import { may } from "../lib/store.js";
import { limitsName, lotName, planTitle, runTitle, stationName } from "../lib/names.js";
import { asGiven, day, effectWord, joined, number, quantityWord, sig, sign, symbols, t } from "../lib/words.js";
import { Chart } from "./stock/chart.js";
import { NoRegistry, Points, Tile, useGet, verdictPlace } from "./stock/parts.js";
import { Going, useAct } from "./run.js";
import { outcomeWord } from "./verdict/judged.js";
import { offered } from "./workbench/offered.js";

const unitLink = (serial) => html`<a href=${`/units/${encodeURIComponent(serial)}`}>${serial}</a>`;
/** Texts or links in one line, the first of `of`. */
const listed = (items, of = items.length, most = 6) => items.slice(0, most).flatMap((item, i) => (i ? [joined(["", ""]), item] : [item])).concat(of > most ? [`${sign(" ")}${t("fleet.more", { n: of - most })}`] : []);
const changeOf = ({ change }) => `${change > 0 ? "+" : ""}${sig(change)}`;
const percent = (share) => `${number(100 * share, 1)}${sign(" %")}`;

function Attention({ fleet }) {
  const { outside, unjudged, outside_units, unjudged_units, later, later_runs, stations, shifted, lots, odd, beyond, quiet, silent } = fleet.attention;
  if (silent && !unjudged) return html`<div class="notice"><p><${Lamp} tone="idle">${t("fleet.silent")}<//></p></div>`;
  if (quiet) return html`<div class="notice good"><p><${Lamp} tone="good">${fleet.quantities.some(({ signals }) => signals !== null) ? t("fleet.quiet") : t("fleet.quiet_few")}<//></p></div>`;
  const lines = [
    outside > 0 && ["bad", html`${t("fleet.outside", { n: outside, judged: fleet.yield.judged })}${sign(": ")}${listed(outside_units.map(unitLink), outside)}`],
    unjudged > 0 && ["warn", html`${t("fleet.not_judged", { n: unjudged })}${sign(" ")}${fleet.missing.length ? html`${t("fleet.missing")}${sign(" ")}${listed(fleet.missing.map(quantityWord))}` : listed(unjudged_units.map(unitLink), unjudged)}`],
    later > 0 && ["warn", html`${t("fleet.later", { n: later })}${sign(" ")}${listed(later_runs.map(({ unit, run }) => html`<a href=${verdictPlace(run)} title=${runTitle(run)}>${unit}</a>`), later)}`],
    stations.length > 0 && ["warn", html`${t("fleet.stations_drift")}${sign(" ")}${listed(stations.map(stationName))}`],
    shifted.length > 0 && ["warn", html`${t("fleet.stations_shifted")}${sign(" ")}${listed(shifted.map((one) => `${stationName(one.place)}${sign(" (")}${quantityWord(one.quantity)} ${changeOf(one)} ${symbols(one.unit_of_value)} ${t("fleet.since_day", { day: day(one.since_created) })}${sign(")")}`))}`],
    lots.length > 0 && ["warn", html`${t("fleet.lots_differ")}${sign(" ")}${listed(lots.map((lot) => lotName(lot, fleet.choices.cut)))}`],
    odd.length > 0 && ["warn", html`${t("fleet.odd")}${sign(" ")}${listed(odd.map(unitLink))}`],
    beyond.length > 0 && ["warn", html`${t("fleet.beyond")}${sign(" ")}${listed(beyond.map(quantityWord))}`],
  ].filter(Boolean);
  return html`<section class=${`notice ${outside ? "bad" : "warn"}`} aria-label=${t("fleet.attention")}>
    <ul class="st-attention">${lines.map(([tone, words], i) => html`<li key=${i}><${Lamp} tone=${tone}>${words}<//></li>`)}</ul></section>`;
}

/** Why no quantity is told against its limits. */
const unlimited = (fleet) => t(fleet.quantities.some(({ lower, upper }) => (lower ?? upper) !== null) ? "fleet.too_few_values" : "fleet.no_limits");

function Headline({ fleet }) {
  const passes = fleet.yield;
  const able = fleet.quantities.filter((one) => Number.isFinite(one.capability?.cpk));
  const worst = able.length ? able.reduce((a, b) => (a.capability.cpk <= b.capability.cpk ? a : b)) : null;
  return html`<div class="st-tiles">
    <${Tile} what=${t("fleet.yield")} value=${passes.judged ? number(100 * passes.first_pass, 1) : "–"} unit="%" tone=${passes.judged ? (passes.final < passes.judged ? "warn" : "good") : undefined}
      more=${passes.judged ? t("fleet.yield_more", { first: passes.first, judged: passes.judged, low: percent(passes.interval[0]), high: percent(passes.interval[1]) }) : t("fleet.unjudged")} />
    <${Tile} what=${t("fleet.least_cpk")} value=${worst ? sig(worst.capability.cpk) : "–"} tone=${worst && (worst.capable ? "good" : "bad")} more=${worst ? quantityWord(worst.name) : fleet.quantities.some((one) => one.capability) ? t("fleet.no_cpk") : unlimited(fleet)} />
    <${Tile} what=${t("units.title")} value=${number(fleet.units, 0)} more=${t("fleet.units_more", { lots: fleet.lots, stations: fleet.stations })} />
    <${Tile} what=${t("fleet.period")} value=${day(fleet.last)} more=${t("fleet.since_day", { day: day(fleet.first) })} />
  </div><p class="soft small">${t("fleet.counts")}</p>`;
}

/** What a telephone shows of the capability. */
const NARROW = ["quantity", "limits", "ppk", "outside"];

function Capability({ fleet, chosen, choose }) {
  const [all, setAll] = useState(false);
  const charted = fleet.quantities.filter((one) => one.signals !== null || one.capability);
  const rest = fleet.quantities.filter((one) => !charted.includes(one));
  const head = ["quantity", "units", "signals", "mean", "limits", "cpk", "ppk", "outside"];
  const shown = [...charted, ...(all ? rest : [])];
  return html`${shown.length > 0 && html`<div class="scroll"><table class="st-table st-quantities">
    <thead><tr>${head.map((key, i) => html`<th key=${key} scope="col" class=${`${i ? "n" : ""} ${NARROW.includes(key) ? "" : "broad"}`}>${t(`fleet.head.${key}`)}</th>`)}</tr></thead>
    <tbody>${shown.map((one) => {
      const able = one.capability;
      const limits = [one.lower !== null && `≥\u00a0${asGiven(one.lower)}`, one.upper !== null && `≤\u00a0${asGiven(one.upper)}`].filter(Boolean).join(", ");
      return html`<tr key=${one.name} aria-current=${one.name === chosen ? "true" : undefined}>
        <th scope="row">${one.signals === null ? quantityWord(one.name) : html`<button type="button" aria-pressed=${one.name === chosen} onClick=${() => choose(one.name)}>${quantityWord(one.name)}</button>`}
          <span class="soft small"> ${symbols(one.unit)}</span></th>
        <td class="n broad">${one.units}</td>
        <td class="n broad">${one.signals === null ? "–" : one.signals ? html`<${Lamp} tone="warn">${one.signals}<//>` : "0"}</td>
        <td class="n broad">${sig(one.mean)}</td><td class="n">${limits || "–"}</td>
        <td class="n broad">${Number.isFinite(able?.cpk) ? html`${sig(able.cpk)} <span class="soft small">${sig(able.cpk_interval[0], 2)}\u00a0… ${sig(able.cpk_interval[1], 2)}</span>` : "–"}</td>
        <td class="n">${able ? html`<${Lamp} tone=${one.capable ? "good" : "bad"}>${sig(able.ppk)}<//>` : "–"}</td>
        <td class="n">${able ? able.outside : "–"}</td></tr>`;
    })}</tbody></table></div>`}
    ${rest.length > 0 && html`<button class="narrow quiet" aria-expanded=${String(all)} onClick=${() => setAll(!all)}>${t(charted.length ? "fleet.rest" : "fleet.rest_all", { n: rest.length })}</button>`}
    ${charted.some((one) => one.capability) && html`<p class="soft small">${t("fleet.cpk_note")}</p>`}`;
}

/** Every unit of a figure once, in order: [place, its words, its value], of the first curve that has it. */
const pointsOf = ({ data }) => [...new Map([...data].reverse().flatMap(({ x, y, text }) => x.map((place, i) => [place, [place, text[i], y[i]]]))).values()].sort(([one], [other]) => one - other);

/** Figure of the first-pass yield over time. */
const YIELD = "yield";
const HEIGHTS = { distances: 400, [YIELD]: 300 };

function Control({ name, params, anchor }) {
  const { data, error, again } = useGet(url`/fleet/charts/${name}` + query(params));
  const runAt = (x) => data.runs[Math.round(x) - 1];
  const pick = (x) => data && navigate(verdictPlace(runAt(x)));
  const distances = name === "distances";
  const Head = name === YIELD ? "h2" : "h3";
  const title = distances ? t("fleet.distances") : name === YIELD ? t("fleet.over_time") : quantityWord(name);
  const words = data && (distances ? t("fleet.distances_words", { n: data.units.length }) : name === YIELD ? t("fleet.over_time_words", { n: data.all }) : t("fleet.chart_words", { name: title, units: data.units.length, n: data.signals.length }));
  return html`<section class="stack" ref=${anchor} aria-label=${title}><${Head}>${title}<//>
    <${Trouble} error=${error} retry=${again} />
    ${data ? html`<${Chart} figure=${data.figure} words=${words} name=${`fleet ${name}`} height=${HEIGHTS[name] ?? 460} onPick=${data.runs.length > 0 && pick} />` : !error && html`<${Busy} />`}
    ${data?.histogram && html`<${Chart} figure=${data.histogram} words=${t("fleet.histogram_words", { name: title, units: data.units.length })} name=${`fleet ${name} histogram`} height=${280} />`}
    ${data?.units.length > 0 && html`<${Points} rows=${pointsOf(data.figure).map(([place, text, value]) => [runAt(place), pointName(text), value])} />`}
    ${data?.signals.length > 0 && html`<details><summary>${t("fleet.signals", { n: data.signals.length })}</summary>
      <div class="scroll st-scroll"><table><thead><tr><th scope="col">${t("units.serial")}</th><th scope="col">${t("fleet.rule")}</th></tr></thead>
      <tbody>${data.signals.map((one, i) => html`<tr key=${i}><th scope="row">${unitLink(one.unit)}</th><td>${one.rule}${sign(": ")}${t(`fleet.rule.${one.rule}`)}</td></tr>`)}</tbody></table></div></details>`}
  </section>`;
}

/** Units outside the limits of each quantity, most first, with the share of all such cases so far. */
function Failures({ fleet }) {
  const failing = fleet.quantities.filter((one) => one.capability?.outside > 0).sort((a, b) => b.capability.outside - a.capability.outside);
  const all = failing.reduce((sum, one) => sum + one.capability.outside, 0);
  if (!fleet.quantities.some((one) => one.capability)) return html`<p class="soft">${unlimited(fleet)}</p>`;
  if (!all) return html`<p><${Lamp} tone="good">${t("fleet.no_failures")}<//></p>`;
  let sum = 0;
  return html`<ol class="st-pareto">${failing.map((one) => {
    sum += one.capability.outside;
    return html`<li key=${one.name}><span>${quantityWord(one.name)}</span>
      <meter min="0" max=${failing[0].capability.outside} value=${one.capability.outside} aria-label=${quantityWord(one.name)}></meter>
      <b class="figures">${one.capability.outside}</b><span class="soft figures">${percent(sum / all)}</span></li>`;
  })}</ol><p class="soft small">${t("fleet.failures_note")}</p>`;
}

function Drifts({ fleet }) {
  if (!fleet.tested) return html`<p class="soft">${t("fleet.untested")}</p>`;
  const tested = t("fleet.tested", { n: fleet.tested });
  if (!fleet.drifts.length) return html`<p>${t("fleet.no_drift")}${sign(" ")}<span class="soft">${tested}</span></p>`;
  return html`<div class="scroll"><table class="st-table"><thead><tr><th scope="col">${t("fleet.place")}</th><th scope="col">${t("units.quantity")}</th>
      <th scope="col" class="n">${t("fleet.change")}</th><th scope="col" class="n">p</th><th scope="col" class="n">${t("units.title")}</th></tr></thead>
    <tbody>${fleet.drifts.map((one, i) => html`<tr key=${i}><th scope="row">${t(`fleet.kind.${one.kind}`)} ${one.kind === "station" ? stationName(one.place) : lotName(one.place, fleet.choices.cut)}</th><td>${quantityWord(one.quantity)}</td>
      <td class="n">${changeOf(one)} ± ${sig(one.error, 2)} <span class="soft">${symbols(one.unit)}${one.kind === "station" ? ` / ${t("fleet.day")}` : ""}</span></td>
      <td class="n">${one.p < 1e-4 ? "< 0.0001" : sig(one.p, 2)}</td><td class="n">${one.count}</td></tr>`)}</tbody></table></div>
    <p class="soft small">${t("fleet.drift_note")}${sign(" ")}${tested}</p>`;
}

function Shifts({ fleet }) {
  if (!fleet.shifts.length) return null;
  return html`<div class="scroll"><table class="st-table"><thead><tr><th scope="col">${t("fleet.kind.station")}</th><th scope="col">${t("units.quantity")}</th>
      <th scope="col" class="n">${t("fleet.change")}</th><th scope="col">${t("units.serial")}</th><th scope="col" class="n">${t("units.title")}</th></tr></thead>
    <tbody>${fleet.shifts.map((one, i) => html`<tr key=${i}><th scope="row" title=${one.place}>${stationName(one.place)}</th><td>${quantityWord(one.quantity)}</td>
      <td class="n">${changeOf(one)} <span class="soft">${symbols(one.unit_of_value)}</span></td>
      <td>${unitLink(one.since)} <span class="soft">${t("fleet.since_day", { day: day(one.since_created) })}</span></td><td class="n">${one.count}</td></tr>`)}</tbody></table></div>
    <p class="soft small">${t("fleet.shift_note", { share: number(100 * fleet.station_charts.false_alarm, 0) })}</p>`;
}

function Odd({ fleet }) {
  if (!fleet.distances) return html`<p class="soft">${t("fleet.too_few")}</p>`;
  if (!fleet.unlike.length) return html`<p><${Lamp} tone="good">${t("fleet.all_alike")}<//></p>`;
  return html`<div class="scroll"><table class="st-table"><thead><tr><th scope="col">${t("units.serial")}</th><th scope="col">${t("units.lot")}</th>
      <th scope="col" class="n">${t("fleet.distance")}</th><th scope="col">${t("fleet.leading")}</th></tr></thead>
    <tbody>${fleet.unlike.map((one) => html`<tr key=${one.unit}><th scope="row">${unitLink(one.unit)}</th><td>${lotName(one.lot, fleet.choices.cut)}</td><td class="n">${sig(one.distance)}</td>
      <td>${quantityWord(one.quantity)} <span class="soft">${one.sigmas > 0 ? "+" : ""}${sig(one.sigmas, 2)} σ</span></td></tr>`)}</tbody></table></div>`;
}

const WORDS = ["adequate", "undecided", "unknown_effect"];
const MOST_LOTS = 12;

/** Diagnoses the units that were not yet, with a model of choice, at first the one `like` which others were. */
function Diagnose({ params, like, again }) {
  const { data, error } = useGet("/models");
  const [chosen, choose] = useState("");
  const job = useAct();
  useEffect(() => job.result && again(), [job.result]);
  const names = offered(data?.models ?? []).map(({ name }) => name);
  const model = [chosen, like, "spline"].find((name) => names.includes(name)) ?? names[0];
  return html`<div class="row"><label class="row">${t("workbench.model.title")} <select value=${model} onChange=${(event) => choose(event.target.value)}>
      ${names.map((name) => html`<option key=${name} value=${name} selected=${name === model}>${name}</option>`)}</select></label>
    <button type="button" disabled=${job.busy || !model} onClick=${() => job.act(`/fleet/lacks${query(params)}`, { model })}>${t("fleet.diagnose")}</button></div>
    ${job.busy && html`<p class="soft small">${t("fleet.diagnosing")}</p>`}<${Going} job=${{ ...job, error: job.error ?? error }} />
    ${job.result?.failed.length > 0 && html`<ul class="findings">${job.result.failed.map((text) => html`<li key=${text}><${Lamp} tone="warn"><${Said} text=${text} whole /><//></li>`)}</ul>`}`;
}

/** How many units of each lot lack which effect, as far as their newest runs were diagnosed with a model. */
function Lacks({ params, of, cut }) {
  const [model, setModel] = useState("");
  const { data, error, again } = useGet(`/fleet/lacks${query({ ...params, model })}`);
  if (!data) return error ? html`<${Trouble} error=${error} retry=${again} />` : html`<${Busy} />`;
  const more = may("engineer") && data.units < of && html`<${Diagnose} key=${JSON.stringify(params)} params=${params} like=${data.model} again=${again} />`;
  if (!data.units) return html`<p class="soft">${t("fleet.no_lacks")}</p>${more}`;
  const sum = (part, name, lots = data.lots) => lots.reduce((all, lot) => all + (lot[part][name] ?? 0), 0);
  const effects = [...new Set(data.lots.flatMap((lot) => Object.keys(lot.lacks)))].sort((one, other) => sum("lacks", other) - sum("lacks", one));
  const shown = data.lots.slice(0, MOST_LOTS);
  const row = (head, part, name) => html`<tr key=${`${part} ${name}`}><th scope="row">${head}</th><td class="n"><b>${sum(part, name)}</b></td>${shown.map((lot) => html`<td key=${lot.lot} class="n">${lot[part][name] ?? 0}</td>`)}</tr>`;
  return html`<p>${t("fleet.diagnosed", { n: data.units })}${sign(" ")}${Object.keys(data.models).length > 1 ? html`<select aria-label=${t("workbench.model.title")} onChange=${(event) => setModel(event.target.value)}>
      ${Object.keys(data.models).map((name) => html`<option key=${name} value=${name} selected=${name === data.model}>${name}</option>`)}</select>` : html`<code>${data.model}</code>`}</p>
    <div class="scroll" tabindex="0" role="region" aria-labelledby="lacks"><table class="st-table"><thead><tr><th scope="col">${t("fleet.effect")}</th><th scope="col" class="n">${t("fleet.all")}</th>${shown.map(({ lot }) => html`<th key=${lot} scope="col" class="n">${lotName(lot, cut)}</th>`)}</tr></thead>
      <tbody>${effects.map((effect) => row(effectWord(effect), "lacks", effect))}
        ${WORDS.map((word) => row(outcomeWord(word), "verdicts", word))}
        <tr><th scope="row">${t("fleet.head.units")}</th><td class="n"><b>${data.units}</b></td>${shown.map(({ lot, units }) => html`<td key=${lot} class="n">${units}</td>`)}</tr></tbody></table></div>
    <p class="soft small">${t("fleet.lacks_note")}</p>${more}
    ${data.lots.length > shown.length && html`<p class="soft small">${t("fleet.more", { n: data.lots.length - shown.length })}</p>`}
    ${data.in_common.map((one) => html`<p key=${`${one.lot} ${one.effect}`}><${Lamp} tone="warn">${t("fleet.in_common", { lot: lotName(one.lot, cut), effect: effectWord(one.effect), n: one.lacking, of: one.units, rest: one.elsewhere, of_rest: one.of_elsewhere, p: one.p < 1e-4 ? "< 0.0001" : sig(one.p, 2) })}<//></p>`)}`;
}

function Board({ fleet, params }) {
  const charts = fleet.quantities.filter((one) => one.signals !== null);
  const first = [...charts].sort((a, b) => b.signals - a.signals)[0]?.name;
  const [picked, setPicked] = useState(null);
  const anchor = useRef(null);
  const chosen = charts.some((one) => one.name === picked) ? picked : first;
  const choose = (name) => {
    setPicked(name);
    anchor.current?.scrollIntoView({ block: "nearest", behavior: "smooth" });
  };
  return html`<${Attention} fleet=${fleet} /><${Headline} fleet=${fleet} />
    ${fleet.yield.judged > 0 && html`<${Control} name=${YIELD} params=${params} />`}
    <section class="stack" aria-labelledby="cap"><h2 id="cap">${t("fleet.capability")}</h2><${Capability} fleet=${fleet} chosen=${chosen} choose=${choose} /></section>
    <section class="stack" aria-labelledby="failures"><h2 id="failures">${t("fleet.failures")}</h2><${Failures} fleet=${fleet} /></section>
    <section class="stack" aria-labelledby="control"><h2 id="control">${t("fleet.control")}</h2>
      ${chosen ? html`<${Control} name=${chosen} params=${params} anchor=${anchor} /><p class="soft small">${t("fleet.control_note")}</p>` : html`<p class="soft">${t("fleet.too_few_chart")}</p>`}</section>
    <section class="stack" aria-labelledby="drift"><h2 id="drift">${t("fleet.drift")}</h2><${Drifts} fleet=${fleet} /><${Shifts} fleet=${fleet} /></section>
    <section class="stack"><h2 id="lacks">${t("fleet.lacks")}</h2><${Lacks} params=${params} of=${fleet.units} cut=${fleet.choices.cut} /></section>
    <section class="stack" aria-labelledby="odd"><h2 id="odd">${t("fleet.unlike")}</h2><${Odd} fleet=${fleet} />
      ${fleet.distances && html`<${Control} name="distances" params=${params} />`}</section>`;
}

/** Choices of the address: limits, and which runs count. */
const CHOICES = ["limits", "station", "lot", "plan", "since", "until", "simulated"];

const DAYS = ["since", "until"];

const planOf = (id) => planTitle({ id, title: id });
const NAMED = { limits: (id) => limitsName(id), station: stationName, plan: planOf };

/** An error about limits that are not there, which lists the others as the choice does. */
const ofLimits = (error) => error?.message.startsWith("no limits ") ? { status: error.status, message: error.message.replace(/(?<=there are )[^;]+/, (ids) => ids.split(", ").map((id) => limitsName(id)).join(sign(", "))) } : error;

/** Runs that do not count here, and how the simulated ones among them are seen. */
function LeftOut({ fleet, simulated, choose }) {
  const reasons = fleet.left_out.map((text) => text.replace(/\((.*); --profile\)/, (_, names) => `(${names.split(", ").map((id) => `\`${planOf(id)}\``).join(sign(", "))})`));
  if (!reasons.length && !simulated) return null;
  const others = reasons.some((text) => /^\d+ simulated$/.test(text));
  return html`<p class="soft small">${reasons.length > 0 && html`${t("fleet.left_out")}${sign(" ")}<${Said} text=${reasons.join("; ")} whole /> `}
    ${(others || simulated) && html`<button type="button" class="narrow quiet" onClick=${() => choose(simulated ? "" : "true")}>${t(simulated ? "fleet.show_real" : "fleet.show_simulated")}</button>`}</p>`;
}

/** A choice among names; the first one is all. */
function Choice({ label, all, names, named, value, onChange }) {
  return html`<label class="row">${label} <select value=${value} onChange=${(event) => onChange(event.target.value)}>
    <option value="" selected=${!value}>${all}</option>
    ${[...new Set([...names, ...(value ? [value] : [])])].map((name) => html`<option key=${name} value=${name} selected=${name === value} title=${name}>${named(name)}</option>`)}</select></label>`;
}

export default function Fleet({ query: initial }) {
  const [chosen, setChosen] = useState(Object.fromEntries(CHOICES.map((name) => [name, DAYS.includes(name) && !beginOf(initial[name]) ? "" : initial[name] ?? ""])));
  const [text, setText] = useState(initial.q ?? "");
  const [q, setQ] = useState(text);
  const [trouble, setTrouble] = useState(null);
  useEffect(() => {
    const timer = setTimeout(() => setQ(text), 300);
    return () => clearTimeout(timer);
  }, [text]);
  useEffect(() => remember({ q, ...chosen }), [q, chosen]);
  const params = { q, ...chosen, since: beginOf(chosen.since), until: beginOf(chosen.until, 1) };
  const { data: fleet, error, again } = useGet(`/fleet${query(params)}`);
  const build = () => post("/registry").then(again, setTrouble);
  const filtered = Object.values(params).some(Boolean);
  const clear = () => {
    setText("");
    setQ("");
    setChosen(Object.fromEntries(CHOICES.map((name) => [name, ""])));
  };
  const set = (name) => (value) => setChosen({ ...chosen, [name]: value });
  const all = t("fleet.all");
  const choice = (name, label, names, otherwise = all) => html`<${Choice} label=${label} all=${otherwise} names=${names ?? []} named=${NAMED[name] ?? ((lot) => lotName(lot, fleet.choices.cut))} value=${chosen[name]} onChange=${set(name)} />`;
  const date = (name) => html`<label class="row">${t(`fleet.${name}`)} <input type="date" value=${chosen[name]} onChange=${(event) => set(name)(event.target.value)} /></label>`;
  return html`<div class="page stack">
    <div class="row spread"><h1>${t("fleet.title")}</h1>
      ${fleet?.units > 0 && html`<a class="button narrow" href=${`/api/v1/fleet.csv${query(params)}`} download>${t("fleet.csv")}</a>`}</div>
    <${Trouble} error=${ofLimits(error) ?? trouble} retry=${again} />
    ${error && filtered && html`<p><button type="button" class="narrow" onClick=${clear}>${t("fleet.clear")}</button></p>`}
    ${!fleet && !error && html`<${Busy} />`}
    ${fleet && !fleet.registry && html`<${NoRegistry} build=${build} may=${may("engineer")} />`}
    ${fleet?.registry && html`<div class="row st-filter">
      <input type="search" aria-label=${t("fleet.search")} placeholder=${t("fleet.search")} value=${text} onInput=${(event) => setText(event.target.value)} />
      ${choice("limits", t("fleet.limits"), fleet.known_limits, t("fleet.own_limits"))}
      ${choice("station", t("fleet.kind.station"), fleet.choices.stations)} ${choice("lot", t("fleet.kind.lot"), fleet.choices.lots)}
      ${choice("plan", t("fleet.plan"), fleet.choices.plans, `${t("fleet.most_run")}${!chosen.plan && fleet.plan ? `${sign(": ")}${planOf(fleet.plan)}` : ""}`)} ${date("since")} ${date("until")}</div>
      <${LeftOut} fleet=${fleet} simulated=${chosen.simulated} choose=${set("simulated")} />
      ${fleet.units ? html`<${Board} fleet=${fleet} params=${params} />` : html`<p class="soft">${t(filtered ? "units.nothing" : "fleet.empty")}</p>
        ${filtered && html`<p><button type="button" class="narrow" onClick=${clear}>${t("fleet.clear")}</button></p>`}`}`}
  </div>`;
}
