// One word for the end of a run for a unit: equipment and operator first, then the limits, then the analysis.

import { or } from "../../lib/words.js";

/** Worst first; the tone of each, on every page. */
const WORDS = {
  equipment_failed: "bad", not_started: "warn", fail: "bad", invalid: "warn", aborted: "idle", partial: "bad", no_data: "bad",
  not_analysed: "warn", unproven: "warn", marginal: "warn", model_error: "warn", unknown_effect: "warn", missing_effect: "warn",
  undecided: "warn",
  analysing: "link", measured: "link", adequate: "good", pass: "good",
};

/** The analysis' word as a result; null where, without limits, nothing was to be decided. */
export const analysed = (verdict, limits) => (verdict === "undecided" && !limits ? null : verdict);

/** Key of the verdict on a unit: `end` is that of the run, `unit` its {verdict, limits, analysed}. */
export function judged(end, unit) {
  if (end.state === "failed") return end.cause?.startsWith("not started") ? "not_started" : "equipment_failed";
  if (end.state === "aborted") return "aborted";
  if (unit.limits?.toLowerCase() in WORDS) return unit.limits.toLowerCase();
  if (!unit.analysed && !end.analysing) return "not_analysed";
  const word = analysed(unit.verdict, unit.limits);
  if (word in WORDS) return word;
  return end.analysing ? "analysing" : "measured";
}

/** What is left of a value to the nearest of its limits, negative outside; null without a value or a limit. */
export function margin({ value, lower, upper }) {
  const left = [upper === null ? null : upper - value, lower === null ? null : value - lower].filter((one) => one !== null);
  return value === null || !left.length ? null : Math.min(...left);
}

export const toneOf = (word) => WORDS[word?.toLowerCase()] ?? "idle";

/** An outcome (PASS, missing_effect) in a few words. */
export const outcomeWord = (word) => or(`units.word.${word?.toLowerCase()}`, word);

/** Several words, each once, the worst first. */
export const worstFirst = (words) => Object.keys(WORDS).filter((word) => words.includes(word));
