// Profiles, stations, limits and plans as texts: checked while they are typed, errors at their lines, what is run with its picture.
import { html, useEffect, useRef, useState } from "../lib/preact.js";
import { compute, get, put, url } from "../lib/api.js";
import { Curve } from "../lib/curve.js";
import { Busy, Lamp, Trouble, Unknown } from "../lib/parts.js";
import { choose, useUnsaved } from "../lib/leaving.js";
import { remember } from "../lib/router.js";
import { Said } from "../lib/said.js";
import { may } from "../lib/store.js";
import { limitsName, planTitle, stationName } from "../lib/names.js";
import { FILE_NAME } from "../lib/typed.js";
import { duration, t } from "../lib/words.js";
import { Findings } from "./start/ready.js";
import { useGet } from "./stock/parts.js";

const KINDS = ["profiles", "stations", "limits", "plans"];
/** Kinds that a station carries out. */
const DONE = ["profiles", "plans"];
const PAUSE_MS = 600;

/** Name of a file; a profile that is not as it was shipped has that of its file, whatever the shipped one says. */
const titleOf = (kind, id, changed) => ({ profiles: () => planTitle({ id, title: id, shipped: !changed }), stations: () => stationName(id), limits: () => limitsName(id), plans: () => planTitle({ id, title: id, shipped: !changed, calibration: true }) })[kind]();

/** The check of a text, asked for a moment after the last key: {result, error, busy}. */
function useDraft(kind, id, text, station) {
  const [seen, setSeen] = useState(/** @type {{key?: string, result?: any, error?: any}} */ ({}));
  const key = JSON.stringify([kind, id, text, station]);
  useEffect(() => {
    if (text === null) return undefined;
    const leaving = new AbortController();
    const timer = setTimeout(() => {
      compute(url`/files/${kind}/${id}/checks`, { text, station }, { signal: leaving.signal }).then(
        (result) => setSeen({ key, result }),
        (error) => error.name !== "AbortError" && setSeen({ key, error }),
      );
    }, PAUSE_MS);
    return () => {
      clearTimeout(timer);
      leaving.abort();
    };
  }, [key]);
  return { ...seen, busy: text !== null && seen.key !== key };
}

/** The text with the numbers of its lines; those with an error are marked. */
function Editor({ text, wrong, change, focus, closed }) {
  const area = useRef(null);
  const numbers = useRef(null);
  const lines = text.split("\n").length;
  useEffect(() => {
    if (!focus) return;
    const from = text.split("\n").slice(0, focus.line - 1).join("\n").length + (focus.line > 1 ? 1 : 0);
    area.current.focus();
    area.current.setSelectionRange(from, from + text.slice(from).split("\n")[0].length);
    area.current.scrollTop = (focus.line - 4) * (area.current.scrollHeight / lines);
  }, [focus]);
  return html`<div class="edit"><ol class="edit-numbers" aria-hidden="true" ref=${numbers}>${Array.from({ length: lines }, (_, index) => html`<li key=${index} class=${wrong.has(index + 1) ? "wrong" : undefined}>${index + 1}</li>`)}</ol>
    <textarea ref=${area} class="mono" aria-label=${t("files.text")} aria-invalid=${wrong.size > 0} spellcheck=${false} autocomplete="off" autocapitalize="off" wrap="off" readonly=${closed} value=${text}
      onInput=${(event) => change(event.target.value)} onScroll=${(event) => (numbers.current.scrollTop = event.target.scrollTop)}></textarea></div>`;
}

