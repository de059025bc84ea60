// What a run has achieved for its unit, and what to do next.

const STEPS = ["calibrated", "flashed", "verified", "certified"];

/** Whether another run may be better: this one was not complete, or samples are missing. `run`: answer of GET /runs/… */
const spoiled = ({ segments, losses }) =>
  segments.some(({ settled, outcome }) => settled === false || outcome === "timeout") || Object.entries(losses).some(([kind, count]) => kind !== "received" && count > 0);

/** Steps on the way to the certificate that are done, and those that are missing. */
export const achieved = ({ steps }) => ({ done: STEPS.filter((step) => steps[step]), missing: STEPS.filter((step) => !steps[step]) });

/** Whether the next step, by its key, is the same run again; and whether nothing may start before an engineer came. */
export const repeats = (step) => /\.(aborted|invalid|no_data|not_started|partial)\.next$/.test(step);
export const stands = (step) => /\.equipment_failed\./.test(step);

/** Key of the words on what to do next: a unit goes on when its last step is done; a run is repeated where that can help. */
export function advice(word, run) {
  if (word === "invalid" && run) return spoiled(run) ? "verdict.invalid.next" : "verdict.invalid.next_plan";
  if (word === "pass" && run && !achieved(run).missing.length) return "verdict.pass.next_done";
  return `verdict.${word}.next`;
}
