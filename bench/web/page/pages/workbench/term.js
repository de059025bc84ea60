// A user-defined term: an expression, checked while it is typed, added like any other effect.
import { html, t, api, useEffect, useState } from "./parts.js";
import { numberOf } from "../../lib/typed.js";
import { Said } from "../../lib/said.js";

const PAUSE_MS = 250;

/** Answer of POST /effects/formula for the content of the field; null while it is empty or being checked. */
function useCheck(expression, bounds, runs) {
  const [answer, setAnswer] = useState(null);
  const request = JSON.stringify({ expression, bounds, runs });
  useEffect(() => {
    setAnswer(null);
    if (!expression.trim()) return undefined;
    let active = true;
    const timer = setTimeout(() => {
      api.post("/effects/formula", { expression, bounds, runs }).then(
        (found) => active && setAnswer(found),
        (error) => active && setAnswer({ ok: false, detail: error.message }),
      );
    }, PAUSE_MS);
    return () => { active = false; clearTimeout(timer); };
  }, [request]);
  return answer;
}

/** A pair of numbers for a parameter inside a function. */
function Bounds({ name, value, onChange }) {
  const set = (i) => (event) => onChange(name, value.map((old, k) => (k === i ? event.target.value : old)));
  return html`<fieldset class="wb-bounds"><legend>${t("workbench.term.bounds", { name })}</legend>
    <input inputmode="decimal" aria-label=${t("workbench.term.low", { name })} value=${value[0]} onInput=${set(0)} /> …
    <input inputmode="decimal" aria-label=${t("workbench.term.high", { name })} value=${value[1]} onInput=${set(1)} />
  </fieldset>`;
}

/** Bounds as they are typed, at first the server's. */
const textOf = (pair) => pair.map(String);

/** `runs` are the ids of those that it is fitted to; `onAdd(effect)` gets {effect: "expression", formula, bounds}. */
export function OwnTerm({ busy, runs, onAdd }) {
  const [expression, setExpression] = useState("");
  const [typed, setTyped] = useState({});
  // The server says which parameters need bounds, and some to begin with.
  const [needed, setNeeded] = useState({});
  const pairs = Object.entries(needed).map(([name, pair]) => [name, typed[name] ?? textOf(pair)]);
  const bounds = Object.fromEntries(pairs.map(([name, pair]) => [name, pair.map(numberOf)]).filter(([, pair]) => pair.every(Number.isFinite)));
  const answer = useCheck(expression, bounds, runs);
  useEffect(() => answer && setNeeded(answer.bounds ?? {}), [answer]);
  const wrong = answer && !answer.ok;
  const ready = answer?.ok && !busy && Object.keys(answer.bounds ?? {}).every((name) => name in bounds);
  // Who presses Enter before the check has answered means the text as it stands.
  const [meant, setMeant] = useState(false);
  useEffect(() => {
    if (!meant || !ready) return;
    onAdd({ effect: "expression", formula: expression.trim(), ...(Object.keys(bounds).length ? { bounds } : {}) });
    setMeant(false);
    setExpression("");
    setNeeded({});
  }, [meant, ready]);
  const add = (event) => {
    event.preventDefault();
    setMeant(true);
  };
  return html`<form class="wb-term" onSubmit=${add}>
    <label for="wb-term">${t("workbench.term.title")}</label>
    <div class="wb-field">
      <input id="wb-term" class="wb-code" type="text" value=${expression} spellcheck=${false} autocomplete="off" autocapitalize="off" placeholder="k * dT_dt * quadrature"
        aria-invalid=${wrong ? "true" : "false"} aria-describedby="wb-term-check" onInput=${(event) => {
          setMeant(false);
          setExpression(event.target.value);
        }} />
      <button type="submit" class="narrow" disabled=${busy || !expression.trim() || wrong}>${t("workbench.suspect.add")}</button>
    </div>
    ${pairs.map(([name, pair]) => html`<${Bounds} key=${name} name=${name} value=${pair}
      onChange=${(which, ends) => setTyped((old) => ({ ...old, [which]: ends }))} />`)}
    <p id="wb-term-check" class=${wrong ? "wb-bad" : "wb-soft"} role="status">
      ${!answer ? t("workbench.term.hint") : wrong ? html`✕ <${Said} text=${answer.detail} />` : `✓ ${t("workbench.term.good", { parameters: answer.parameters.join(", ") || "–" })}`}</p>
  </form>`;
}