function File({ kind, id, title, stations, saved }) {
  const [file, setFile] = useState(/** @type {any} */ (null));
  const [text, setText] = useState(/** @type {string | null} */ (null));
  const [name, setName] = useState(id);
  const [station, setStation] = useState("simulated");
  const [focus, setFocus] = useState(/** @type {{line: number} | null} */ (null));
  const [state, setState] = useState(/** @type {{saved?: boolean, busy?: boolean, error?: any}} */ ({}));
  const load = () => {
    get(url`/files/${kind}/${id}`).then((found) => {
      setFile(found);
      setText(found.text);
    }, (error) => setState({ error }));
  };
  useEffect(load, []);
  const mine = may("engineer");
  const check = useDraft(kind, id, mine ? text : null, station);
  const findings = check.result?.findings ?? [];
  const changed = Boolean(file) && text !== file.text;
  useUnsaved(changed);
  const save = async (event) => {
    event.preventDefault();
    setState({ busy: true });
    try {
      const kept = await put(url`/files/${kind}/${name}`, { text, digest: name === id ? file.digest : "" });
      setState({ saved: true });
      if (name === id) setFile(kept);
      saved(name);
    } catch (error) {
      setState({ error });
    }
  };
  if (text === null && state.error?.status === 400) return html`<${Unknown} what=${html`<${Said} text=${state.error.message} whole />`} way=${() => saved("")} words=${t("files.choose")} />`;
  if (text === null) return state.error ? html`<${Trouble} error=${state.error} retry=${load} />` : html`<${Busy} />`;
  const warnings = findings.filter(({ level }) => level === "warning").length;
  const tone = check.result?.ok === false ? "bad" : warnings ? "warn" : "good";
  return html`<form class="edit-file stack" onSubmit=${save}>
    <h2>${title} <span class="small soft mono">${id}.yaml</span></h2>
    <p class="small soft">${t(file.own ? "files.own" : "files.shipped")}</p>
    <div class=${DONE.includes(kind) ? "edit-two" : undefined}>
      <div class="stack"><${Editor} text=${text} wrong=${new Set(findings.filter(({ level }) => level === "error").map(({ line }) => line))} focus=${focus} closed=${!mine} change=${(next) => {
        setText(next);
        setState({});
      }} />
        <${Trouble} error=${state.error} forget=${() => setState({})} />
        ${!mine ? html`<p>${t("papers.engineers")}</p>` : html`<div class="row"><label for="files-name">${t("files.name")}</label><input id="files-name" class="mono" value=${name} maxlength="60" autocomplete="off" spellcheck=${false} aria-invalid=${!FILE_NAME.test(name)} aria-describedby="files-name-wrong" onInput=${(event) => setName(event.target.value.trim().normalize("NFC"))} />
          <button type="submit" class="primary" disabled=${state.busy || !FILE_NAME.test(name) || (!changed && name === id)}>${t(file.own && name === id ? "files.save" : "files.save_own")}</button>
          <button type="button" disabled=${!changed} onClick=${() => setText(file.text)}>${t("files.back")}</button>
          <span role="status">${state.saved && html`<${Lamp} tone="good">${t("files.saved")}<//>`}</span></div><p id="files-name-wrong" class="tone-bad small" role="status">${!FILE_NAME.test(name) && t("files.name_wrong")}</p>`}
      </div>
      <div class="stack">
        ${mine && DONE.includes(kind) && html`<div class="field"><label for="files-station">${t("files.station")}</label><select id="files-station" value=${station} onChange=${(event) => setStation(event.target.value)}>${stations.map((one) => html`<option key=${one} value=${one} selected=${one === station} title=${one}>${stationName(one)}</option>`)}</select></div>`}
        ${check.result?.curve?.length > 0 && html`<${Curve} curve=${check.result.curve} width=${520} height=${260} axes />`}
        <div role="status">${check.busy ? html`<${Busy}>${t("ready.checking")}<//>` : check.result && html`<p><${Lamp} tone=${tone}>${tone === "warn" ? t("ready.warn", { n: warnings }) : t(`files.${tone}`)}<//>${check.result.duration_s ? html` <span class="soft">${t("ready.takes")} ${duration(check.result.duration_s)}</span>` : ""}</p>`}</div>
        <${Trouble} error=${check.error} />
        <${Findings} findings=${findings} lines=${(line) => html`<button type="button" class="narrow" onClick=${() => setFocus({ line })}>${t("files.line", { line: String(line) })}</button>`} />
      </div>
    </div>
    ${kind === "stations" && html`<p><a href=${`/laboratory?station=${encodeURIComponent(id)}`}>${t("papers.title")}</a></p>`}
  </form>`;
}

export default function Files({ query }) {
  const { data, error, again } = useGet("/files");
  const [kind, setKind] = useState(KINDS.includes(query.kind) ? query.kind : "profiles");
  const [id, setId] = useState(query.id ?? "");
  const open = (next) => {
    setId(next);
    remember({ kind, id: next });
  };
  if (!data) return html`<div class="page">${error ? html`<${Trouble} error=${error} retry=${again} />` : html`<${Busy} />`}</div>`;
  const title = (one) => titleOf(kind, one, data.changed[kind].includes(one));
  return html`<div class="page stack"><h1>${t("files.title")}</h1><p class="soft">${t("files.what")}</p>
    <div class="row"><div class="field"><label for="files-kind">${t("files.kind")}</label>
        <select id="files-kind" value=${kind} onChange=${(event) => choose(event, kind, (next) => {
          setKind(next);
          setId("");
        })}>${KINDS.map((one) => html`<option key=${one} value=${one} selected=${one === kind}>${t(`files.${one}`)}</option>`)}</select></div>
      <div class="field"><label for="files-id">${t("files.file")}</label>
        <select id="files-id" value=${id} onChange=${(event) => choose(event, id, open)}><option value="">${t("files.choose")}</option>
          ${data[kind].map((one) => html`<option key=${one} value=${one} selected=${one === id} title=${one}>${title(one)}${data.own[kind].includes(one) ? ` · ${t("files.mine")}` : ""}</option>`)}</select></div></div>
    ${id && html`<${File} key=${`${kind} ${id}`} kind=${kind} id=${id} title=${title(id)} stations=${data.stations} saved=${(name) => {
      again();
      if (name !== id) open(name);
    }} />`}
  </div>`;
}
