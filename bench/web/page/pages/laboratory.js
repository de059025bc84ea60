// Laboratory and reference equipment of a station, as forms that are filled in once.
import { html, useEffect, useState } from "../lib/preact.js";
import { get, put, url } from "../lib/api.js";
import { Busy, Lamp, Trouble } from "../lib/parts.js";
import { choose, useUnsaved } from "../lib/leaving.js";
import { remember } from "../lib/router.js";
import { may } from "../lib/store.js";
import { stationName } from "../lib/names.js";
import { sign, symbols, t } from "../lib/words.js";
import { Going, useAct } from "./run.js";
import { numberOf } from "../lib/typed.js";
import { Said } from "../lib/said.js";

// Path of each field in the file; `!` must be filled in.
const LABORATORY = [
  ["laboratory.name", "text", true], ["laboratory.address", "text"], ["laboratory.country", "country"], ["place", "text"],
  ["authorised_by.name", "text", true], ["authorised_by.function", "text"],
  ["customer.name", "text"], ["customer.address", "text"], ["item.model", "text"], ["item.condition", "text"],
];
const INSTRUMENT = [
  ["name", "text", true], ["model", "text"], ["serial", "text", true], ["certificate", "text"], ["calibrated", "date"], ["due", "date", true],
  ["uncertainty.0.value", "number"], ["uncertainty.0.unit", "unit"],
];
const UNITS = ["", "degC", "ppm", "deg"];

const at = (content, path) => path.split(".").reduce((value, key) => value?.[key], content) ?? "";

/**
 * The same with another value at a path; numbers in it are places in lists.
 * @param {any} content
 * @param {string[]} path
 */
function changed(content, path, value) {
  const [key, ...rest] = path;
  const copy = Array.isArray(content) ? [...content] : { ...content };
  copy[key] = rest.length ? changed(copy[key] ?? (/^\d+$/.test(rest[0]) ? [] : {}), rest, value) : value;
  return copy;
}

export default function Laboratory({ query }) {
  const [stations, setStations] = useState(/** @type {any} */ (null));
  const [station, setStation] = useState(query.station ?? "");
  const [seen, setSeen] = useState(/** @type {{papers?: any, error?: Error}} */ ({}));
  const load = () => {
    get("/stations").then(({ stations: all }) => setStations(all.filter(({ problem }) => !problem)), (error) => setSeen({ error }));
  };
  useEffect(load, []);
  const chosen = station || stations?.[0]?.id;
  useEffect(() => {
    if (!chosen) return;
    setSeen({});
    get(url`/stations/${chosen}/papers`).then((papers) => setSeen({ papers }), (error) => setSeen({ error }));
    remember({ station: chosen });
  }, [chosen]);
  if (!stations) return html`<div class="page">${seen.error ? html`<${Trouble} error=${seen.error} retry=${load} />` : html`<${Busy} />`}</div>`;
  return html`<div class="page stack papers"><h1>${t("papers.title")}</h1><p class="soft">${t("papers.what")}</p>
    <div class="field"><label for="station">${t("papers.station")}</label>
      <select id="station" value=${chosen} onChange=${(event) => choose(event, chosen, setStation)}>${stations.map(({ id, title }) => html`<option key=${id} value=${id} selected=${id === chosen} title=${title}>${stationName(title)}</option>`)}</select></div>
    ${may("operator") && chosen && html`<${Doctor} key=${`doctor ${chosen}`} station=${chosen} />`}
    <${Trouble} error=${seen.error} />
    ${seen.papers && html`<${Form} key=${`laboratory ${chosen}`} kind="laboratory" station=${chosen} paper=${seen.papers.laboratory} empty=${{}} Fields=${LaboratoryFields} />
      <${Form} key=${`equipment ${chosen}`} kind="equipment" station=${chosen} paper=${seen.papers.equipment} empty=${{ equipment: [{}] }} Fields=${Instruments} />
      <${Form} key=${`notify ${chosen}`} kind="notify" station=${chosen} paper=${seen.papers.notify} empty=${{ recipients: [{}] }} Fields=${Recipients} />
      ${may("engineer") && html`<${Trial} key=${`trial ${chosen}`} station=${chosen} />`}`}
  </div>`;
}

const TONES = { agrees: "good", disagrees: "bad", "no link": "bad", unknown: "idle", told: "idle" };

