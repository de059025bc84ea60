// Import of a table of another program as a run: drop it, check the recognised content, correct it, import.
import { html, useEffect, useRef, useState } from "../lib/preact.js";
import { finished, post, remove, upload, url } from "../lib/api.js";
import { Busy, Lamp, TextField, Trouble } from "../lib/parts.js";
import { Said } from "../lib/said.js";
import { may } from "../lib/store.js";
import { asGiven, channelWord, duration, number, sign, symbols, t } from "../lib/words.js";
import { repeated } from "../lib/units.js";
import { Doubled } from "./start/slots.js";
import { Chart } from "./stock/chart.js";
import { useGet } from "./stock/parts.js";

const CAN_LOGS = /\.(blf|asc|log|trc)$/i;
const UNIT = /^[A-Za-z0-9_+][A-Za-z0-9._+-]*$/;
const ARROW = html`<svg viewBox="0 0 24 24" aria-hidden="true"><path d="M12 16V4m0 0L7 9m5-5 5 5M4 15v4a1 1 0 0 0 1 1h14a1 1 0 0 0 1-1v-4" fill="none" stroke="currentColor" stroke-width="2" stroke-linecap="round" stroke-linejoin="round" /></svg>`;

const bytes = (size) => (size >= 1 << 30 ? `${number(size / (1 << 30), 1)}\u00a0GiB` : `${number(size / (1 << 20), size < 10 << 20 ? 1 : 0)}\u00a0MiB`);

function Drop({ kinds, take, refused }) {
  const [over, setOver] = useState(false);
  const input = useRef(null);
  const given = (list) => {
    const files = [...list];
    const dbc = files.find((file) => /\.dbc$/i.test(file.name));
    const file = files.find((one) => one !== dbc);
    if (file) take(file, dbc);
  };
  const drag = (on) => (event) => {
    event.preventDefault();
    setOver(on);
  };
  return html`<section class=${`st-drop ${over ? "over" : ""}`} aria-label=${t("import.drop")} onDragOver=${drag(true)} onDragLeave=${drag(false)}
      onDrop=${(event) => { drag(false)(event); given(event.dataTransfer.files); }}>
    ${ARROW}<h2>${t("import.drop")}</h2>
    <p class="soft">${t("import.kinds", { kinds: kinds.endings.join(" "), most: bytes(kinds.most_bytes) })}</p>
    <input ref=${input} type="file" multiple hidden accept=${[...kinds.endings, ".dbc"].join(",")} onChange=${(event) => given(event.target.files)} aria-label=${t("import.choose")} />
    <button type="button" class="primary" onClick=${() => input.current.click()}>${t("import.choose")}</button>
    <p class="small soft">${t("import.dbc")}</p>
    <${Trouble} error=${refused} />
  </section>`;
}

/** Uploads that were neither imported nor given up. */
function Waiting({ kinds, goOn, giveUp }) {
  if (!kinds.waiting.length) return null;
  return html`<section class="panel stack" aria-labelledby="waiting"><h2 id="waiting">${t("import.waiting", { n: kinds.waiting.length, most: kinds.most_waiting })}</h2>
    <ul class="findings">${kinds.waiting.map((one) => html`<li key=${one.import} class="row spread"><span><b>${one.file}</b> <span class="soft">${bytes(one.bytes)}${sign(", ")}${t("import.expires", { left: duration(one.left_s) })}</span></span>
      <span class="row"><button type="button" class="narrow" onClick=${() => goOn(one)}>${t("import.go_on")}<span class="unseen"> ${one.file}</span></button>
      <button type="button" class="narrow" onClick=${() => giveUp(one.import)}>${t("import.give_up")}<span class="unseen"> ${one.file}</span></button></span></li>`)}</ul></section>`;
}

/** The chosen columns and units in the form of the API; empty ones are taken from the headers. */
function columnsOf(chosen) {
  const out = {};
  for (const [channel, { column, unit }] of Object.entries(chosen)) {
    const step = channel === "time" ? stepOf(unit) : null;
    if (column || step) out[channel] = { ...(column ? { column } : {}), ...(step ?? (unit ? { unit } : {})) };
  }
  return out;
}

