// The current model: its effects, another model to start with, a name to save it.
import { html, or, t, api, measured, useEffect, useState } from "./parts.js";
import { effectWord } from "../../lib/words.js";
import { parameterWord } from "./sentence.js";
import { offered } from "./offered.js";
import { FILE_NAME, typed, written } from "../../lib/typed.js";
import { OwnTerm } from "./term.js";
import { fileName, save as offer } from "../../lib/download.js";
import { TextField } from "../../lib/parts.js";
import { Said } from "../../lib/said.js";

/** Options of the effects by name, with their defaults, fetched once. */
function useOptions() {
  const [options, setOptions] = useState({});
  useEffect(() => {
    api.get("/effects").then((known) => setOptions(Object.fromEntries(known.effects.map((one) => [one.effect, one.options]))), () => {});
  }, []);
  return options;
}

/** The least and the greatest value of a parameter inside a formula. */
function Bound({ name, pair, busy, change }) {
  const ends = ["low", "high"].map((end, at) => html`<${TextField} key=${end} class="wb-code" inputmode="decimal" disabled=${busy} aria-label=${t(`workbench.term.${end}`, { name })}
    value=${written(pair[at])} onGiven=${(text) => change(pair.map((old, k) => (k === at ? typed(text) : old)))} />`);
  return html`<span class="wb-option"><span>${t("workbench.term.bounds", { name })}</span> ${ends[0]} … ${ends[1]}</span>`;
}

/** One option of an effect, changed in place; the server says what is wrong with a value. */
function Option({ of, name, value, busy, change }) {
  const word = or(`workbench.option.${name}`, name);
  const label = t("workbench.model.option", { option: word, effect: effectWord(of) });
  if (typeof value === "boolean") {
    return html`<label class="wb-option"><input type="checkbox" aria-label=${label} checked=${value} disabled=${busy} onChange=${(event) => change(event.target.checked)} /> <span title=${`${name}:`}>${word}</span></label>`;
  }
  if (name === "bounds") {
    return Object.entries(value ?? {}).map(([inner, pair]) => html`<${Bound} key=${inner} name=${inner} pair=${pair} busy=${busy}
      change=${(next) => change({ ...value, [inner]: next })} />`);
  }
  return html`<label class="wb-option"><span title=${`${name}:`}>${word}</span> <${TextField} class="wb-code" aria-label=${label} disabled=${busy} title=${written(value)} value=${written(value)} onGiven=${(text) => change(typed(text))} /></label>`;
}

/** Models of the library, `read` when they are there; `again()` after one was saved. The request also has the server start its computing processes. */
export function useModels() {
  const [known, setKnown] = useState(null);
  const again = () => api.get("/models").then(({ models }) => setKnown(offered(models)), () => setKnown([]));
  useEffect(() => void again(), []);
  return { known: known ?? [], read: known !== null, again };
}

/** Models that the server takes at once. */
const MOST_MODELS = 12;

function Save({ model, runs, onSaved }) {
  const [given, setGiven] = useState("");
  const [message, setMessage] = useState(null);
  const save = async (event) => {
    event.preventDefault();
    const name = given.trim().normalize("NFC"); // as the file is called
    if (!FILE_NAME.test(name)) return setMessage({ good: false, text: t("files.name_wrong") });
    try {
      const { undeliverable } = await api.post("/models", { name, model: { ...model, name }, runs });
      setMessage({ good: true, name, undeliverable });
      onSaved();
    } catch (error) {
      setMessage({ good: false, text: error.status === 409 ? t("workbench.model.name_used", { name }) : error.message });
    }
    return undefined;
  };
  return html`<form class="wb-save" onSubmit=${save}>
    <label for="wb-model-name">${t("workbench.model.save_as")}</label>
    <div class="wb-field">
      <input id="wb-model-name" type="text" value=${given} placeholder="my_model" spellcheck=${false} autocomplete="off" onInput=${(event) => setGiven(event.target.value)} />
      <button type="submit" class="narrow" disabled=${!given.trim()}>${t("workbench.model.save")}</button>
    </div>
    <p role="status" class=${message?.good ? "wb-good" : "wb-bad"}>${message && (message.good ? `✓ ${t("workbench.model.saved", message)}` : html`✕ <${Said} text=${message.text} />`)}
      ${message?.undeliverable === "" && html`<br /><a href="/files?kind=plans">${t("workbench.model.plan")}</a>`}</p>
    ${message?.undeliverable && html`<p class="wb-warn" role="status">${t("workbench.model.undeliverable")} <${Said} text=${message.undeliverable} whole /></p>`}
  </form>`;
}