/** What the equipment says of itself, beside the station file; nothing is written. */
function Doctor({ station }) {
  const job = useAct();
  const { result } = job;
  return html`<section class="panel stack"><h2 id="doctor">${t("doctor.title")}</h2><p class="small soft">${t("doctor.what")}</p>
    <p><button type="button" disabled=${job.busy} onClick=${() => job.act(url`/stations/${station}/doctor`, {})}>${t("doctor.ask")}</button></p>
    <${Going} job=${job} />
    ${result && html`<p role="status"><${Lamp} tone=${result.agrees ? "good" : "bad"}>${t(result.agrees ? "doctor.all" : "doctor.differs")}<//></p>
      <div class="scroll" tabindex="0" role="region" aria-labelledby="doctor"><table><tbody>${result.findings.map(({ what, verdict, detail, uncertain }) => html`
        <tr key=${`${what} ${detail}`}><td><${Lamp} tone=${TONES[verdict]}>${t(`doctor.${verdict.replace(" ", "_")}`)}<//></td><th scope="row"><${Said} text=${what} /></th><td><${Said} text=${detail} />${uncertain && html`<span class="soft">${sign(" (")}${t("doctor.weak")}${sign(")")}</span>`}</td></tr>`)}</tbody></table></div>`}
  </section>`;
}