/** How long a sample takes, as "0.005 s" or "200 Hz", in the form of the API; null for a mere unit. */
function stepOf(unit) {
  const [, size, kind] = /^([\d.,]+(?:e-?\d+)?)\s*(s|ms|Hz)$/i.exec(unit) ?? [];
  const value = Number(size?.replace(",", "."));
  if (!(value > 0)) return null;
  return kind.toLowerCase() === "hz" ? { rate_hz: value } : { interval_s: kind === "ms" ? value / 1000 : value };
}

const stepSaid = ({ interval_s, rate_hz }) => (interval_s ? `${interval_s} s` : rate_hz ? `${rate_hz} Hz` : "");

/** Columns without a channel that have a button. */
const MOST_OFFERED = 8;

/** The recognised content as the initial choice. */
function choiceOf(understood) {
  const out = { time: { column: understood.time.column ?? "", unit: understood.time.unit ?? stepSaid(understood.time) } };
  for (const one of understood.channels) out[one.channel] = { column: one.column, unit: one.unit };
  return out;
}

/** Content of the headers, if the table as a whole was not recognised. */
function guessOf({ guess, columns }) {
  const unit = (name) => columns.find((one) => one.name === name)?.unit ?? "";
  return Object.fromEntries(Object.entries(guess).map(([channel, column]) => [channel, { column, unit: unit(column) }]));
}

const AXES = ["rate_x", "rate_y", "rate_z"];

function Channel({ kind, needed, seen, columns, choice, change }) {
  const known = columns.find((one) => one.name === (choice.column || seen?.column));
  const id = `unit-${kind.name}`;
  const word = channelWord(kind.name);
  return html`<tr class=${choice.column ? "" : "unused"}>
    <th scope="row">${word}${needed && html`<span class="soft small"> · ${t("import.required")}</span>`}</th>
    <td><select aria-label=${t("import.column_of", { channel: word })} value=${choice.column} onChange=${(event) => change({ column: event.target.value, unit: columns.find((one) => one.name === event.target.value)?.unit ?? "" })}>
      <option value="" selected=${!choice.column}>–</option>
      ${columns.map((one) => html`<option key=${one.name} value=${one.name} selected=${one.name === choice.column}>${one.name}</option>`)}</select></td>
    <td><${TextField} list=${id} size="8" aria-label=${t("import.unit_of", { channel: word })} placeholder=${kind.unit} value=${choice.unit} disabled=${!choice.column && kind.name !== "time"} onGiven=${(unit) => change({ ...choice, unit: unit.trim() })} />
      <datalist id=${id}>${kind.examples.map((one) => html`<option key=${one} value=${one}></option>`)}</datalist></td>
    <td class="n">${seen ? html`${asGiven(seen.low, 4)} … ${asGiven(seen.high, 4)} <span class="soft">${symbols(seen.to)}${seen.took !== undefined && ` (${duration(seen.took)})`}</span>` : html`<span class="soft">–</span>`}</td>
    <td class="small soft mono wide">${known ? known.first.slice(0, 4).map((value) => asGiven(value, 7)).join(", ") : ""}</td></tr>`;
}