/** The analysis so far as a notebook, as a file. */
function Notebook({ runs, steps, model }) {
  const [failed, setFailed] = useState("");
  const make = async () => {
    setFailed("");
    try {
      const made = await api.post("/notebooks", { ...runs, models: steps.slice(-MOST_MODELS).map((step) => step.model) });
      offer(`${fileName(`${runs.runs[0]} ${model.name}`)}.ipynb`, new Blob([JSON.stringify(made, null, 1)], { type: "application/x-ipynb+json" }));
    } catch (error) {
      setFailed(error.message);
    }
  };
  return html`<p><button type="button" class="narrow" onClick=${make}>${t("workbench.notebook")}</button> <span class="wb-soft">${t("workbench.notebook_hint")}</span></p>
    <p class="wb-bad" role="status"><${Said} text=${failed} /></p>`;
}

/** Nonlinear parameters of one effect of the fit. */
function Found({ fitted, effect }) {
  const word = effect === "expression" ? String : parameterWord; // names that people chose
  const own = (fitted?.parameters ?? []).filter(({ key }) => key.split(".")[0].replace(/_\d+$/, "") === effect);
  return own.map((one) => html`<span key=${one.key} class="wb-parameter"><span title=${one.key.split(".")[1]}>${word(one.key.split(".")[1])}</span> ${measured(one)}${
    one.at_bound ? html` <span class="wb-warn">${t("workbench.suspect.at_bound")}</span>` : null}</span>`);
}

/** `models` of the library {known, again}; `steps` are the models so far, the last one is the current one; `fitted` are its scores; `act` changes it. */
export function ModelPanel({ models, model, fitted, steps, busy, act, runs }) {
  const options = useOptions();
  const choose = (event) => {
    const known = models.known.find((one) => one.name === event.target.value);
    if (known) act({ type: "model", model: known.model });
  };
  return html`<section class="wb-card wb-model" aria-labelledby="wb-model-title">
    <div class="wb-card-head"><h2 id="wb-model-title">${t("workbench.model.title")}</h2>
      <label class="wb-inline">${t("workbench.model.begin")}
        <select value=${steps[0].model.name} onChange=${choose}>
          ${models.known.every((one) => one.name !== steps[0].model.name) && html`<option value=${steps[0].model.name}>${steps[0].model.name}</option>`}
          ${models.known.map((one) => html`<option key=${one.name} value=${one.name} selected=${one.name === steps[0].model.name}>${one.name}</option>`)}
        </select></label></div>
    <ol class="wb-effects">${model.effects.map((effect, i) => html`<li key=${`${i} ${effect.effect}`}>
      <span>${effectWord(effect.effect)} <code>${effect.effect}</code>
        ${Object.entries({ ...options[effect.effect], ...effect }).filter(([name]) => name !== "effect").map(([name, value]) => html`<${Option} key=${name}
          of=${effect.effect} name=${name} value=${value} busy=${busy} change=${(next) => act({ type: "edit", index: i, option: name, value: next })} />`)} <${Found} fitted=${fitted} effect=${effect.effect} /></span>
      ${model.effects.length > 1 && html`<button type="button" class="wb-x" disabled=${busy} aria-label=${t("workbench.model.remove", { effect: effectWord(effect.effect) })}
        onClick=${() => act({ type: "remove", index: i })}>×</button>`}
    </li>`)}</ol>
    <${OwnTerm} busy=${busy} runs=${[...runs.runs, ...runs.check]} onAdd=${(effect) => act({ type: "add", effects: [effect] })} />
    <${Save} model=${model} runs=${runs.runs} onSaved=${models.again} />
    <${Notebook} runs=${runs} steps=${steps} model=${model} />
  </section>`;
}
