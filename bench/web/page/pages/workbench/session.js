// State of the workbench: the runs with their roles, the models in order, and their results.
import { api, useEffect, useMemo, useReducer, useState } from "./parts.js";
import { effectWord } from "./effects.js";
import { START_MODEL } from "./first.js";

export const ROLES = ["fit", "check", "static"];
const NEAR_MS = 7 * 24 * 3600 * 1000;
const MOST_CACHED = 60;

const isStatic = (row) => /isothermal|static/i.test(row.profile);
const isCheck = (row) => /^check|_check|verif/i.test(row.profile);

/** Most likely role of a run of this profile beside those already chosen. */
export function likelyRole(row, chosen) {
  if (!chosen.length) return "fit";
  if (isStatic(row) && !chosen.some((one) => one.role === "static")) return "static";
  return "check";
}

/** Runs of `rows` that belong to `row`: one check run and one isothermal run of the same days. */
export function companions(row, rows) {
  const near = rows.filter((one) => one.run !== row.run && one.unit === row.unit
    && Math.abs(Date.parse(one.start) - Date.parse(row.start)) < NEAR_MS);
  const check = isCheck(row) ? undefined : near.find((one) => isCheck(one));
  const still = isStatic(row) ? undefined : near.find((one) => isStatic(one));
  return [check && { ...check, role: "check" }, still && { ...still, role: "static" }].filter(Boolean);
}

const label = (effect) => `+ ${effectWord(effect.effect)}`;

function change(state, action) {
  const { chosen, steps } = state;
  const model = steps[steps.length - 1].model;
  const grown = (next, name) => ({ ...state, steps: [...steps, { model: next, label: name }] });
  switch (action.type) {
    case "choose":
      return { chosen: action.runs, steps: [steps[0]] };
    case "take":
      return { ...state, chosen: [...chosen.filter((one) => one.run !== action.run.run), action.run] };
    case "drop":
      return { ...state, chosen: chosen.filter((one) => one.run !== action.run) };
    case "role":
      return { ...state, chosen: chosen.map((one) => {
        if (one.run === action.run) return { ...one, role: action.role };
        return action.role === "static" && one.role === "static" ? { ...one, role: "check" } : one;
      }) };
    case "model":
      return { ...state, steps: [{ model: action.model, label: action.model.name }] };
    case "settle":
      return { ...state, steps: [...steps.slice(0, -1), { ...steps[steps.length - 1], model: action.model }] };
    case "edit":
      return grown({ ...model, effects: model.effects.map((one, i) => (i === action.index ? { ...one, [action.option]: action.value } : one)) },
        `${effectWord(model.effects[action.index].effect)} ${action.option} ${action.value}`);
    case "add":
      return grown({ ...model, name: `${model.name} + ${action.effect.effect}`, effects: [...model.effects, action.effect] }, label(action.effect));
    case "remove": {
      const left = model.effects.filter((_, i) => i !== action.index);
      const gone = model.effects[action.index];
      return left.length ? grown({ ...model, name: `${model.name} − ${gone.effect}`, effects: left }, `− ${effectWord(gone.effect)}`) : state;
    }
    case "undo":
      return steps.length > 1 ? { ...state, steps: steps.slice(0, -1) } : state;
    default:
      return state;
  }
}

/** State and `act(action)`; `runs` {runs, check, static} in the form of the API, null while nothing can be fitted. */
export function useSession() {
  const [state, act] = useReducer(change, { chosen: [], steps: [{ model: START_MODEL, label: START_MODEL.name }] });
  const runs = useMemo(() => {
    const of = (role) => state.chosen.filter((one) => one.role === role).map((one) => one.run);
    return of("fit").length ? { runs: of("fit"), check: of("check"), static: of("static")[0] ?? null } : null;
  }, [state.chosen]);
  return { ...state, runs, act, model: state.steps[state.steps.length - 1].model };
}

const answers = new Map();

/** Cached result of a job, or undefined. */
export const known = (path, body) => answers.get(`${path} ${JSON.stringify(body)}`);

/** Answer of a job: {result, failed, running}. While the next one is computed, `stale` is the one before. */
export function useJob(path, body) {
  const key = body ? `${path} ${JSON.stringify(body)}` : null;
  const [state, setState] = useState({ key: null, result: null, failed: "" });
  useEffect(() => {
    if (!key || answers.has(key)) return undefined;
    let active = true;
    api.compute(path, body).then(
      (result) => {
        answers.set(key, result);
        if (answers.size > MOST_CACHED) answers.delete(answers.keys().next().value);
        if (active) setState({ key, result, failed: "" });
      },
      (error) => active && setState({ key, result: null, failed: error.message || String(error) }),
    );
    return () => { active = false; };
  }, [key]);
  const result = key ? answers.get(key) ?? null : null;
  const failed = !result && state.key === key ? state.failed : "";
  return { result, failed, running: Boolean(key) && !result && !failed, stale: result ?? state.result };
}