function Understood({ shown, kinds, choice, change, busy }) {
  const { understood, columns } = shown;
  const seen = (name) => understood && name === "time" ? { column: understood.time.column, low: 0, high: understood.duration_s, to: "s", took: understood.duration_s } : understood?.channels.find((one) => one.channel === name);
  const used = new Set([understood?.time.column, ...(understood?.channels ?? []).map((one) => one.column)]);
  const axes = AXES.some((name) => choice[name]?.column);
  const needed = ({ name, required }) => required && !(name === "rate" && axes);
  const there = (kind) => needed(kind) || Boolean(choice[kind.name]?.column);
  const table = (channels) => html`<div class="scroll"><table class="st-map"><thead><tr><th scope="col">${t("import.channel")}</th><th scope="col">${t("import.column")}</th><th scope="col">${t("import.unit")}</th><th scope="col" class="n">${t("import.range")}</th><th scope="col" class="wide">${t("import.first")}</th></tr></thead>
    <tbody>${channels.map((kind) => html`<${Channel} key=${kind.name} kind=${kind} needed=${needed(kind)} columns=${columns} seen=${seen(kind.name)} choice=${choice[kind.name] ?? { column: "", unit: "" }} change=${(next) => change(kind.name, next)} />`)}</tbody></table></div>`;
  const rest = understood ? columns.filter((one) => !used.has(one.name)) : [];
  const spare = kinds.channels.find(({ name }) => name.startsWith("other_") && !choice[name]?.column)?.name;
  return html`<section class="stack" aria-labelledby="understood" aria-busy=${busy ? "true" : "false"}><div class="row spread"><h2 id="understood">${t("import.understood")}</h2>
      ${busy ? html`<${Busy}>${t("import.reading")}<//>` : understood ? html`<${Lamp} tone="good">${t("import.clear")}<//>` : html`<${Lamp} tone="warn">${t("import.unclear")}<//>`}</div>
    ${shown.problem && html`<div class="notice warn" role="alert"><p><${Said} text=${shown.problem} /></p>${!understood && !choice.time?.column && html`<p class="small">${t("import.step")}</p>`}</div>`}
    ${understood && shown.notes.filter((text) => !understood.warnings.includes(text)).map((text) => html`<p class="soft" key=${text}><${Said} text=${text} whole /></p>`)}
    ${understood?.warnings.map((text) => html`<div class="notice warn" key=${text}><p><${Said} text=${text} whole /></p></div>`)}
    ${table(kinds.channels.filter(there))}
    <details class="st-further"><summary>${t("import.further")}</summary>${table(kinds.channels.filter((kind) => !there(kind)))}</details>
    ${rest.length > 0 && html`<div class="row soft"><span>${t("import.rest")}</span>${rest.slice(0, MOST_OFFERED).map(({ name }) => (spare ? html`<button key=${name} title=${t("import.use", { column: name, channel: channelWord(spare) })} onClick=${() => change(spare, { column: name, unit: "" })}>+ ${name}</button>` : html`<span key=${name}>${name}</span>`))}
      <span>${rest.slice(MOST_OFFERED).map((one) => one.name).join(", ")}</span></div>`}
    ${understood && html`<p>${t("import.summary", { n: understood.rows, took: duration(understood.duration_s), every: t("time.s", { s: asGiven(understood.interval_s, 3) }) })}</p>
      <details><summary>${t("import.segments", { n: understood.segments.length })}</summary><ol>${understood.segments.map((one) => html`<li key=${one.index}>${t(`import.direction.${one.direction}`)}${sign(", ")}${number(one.target_degc, 1)} °C${sign(", ")}${duration(one.to_s - one.from_s)}</li>`)}</ol></details>
      <${Chart} figure=${shown.figure} words=${t("import.picture")} name="import" height=${340} />`}
  </section>`;
}

function Done({ result, again }) {
  const [unit] = result.run.split("/");
  const heading = useRef(null);
  useEffect(() => heading.current.focus(), []);
  return html`<div class="panel stack"><h2 tabindex="-1" ref=${heading}><${Lamp} tone="good">${t("import.done")}<//></h2><p class="mono">${result.run}</p>
    ${result.warnings.map((text) => html`<div class="notice warn" key=${text}><p><${Said} text=${text} whole /></p></div>`)}
    <div class="row"><a class="button primary" href=${`/workbench?run=${encodeURIComponent(result.run)}`}>${t("verdict.workbench")}</a>
      <a class="button" href=${`/units/${encodeURIComponent(unit)}`}>${t("import.to_unit", { unit })}</a>
      <button onClick=${again}>${t("import.another")}</button></div></div>`;
}

export default function Import() {
  const { data: kinds, error, again: list } = useGet("/imports");
  const [state, setState] = useState(/** @type {any} */ ({ step: "drop" }));
  const [choice, setChoice] = useState({});
  const { data: places } = useGet("/stations");
  const [unit, setUnit] = useState("");
  const [doubled, setDoubled] = useState("");
  const field = useRef(null);
  const turn = useRef(0);
  const merge = (more) => setState((now) => ({ ...now, ...more }));
  const place = state.id && url`/imports/${state.id}`;
  useEffect(() => () => { turn.current = -1; }, []);

  /** Show the content that a job recognised, unless a newer one was requested. */
  async function read(job, ticket) {
    const shown = await finished(job);
    if (turn.current !== ticket) return;
    setChoice((now) => (shown.understood ? choiceOf(shown.understood) : Object.keys(now).length ? now : guessOf(shown)));
    merge({ step: "look", shown, busy: false, error: null });
  }
  async function take(file, dbc) {
    const ticket = ++turn.current;
    const form = new FormData();
    if (dbc) form.append("dbc", dbc);
    form.append("file", file);
    setState({ step: "sending", file: file.name });
    setChoice({});
    let taken = null;
    try {
      if (file.size > kinds.most_bytes) throw new Error(t("import.too_large", { size: bytes(file.size), most: bytes(kinds.most_bytes) }));
      if (CAN_LOGS.test(file.name) && !dbc) throw new Error(t("import.needs_dbc"));
      taken = await upload("/imports", form);
      merge({ step: "reading", id: taken.import, file: taken.file });
      await read(taken.job, ticket);
    } catch (trouble) {
      if (taken) remove(url`/imports/${taken.import}`).catch(() => {}); // nothing can be done with it
      if (turn.current === ticket) setState({ step: "drop", error: trouble });
    }
  }
  async function change(channel, next) {
    const updated = { ...choice, [channel]: next };
    const ticket = ++turn.current;
    setChoice(updated);
    merge({ busy: true });
    try {
      const { job } = await post(`${place}/preview`, { columns: columnsOf(updated) });
      await read(job, ticket);
    } catch (trouble) {
      if (turn.current === ticket) merge({ busy: false, error: trouble });
    }
  }
  /** Import as the run of this unit, once its serial number is `meant`. */
  async function make(serial, meant = false) {
    const single = meant ? "" : repeated(serial, (places?.stations ?? []).flatMap((station) => station.units));
    setDoubled(single);
    if (single) return;
    setUnit(serial);
    field.current.focus();
    merge({ making: true, error: null });
    try {
      const { job } = await post(place, { unit: serial, columns: columnsOf(choice) });
      setState({ step: "done", result: await finished(job) });
    } catch (trouble) {
      merge({ making: false, error: trouble });
    }
  }
  const again = () => {
    if (state.id && state.step !== "done") remove(place).catch(() => {});
    turn.current += 1;
    setState({ step: "drop" });
    list();
  };
  const giveUp = (id) => remove(url`/imports/${id}`).then(list, (trouble) => merge({ error: trouble }));
  const goOn = async (one) => {
    const ticket = ++turn.current;
    setState({ step: "reading", id: one.import, file: one.file });
    setChoice({});
    try {
      await read((await post(url`/imports/${one.import}/preview`)).job, ticket);
    } catch (trouble) {
      if (turn.current === ticket) setState({ step: "drop", error: trouble });
    }
  };
  const wrong = unit && !UNIT.test(unit);
  return html`<div class="page stack"><h1>${t("import.title")}</h1><p class="soft">${t("import.what")}</p>
    <${Trouble} error=${error} />
    ${!may("engineer") && html`<div class="notice"><p>${t("import.engineers")}</p></div>`}
    ${kinds && may("engineer") && state.step === "drop" && html`<${Drop} kinds=${kinds} take=${take} refused=${state.error} /><${Waiting} kinds=${kinds} goOn=${goOn} giveUp=${giveUp} />`}
    ${["sending", "reading"].includes(state.step) && html`<section class="st-drop"><h2>${state.file}</h2><${Busy}>${t(`import.${state.step}`)}<//><button onClick=${again}>${t("import.give_up")}</button></section>`}
    ${state.step === "look" && html`<div class="row spread"><p><b>${state.file}</b> <span class="soft">${t("import.rows", { n: state.shown.rows })}</span></p><button class="narrow" onClick=${again}>${t("import.give_up")}</button></div>
      <form class="panel row" onSubmit=${(event) => {
        event.preventDefault();
        make(unit);
      }}>
        <label for="unit">${t("import.serial")}</label>
        <input id="unit" ref=${field} required maxlength="64" autocomplete="off" aria-invalid=${wrong ? "true" : undefined} aria-describedby="unit-hint" value=${unit} onInput=${(event) => {
          setDoubled("");
          setUnit(event.target.value.trim());
        }} />
        <button class="primary" disabled=${!state.shown.understood || state.busy || state.making || !unit || wrong}>${t(state.making ? "import.making" : "import.make")}</button>
        <span id="unit-hint" class=${wrong ? "tone-bad" : "soft"}>${t(wrong ? "import.serial_wrong" : "import.serial_hint")}</span></form>
      <div aria-live="assertive">${doubled && html`<${Doubled} serial=${unit} single=${doubled} take=${(serial) => make(serial, true)} />`}</div>
      <${Trouble} error=${state.error} />
      <${Understood} shown=${state.shown} kinds=${kinds} choice=${choice} change=${change} busy=${state.busy} />`}
    ${state.step === "done" && html`<${Done} result=${state.result} again=${again} />`}
  </div>`;
}
