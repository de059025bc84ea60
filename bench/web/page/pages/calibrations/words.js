// State of a calibration and of its steps in words and tones.
import { timesFloor } from "../../lib/floor.js";
import { duration, joined, number, or, sign, t } from "../../lib/words.js";
import { outcomeWord, toneOf as verdictTone } from "../verdict/judged.js";

const TONES = { waiting: "idle", running: "link", interrupted: "bad", held: "warn", failed: "bad" };
const STEPS = { open: "idle", begun: "link", done: "good", skipped: "idle", failed: "bad", void: "idle" };

export const planOf = (plan) => or(`calibration.${plan}`, plan.replaceAll("_", " "));
export const toneOf = ({ state, verdict }) => (state === "ended" ? verdictTone(verdict) : TONES[state]);
export const stateWord = ({ state, verdict }) => (state === "ended" ? outcomeWord(verdict) : t(`job.state.${state}`));

/** A sentence of a job, which names the step that it is about (`fit: the calibration run is FAIL`), as the page names it. */
export const ofStep = ({ sentence, steps }) =>
  sentence.replace(/^(\w+)(?=: )/, (name) => (steps.some((step) => step.name === name) ? t(`step.name.${name}`) : name));

/** The step that is at work. */
export const stepNow = ({ steps }) => steps.filter(({ state }) => state === "begun").map(({ name }) => t(`step.name.${name}`)).join(sign(", "));

/** Whether the plan had no such step: it was passed over. */
export const passedOver = (step) => step.cases.some(({ name, skipped }) => skipped && name === step.name);

/** How many warnings and doubts a step was done with. */
const warningsOf = ({ facts, warnings }) => warnings ?? (facts?.warnings?.length ?? 0) + (facts?.doubts?.length ?? 0);

/** Tone of a step: that of its verdict, else of its state; a step that was begun does not go on where nobody works on it. */
export function stepTone(step, job) {
  if (step.state === "done" && passedOver(step)) return "idle";
  if (step.state === "done") {
    const tone = step.verdict ? verdictTone(step.verdict) : "good";
    return tone === "good" && warningsOf(step) ? "warn" : tone;
  }
  return step.state === "begun" && job.state !== "running" ? "bad" : STEPS[step.state];
}

/** What became of a step: its verdict, else its state. */
export function stepWord(step, job) {
  if (step.state === "done" && passedOver(step)) return t("step.skipped");
  if (step.state === "done" && (step.verdict || warningsOf(step))) {
    return joined([step.verdict ? outcomeWord(step.verdict) : t("step.done"), ...(warningsOf(step) ? [t("ready.warnings", { n: warningsOf(step) })] : [])]);
  }
  return t(step.state === "begun" && job.state !== "running" ? "job.state.interrupted" : `step.${step.state}`);
}

const dph = (value) => `${number(value, 4)} ${t("unit.dph")}`;
const SAID = {
  check: ({ warnings }) => t("step.said.check", { n: warnings.length }),
  static: ({ duration_s }) => t("step.said.static", { time: duration(duration_s) }),
  run: ({ rows, duration_s, lost }) => t("step.said.run", { rows, time: duration(duration_s), lost }),
  fit: ({ findings, limits, model, held_out_rms_dph }) => (findings ? t("step.said.fit_imu", { findings: findings.length })
    : t("step.said.fit", { verdict: outcomeWord(limits), model, rms: dph(held_out_rms_dph) })),
  diagnose: ({ doubts }) => (doubts.length ? t("step.said.doubts", { doubts: joined(doubts.map(({ kind }) => or(`step.doubt.${kind}`, outcomeWord(kind)))) }) : t("step.said.diagnose")),
  flash: ({ calibration_id }) => t("step.said.flash", { id: calibration_id }),
  verify: ({ worst, rms_dph, over_floor }, verdict) => [
    worst ? t("step.said.verify_imu", { verdict, axis: worst }) : t("step.said.verify", { verdict, rms: dph(rms_dph) }),
    ...(over_floor === null ? [] : [timesFloor(over_floor, 1)]),
  ].join(sign(", ")),
  certificate: ({ number: own }, verdict) => `${own}${verdict && sign(": ") + verdict}`,
};

/** What a step found, made of its facts; empty where it is not done, or an older bench did it and kept fewer of them. */
export function said({ name, state, facts, verdict }) {
  if (state !== "done" || (["static", "run"].includes(name) && facts.duration_s === undefined)) return "";
  return SAID[name](facts, verdict ? outcomeWord(verdict) : "");
}
