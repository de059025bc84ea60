// State of the workbench: the runs with their roles, the models in order, what is shown. All of it is in the address, so
// that a link, a reload, back and forward show the same.
import { effectWord, or } from "../../lib/words.js";
import { START_MODEL } from "./first.js";
import { written } from "../../lib/typed.js";

export const ROLES = ["fit", "check", "static", "sister"];

/** What a step is called by: a term of one's own by its formula, there may be several. */
const termOf = ({ effect, formula }) => formula ?? { effect };

/** Effects of one model that the other one does not have. */
const own = ({ effects }, other) => effects.filter((effect) => !other.effects.some((one) => same(one, effect)));

/** What a step changed of the model `before` it; the name of the first one. */
export function labelOf(model, before) {
  if (!before) return [model.name];
  const [fresh, gone] = [own(model, before), own(before, model)];
  const edited = fresh.flatMap((effect) => {
    const at = gone.findIndex((old) => old.effect === effect.effect);
    return at < 0 ? [] : [[effect, ...gone.splice(at, 1)]];
  });
  const come = fresh.filter((effect) => !edited.some(([one]) => one === effect));
  const changes = ([effect, old]) => Object.entries(effect).filter(([name, value]) => !same(value, old[name])).flatMap(([option, value]) => [{ option }, written(value)]);
  // Options that the data chose again beside what came or went are not what the step is about.
  const label = come.length || gone.length ? [...come.flatMap((one) => ["+", termOf(one)]), ...gone.flatMap((one) => ["−", termOf(one)])] : edited.flatMap((pair) => [termOf(pair[1]), ...changes(pair)]);
  return label.length ? label : [model.name];
}

/** The label of a step in the language in use. */
export const labelWord = (label) =>
  label.map((part) => (part.effect ? effectWord(part.effect) : part.option ? or(`workbench.option.${part.option}`, part.option) : part)).join(" ");

/** The state after an action. */
export function change(state, action) {
  const { chosen, steps, at } = state;
  const model = steps[at].model;
  const grown = (next) => ({ ...state, steps: [...steps.slice(0, at + 1), { model: next }], at: at + 1, picture: "", wrong: null });
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
      return { ...state, steps: [{ model: action.model }], at: 0, picture: "", wrong: null };
    case "settle":
      return { ...state, steps: steps.map((step, i) => (i === at ? { model: action.model } : step)) };
    case "edit":
      return grown({ ...model, effects: model.effects.map((one, i) => (i === action.index ? { ...one, [action.option]: action.value } : one)) });
    case "add":
      return grown(action.model ?? { ...model, name: [model.name, ...action.effects.map(({ effect }) => effect)].join(" + "), effects: [...model.effects, ...action.effects] });
    case "remove": {
      const left = model.effects.filter((_, i) => i !== action.index);
      const gone = model.effects[action.index];
      return left.length ? grown({ ...model, name: `${model.name} − ${gone.effect}`, effects: left }) : state;
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

/** Steps in an address, the newest: as many as the ladder shows. */
export const MOST_STEPS = 7;

/** A model of an address, null where it cannot be read. */
function modelIn(text) {
  try {
    const model = JSON.parse(text);
    const { name, effects } = model;
    return typeof name === "string" && effects.length && effects.every(({ effect }) => typeof effect === "string") ? model : null;
  } catch {
    return null;
  }
}

/** State of an address; `kept` {steps, at, wrong} also has what is not in it: steps that were undone. `wrong`: what it has in place of a model, as a name that somebody typed. */
export function stateOf(text, kept = null) {
  const search = new URLSearchParams(text);
  const given = search.getAll("model");
  const wrong = given.find((one) => !modelIn(one)) ?? null;
  const steps = (wrong !== null || !given.length ? [START_MODEL] : given.map(modelIn)).map((model) => ({ model }));
  return {
    chosen: ROLES.flatMap((role) => search.getAll(PARAMETERS[role]).map((run) => ({ run, role }))),
    ...Object.fromEntries(Object.entries(VIEW).map(([key, value]) => [key, search.get(key) ?? value])),
    wrong: null,
    ...(kept ?? { steps, at: steps.length - 1, wrong }),
  };
}

/** Address of a state, without its page: runs, the models up to the one in use unless it is the first one, what is shown unless it is the default. */
export function addressOf({ chosen, steps, at, ...view }) {
  const search = new URLSearchParams(chosen.map(({ run, role }) => [PARAMETERS[role], run]));
  if (at || !same(steps[0].model, START_MODEL)) for (const { model } of steps.slice(0, at + 1).slice(-MOST_STEPS)) search.append("model", JSON.stringify(model));
  for (const [key, value] of Object.entries(VIEW)) if (view[key] !== value) search.set(key, view[key]);
  return search.size ? `?${search}` : "";
}
