// What happened between two states of the live runs that somebody away from the screen should hear of.

const trouble = (run) => (["gone", "silent"].includes(run.condition) ? run.condition : run.state === "holding" ? "holding" : "");

/** Runs that ended, began to hold, or were lost since `before`: [{run, what}]; one that was not seen before is no news. */
export function news(before, now) {
  const known = new Map(before.runs.map((run) => [run.run, run]));
  const ended = Object.keys(now.ended).filter((run) => !before.ended[run] && known.has(run)).map((run) => ({ run, what: "ended" }));
  const changed = now.runs.filter((run) => trouble(run) && known.has(run.run) && trouble(known.get(run.run)) !== trouble(run));
  return [...ended, ...changed.map((run) => ({ run: run.run, what: trouble(run) }))];
}
