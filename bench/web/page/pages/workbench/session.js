// The workbench's state in the address of the page, and the results that belong to it.
import { api, unitOf, useEffect, useMemo, useRef, useState } from "./parts.js";
import { here, navigate } from "../../lib/router.js";
import { useStore } from "../../lib/store.js";
import { addressOf, change, stateOf } from "./state.js";

const NEAR_MS = 7 * 24 * 3600 * 1000;
const MOST_CACHED = 60;

const isStatic = (row) => /isothermal|static/i.test(row.profile);
const isCheck = (row) => /^check|_check|verif/i.test(row.profile);

/** Most likely role of a run of this profile beside those already chosen. */
export function likelyRole(row, chosen) {
  if (!chosen.length) return "fit";
  if (isStatic(row) && !chosen.some((one) => unitOf(one.run) === row.unit)) return "sister";
  if (isStatic(row) && !chosen.some((one) => one.role === "static")) return "static";
  return "check";
}

/** Runs of `rows` that belong to `row`: one check run and one isothermal run of the same days. */
export function companions(row, rows) {
  const near = rows.filter((one) => one.run !== row.run && one.unit === row.unit && !one.corrected
    && Math.abs(Date.parse(one.start) - Date.parse(row.start)) < NEAR_MS);
  const check = isCheck(row) ? undefined : near.find((one) => isCheck(one));
  const still = isStatic(row) ? undefined : near.find((one) => isStatic(one));
  return [check && { ...check, role: "check" }, still && { ...still, role: "static" }].filter(Boolean);
}

/** Actions that do not make an entry of the history. */
const SILENT = ["settle", "zoom", "output"];

const read = () => stateOf(location.search, history.state);

function act(action) {
  const next = change(read(), action);
  navigate(location.pathname + addressOf(next), { replace: action.silent || SILENT.includes(action.type), state: { steps: next.steps, at: next.at, wrong: next.wrong } });
}

/** State of the address and `act(action)`, which changes it; `runs` {runs, check, static, sisters} in the form of the API, null while nothing can be fitted. */
export function useSession() {
  const place = useStore(here);
  return useMemo(() => {
    const state = read();
    const of = (role) => state.chosen.filter((one) => one.role === role).map((one) => one.run);
    const runs = of("fit").length ? { runs: of("fit"), check: of("check"), static: of("static")[0] ?? null, sisters: of("sister"), output: state.output || null } : null;
    const model = state.steps[state.at].model;
    const before = state.steps[state.at - 1]?.model ?? null;
    return { ...state, address: addressOf(state), steps: state.steps.slice(0, state.at + 1), undone: state.steps.length - state.at - 1, runs, act, model, before };
  }, [place]);
}

const answers = new Map();

/** Cached result of a job, or undefined. */
export const known = (path, body) => answers.get(`${path} ${JSON.stringify(body)}`);

/** Compute what is not known yet, and keep it. */
export async function ask(path, body, options = {}) {
  const key = `${path} ${JSON.stringify(body)}`;
  if (answers.has(key)) return answers.get(key);
  const result = await api.compute(path, body, options);
  answers.set(key, result);
  if (answers.size > MOST_CACHED) answers.delete(answers.keys().next().value);
  return result;
}

/**
 * Answer of a job: {result, failed, running, stopped}. While the next one is computed, `stale` is the one before.
 * `stop()` gives it up, `again()` asks again.
 */
export function useJob(path, body) {
  const key = body ? `${path} ${JSON.stringify(body)}` : null;
  const [state, setState] = useState({ key: null, result: null, failed: "" });
  const [halted, setHalted] = useState("");
  const going = useRef(null);
  useEffect(() => {
    if (!key || answers.has(key) || halted === key) return undefined;
    let active = true;
    const leaving = going.current = new AbortController();
    ask(path, body, { signal: leaving.signal }).then(
      (result) => active && setState({ key, result, failed: "" }),
      (error) => active && !leaving.signal.aborted && setState((before) => ({ ...before, key, failed: error.message || String(error) })),
    );
    return () => { active = false; };
  }, [key, halted]);
  const stop = () => {
    setHalted(key);
    going.current.abort();
  };
  const result = key ? answers.get(key) ?? null : null;
  const failed = !result && state.key === key ? state.failed : "";
  const stopped = Boolean(key) && !result && halted === key;
  return { result, failed, stopped, running: Boolean(key) && !result && !failed && !stopped, stale: result ?? state.result, stop, again: () => setHalted("") };
}
