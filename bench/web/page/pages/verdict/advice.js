// What helps after a run that does not allow to judge the unit.

/** Whether another run may be better: this one was not complete, or samples are missing. `run`: answer of GET /runs/… */
const spoiled = ({ segments, losses }) =>
  segments.some(({ settled, outcome }) => settled === false || outcome === "timeout") || Object.entries(losses).some(([kind, count]) => kind !== "received" && count > 0);

/** Key of the words: repeat a run that was spoiled; where plan or model are the reason, repeating cannot help. */
export const advice = (run) => (spoiled(run) ? "verdict.invalid.next" : "verdict.invalid.next_plan");