/** A trial to everybody who is told of runs, as saved. */
function Trial({ station }) {
  const job = useAct();
  return html`<section class="panel stack" aria-labelledby="trial"><h2 id="trial">${t("notices.trial")}</h2><p class="small soft">${t("notices.trial.what")}</p>
    <p><button type="button" disabled=${job.busy} onClick=${() => job.act(url`/stations/${station}/notices`, {})}>${t("notices.send")}</button></p>
    <${Going} job=${job} />
    <ul class="findings" role="status">${Object.entries(job.result?.recipients ?? {}).map(([name, wrong]) => html`<li key=${name}><${Lamp} tone=${wrong ? "bad" : "good"}>${name}${sign(": ")}${wrong ? html`<${Said} text=${wrong} />` : t("notices.taken")}<//></li>`)}</ul>
  </section>`;
}

/** With numbers in place of what was typed into fields of numbers. */
const numbered = (content) => JSON.parse(JSON.stringify(content), (key, value) => (key === "value" && value ? numberOf(String(value)) : value));

/** What is filled in, a line each: an empty field, or group, is none. */
const filled = (value, path = "") => (typeof value !== "object" || value === null ? (value === "" ? [] : [`${path} ${value}`])
  : Object.keys(value).sort().flatMap((key) => filled(value[key], `${path}.${key}`)));

/** What the server says of a form: the path in the file that it begins with, a key that is missing there, or what is wrong. */
const WRONG = /^([a-z_]+(?:\[\d+\]|\.[a-z_]+)*)(?:: missing key '(\w+)' .*|: | is .*?: (?=must ))(.*)$/s;

/** The same in the words of the form, whose field gets the focus. */
function inForm(form, error) {
  const [, path, key, wrong] = WRONG.exec(error.message) ?? [];
  const field = path && document.getElementById([path, key].filter(Boolean).join(".").replace(/\[(\d+)\]/g, ".$1"));
  if (!field || !form.contains(field)) return error;
  (field.matches("fieldset, [role]") ? field.querySelector("input") : field).focus();
  const where = [field.closest("fieldset").querySelector(":scope > legend"), form.querySelector(`label[for="${field.id}"]`)?.firstChild ?? document.getElementById(field.getAttribute("aria-labelledby"))];
  return { message: `${where.filter(Boolean).map((one) => one.textContent).join(sign(", "))}: ${key ? "must be filled in" : wrong}` };
}

function Form({ kind, station, paper: opened, empty, Fields }) {
  const [paper, setPaper] = useState({ ...opened, content: opened.content ?? empty });
  const [content, setContent] = useState(paper.content);
  const [state, setState] = useState(/** @type {{saved?: boolean, error?: any, busy?: boolean}} */ ({}));
  useUnsaved(filled(content).join("\n") !== filled(paper.content).join("\n"));
  const save = async (event) => {
    event.preventDefault();
    const form = event.currentTarget;
    setState({ busy: true });
    try {
      const kept = await put(url`/stations/${station}/papers/${kind}`, { content: numbered(content), digest: paper.digest });
      const shown = kind === "notify" ? kept.content ?? empty : content; // without the addresses that were typed
      setContent(shown);
      setPaper({ ...kept, content: shown });
      setState({ saved: true });
    } catch (error) {
      setState({ error: inForm(form, error) });
    }
  };
  const change = (path, value) => {
    setContent((now) => changed(now, path.split("."), value));
    setState({});
  };
  return html`<form class="panel stack" aria-labelledby=${kind} onSubmit=${save}><h2 id=${kind}>${t(`papers.${kind}`)}</h2>${kind === "notify" && html`<p class="small soft">${t("notices.what")}</p>`}
    <p class="small soft">${paper.file ? t("papers.file", { file: paper.file }) : t("papers.no_file")}</p>
    <${Trouble} error=${paper.problem || null} />
    <fieldset class="all" disabled=${!may("engineer")}><${Fields} content=${content} change=${change} /></fieldset>
    <${Trouble} error=${state.error} forget=${() => setState({})} />
    <div class="row">${may("engineer") ? html`<button type="submit" class="primary" disabled=${state.busy}>${t(`papers.${kind}.save`)}</button>` : html`<p>${t("papers.engineers")}</p>`}
      <span role="status">${state.saved && t(kind === "notify" ? "notices.saved" : "papers.saved")}</span></div>
  </form>`;
}

function Field({ id, label, type, required, value, change }) {
  const kinds = {
    number: { type: "text", inputmode: "decimal", pattern: "\\s*(\\d+([.,]\\d*)?|[.,]\\d+)(e[\\-+]?\\d+)?\\s*" },
    date: { type, max: "9999-12-31" },
    country: { type: "text", pattern: "[A-Z]{2}", maxLength: 2, title: t("papers.country_like") },
    text: { type, pattern: required ? ".*\\S.*" : undefined },
  };
  return html`<div class="field"><label for=${id}>${label}${required && html`<span class="soft" aria-hidden="true"> *</span>`}</label>
    ${type === "unit" ? html`<select id=${id} value=${value} onChange=${(event) => change(event.target.value)}>${UNITS.map((unit) => html`<option key=${unit} value=${unit} selected=${unit === value}>${symbols(unit) || "–"}</option>`)}</select>`
      : html`<input id=${id} ...${kinds[type]} required=${required} value=${value} onInput=${(event) => change(event.target.value)} />`}</div>`;
}

const LaboratoryFields = ({ content, change }) => html`<div class="papers-fields">
  ${LABORATORY.map(([path, type, required]) => html`<${Field} key=${path} id=${path} type=${type} required=${required} label=${t(`papers.field.${path}`)} value=${at(content, path)} change=${(value) => change(path, value)} />`)}</div>`;

function Instruments({ content, change }) {
  const tools = content.equipment ?? [];
  return html`${tools.map((tool, index) => html`<fieldset key=${index} id=${`equipment.${index}`}><legend>${t("papers.instrument", { n: index + 1 })}</legend>
      <div class="papers-fields">${INSTRUMENT.map(([path, type, required]) => html`<${Field} key=${path} id=${`equipment.${index}.${path}`} type=${type} required=${required}
        label=${t(`papers.tool.${path}`)} value=${at(tool, path)} change=${(value) => change(`equipment.${index}.${path}`, value)} />`)}</div>
      ${tools.length > 1 && html`<button type="button" class="narrow" onClick=${() => change("equipment", tools.filter((_, other) => other !== index))}>${t("papers.remove")}<span class="unseen"> ${tool.name ?? ""}</span></button>`}
    </fieldset>`)}
    <p><button type="button" class="narrow" onClick=${() => change("equipment", [...tools, {}])}>${t("papers.add")}</button></p>`;
}

/** What a recipient may be told of. */
const WHEN = ["end", "trip", "hold", "calibration"];

function Recipients({ content, change }) {
  const people = content.recipients ?? [];
  return html`${people.map((person, index) => html`<fieldset key=${index}><legend>${t("notices.recipient", { n: index + 1 })}</legend>
      <div class="papers-fields"><${Field} id=${`recipients.${index}.name`} type="text" required label=${t("notices.name")} value=${person.name ?? ""} change=${(value) => change(`recipients.${index}.name`, value)} />
        <div class="field"><label for=${`recipients.${index}.url`}>${t("notices.url")}${!person.kept && html`<span class="soft" aria-hidden="true"> *</span>`}</label>
          <input id=${`recipients.${index}.url`} type="password" autocomplete="new-password" spellcheck=${false} required=${!person.kept} placeholder=${person.kept ? t("notices.kept") : ""} aria-describedby="notices-like" value=${person.url ?? ""} onInput=${(event) => change(`recipients.${index}.url`, event.target.value)} /></div></div>
      <div class="row" role="group" id=${`recipients.${index}.when`} aria-labelledby=${`recipients.${index}.told`}><span id=${`recipients.${index}.told`}>${t("notices.when")}</span>${WHEN.map((kind) => html`<label key=${kind}><input type="checkbox" checked=${(person.when ?? WHEN).includes(kind)}
        onChange=${(event) => change(`recipients.${index}.when`, WHEN.filter((one) => (one === kind ? event.target.checked : (person.when ?? WHEN).includes(one))))} /> ${t(`notices.when.${kind}`)}</label>`)}</div>
      <button type="button" class="narrow" onClick=${() => change("recipients", people.filter((_, other) => other !== index))}>${t("papers.remove")}<span class="unseen"> ${person.name ?? ""}</span></button>
    </fieldset>`)}
    <p class="small soft" id="notices-like">${t("notices.url.like")}</p>
    <p><button type="button" class="narrow" onClick=${() => change("recipients", [...people, {}])}>${t("notices.add")}</button></p>`;
}
