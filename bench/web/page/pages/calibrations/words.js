// State of a calibration and of its steps in words and tones.
import { or, t } from "../../lib/words.js";

const TONES = { waiting: "idle", running: "link", interrupted: "bad", held: "warn", failed: "bad" };
const VERDICTS = { PASS: "good", MARGINAL: "warn", FAIL: "bad", INVALID: "warn" };
const STEPS = { open: "idle", begun: "link", done: "good", skipped: "idle", failed: "bad", void: "idle" };

export const planOf = (plan) => or(`calibration.${plan}`, plan.replaceAll("_", " "));
export const verdictTone = (verdict) => VERDICTS[verdict] ?? "idle";
export const toneOf = ({ state, verdict }) => (state === "ended" ? verdictTone(verdict) : TONES[state]);
export const stateWord = ({ state, verdict }) => (state === "ended" ? or(`verdict.${verdict?.toLowerCase()}`, verdict) : t(`job.state.${state}`));

/** Whether the plan had no such step: it was passed over. */
export const passedOver = (step) => step.cases.some(({ name, skipped }) => skipped && name === step.name);

/** Tone of a step: that of its verdict, else of its state; a step that was begun does not go on where nobody works on it. */
export function stepTone(step, job) {
  if (step.state === "done") return passedOver(step) ? "idle" : step.verdict ? verdictTone(step.verdict) : "good";
  return step.state === "begun" && job.state !== "running" ? "bad" : STEPS[step.state];
}

export function stepWord(step, job) {
  if (step.state === "done" && passedOver(step)) return t("step.skipped");
  return t(step.state === "begun" && job.state !== "running" ? "job.state.interrupted" : `step.${step.state}`);
}
