// State of the workbench: the runs with their roles, the models in order, what is shown. All of it is in the address, so
// that a link, a reload, back and forward show the same.
import { effectWord, or } from "../../lib/words.js";
import { START_MODEL } from "./first.js";
import { written } from "../../lib/typed.js";

export const ROLES = ["fit", "check", "static", "sister"];

/** What a step is called by: a term of one's own by its formula, there may be several. */
const termOf = ({ effect, formula }) => formula ?? { effect };

/** The label of a step in the language in use. */
export const labelWord = (label) =>
  [label].flat().map((part) => (part.effect ? effectWord(part.effect) : part.option ? or(`workbench.option.${part.option}`, part.option) : part)).join(" ");

/** The state after an action. */
export function change(state, action) {
  const { chosen, steps, at } = state;
  const model = steps[at].model;
  const grown = (next, name) => ({ ...state, steps: [...steps.slice(0, at + 1), { model: next, label: name }], at: at + 1, picture: "" });
  switch (action.type) {
    case "choose":
      return { ...state, chosen: action.runs, steps: steps.slice(0, 1), at: 0, of: "", zoom: "", picture: "", compare: "", output: "" };
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
      return { ...state, steps: [{ model: action.model, label: action.model.name }], at: 0, picture: "" };
    case "settle":
      return { ...state, steps: steps.map((step, i) => (i === at ? { ...step, model: action.model } : step)) };
    case "edit":
      return grown({ ...model, effects: model.effects.map((one, i) => (i === action.index ? { ...one, [action.option]: action.value } : one)) },
        [termOf(model.effects[action.index]), { option: action.option }, written(action.value)]);
    case "add":
      return grown(action.model ?? { ...model, name: [model.name, ...action.effects.map(({ effect }) => effect)].join(" + "), effects: [...model.effects, ...action.effects] },
        action.effects.flatMap((one) => ["+", termOf(one)]));
    case "remove": {
      const left = model.effects.filter((_, i) => i !== action.index);
      const gone = model.effects[action.index];
      return left.length ? grown({ ...model, name: `${model.name} − ${gone.effect}`, effects: left }, ["−", termOf(gone)]) : state;
    }
    case "undo":
      return { ...state, at: Math.max(0, at - 1), picture: "" };
    case "redo":
      return { ...state, at: Math.min(steps.length - 1, at + 1), picture: "" };
    case "view": {
      // A time is one of the run that was drawn; a temperature holds in every run.
      const zoom = "of" in action.view && state.zoom.startsWith("h:") ? "" : state.zoom;
      return { ...state, picture: "", zoom, ...action.view };
    }
    case "output":
      return { ...state, output: action.output, picture: "" };
    case "zoom":
      return { ...state, zoom: action.zoom };
    default:
      return state;
  }
}

/** Parameters of the address by role of a run. */
const PARAMETERS = { fit: "run", check: "check", static: "static", sister: "sister" };
/** What is shown, by parameter of the address, and its default: figure, its run, its abscissa, residual in the loop, picture of a suspect, selected range of time or temperature, run to compare with, which of several outputs. */
const VIEW = { output: "", figure: "time", of: "", over: "temperature", left: "", picture: "", zoom: "", compare: "" };
/** Whether two models are the same. */
export const same = (one, other) => JSON.stringify(one) === JSON.stringify(other);

/** The model of an address: the first one where it names none, null where it cannot be read. */
function modelIn(text) {
  if (text === null) return START_MODEL;
  try {
    const model = JSON.parse(text);
    const { name, effects } = model;
    return typeof name === "string" && effects.length && effects.every(({ effect }) => typeof effect === "string") ? model : null;
  } catch {
    return null;
  }
}

/** State of an address; `kept` {steps, at} are the models before and after its own. `wrong`: its model cannot be read. */
export function stateOf(text, kept = null) {
  const search = new URLSearchParams(text);
  const model = modelIn(search.get("model"));
  const begin = model ?? START_MODEL;
  return {
    chosen: ROLES.flatMap((role) => search.getAll(PARAMETERS[role]).map((run) => ({ run, role }))),
    ...(kept ?? { steps: [{ model: begin, label: begin.name }], at: 0 }),
    ...Object.fromEntries(Object.entries(VIEW).map(([key, value]) => [key, search.get(key) ?? value])),
    wrong: !model,
  };
}

/** Address of a state, without its page: runs, the model unless it is the first one, what is shown unless it is the default. */
export function addressOf({ chosen, steps, at, ...view }) {
  const search = new URLSearchParams(chosen.map(({ run, role }) => [PARAMETERS[role], run]));
  if (!same(steps[at].model, START_MODEL)) search.set("model", JSON.stringify(steps[at].model));
  for (const [key, value] of Object.entries(VIEW)) if (view[key] !== value) search.set(key, view[key]);
  return search.size ? `?${search}` : "";
}
