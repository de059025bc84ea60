// What is special about starting a whole calibration: one that was begun before, work by hand, several units in a row.
import { html } from "../../lib/preact.js";
import { ApiError, get, post, url } from "../../lib/api.js";
import { serialOf } from "../../lib/units.js";
import { or, t } from "../../lib/words.js";

const LOOK_MS = 300;
const PATIENCE_MS = 120000;
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Begin the calibrations of all units together, those that have ended before, or all of them `anew`, as new ones; the address of the first, null where it waits. */
export async function beginAll({ calibration, station, units, anew }, begun, more) {
  const starts = [];
  const over = (unit) => (anew && unit in begun) || begun[unit]?.state === "ended";
  const groups = [units.filter((unit) => !over(unit)), units.filter(over)].filter((group) => group.length);
  for (const [index, [unit, ...others]] of groups.entries()) {
    starts.push(await post("/calibrations", { plan: calibration, station, unit, others, anew: over(unit), ...more, queue: more.queue || index > 0 }));
  }
  return starts[0].state === "waiting" ? null : address(starts[0].start);
}

/** Address of the calibration that a start began, when it has begun. */
export async function address(start) {
  const until = Date.now() + PATIENCE_MS;
  while (Date.now() < until) {
    const seen = await get(url`/starts/${start}/calibration`);
    if (seen) return `/calibrations/${seen.job}`;
    await pause(LOOK_MS);
  }
  throw new ApiError(504, t("ready.no_word"));
}

/** Calibrations of these units by this plan that were begun before; those that have not ended go on, or are begun `anew`. */
export function Begun({ begun = {}, anew, setAnew }) {
  const known = Object.entries(begun);
  const word = (state) => (state === "ended" ? "ready.again" : state === "running" ? "ready.at_work" : anew ? "ready.begins_anew" : "ready.goes_on");
  return html`${known.map(([unit, { job, state }]) => html`<div key=${unit} class="notice warn">
    <p>${t(word(state), { serial: serialOf(unit), state: or(`job.state.${state}`, state) })} <a href=${`/calibrations/${job}`}>${t("ready.show")}</a></p></div>`)}
  ${known.some(([, { state }]) => !["ended", "running"].includes(state)) && html`<label class="row"><input type="checkbox" checked=${anew} onChange=${(event) => setAnew(event.target.checked)} /> ${t("ready.anew")}</label>`}`;
}

/** What people have to do on the way, and where the laboratory's facts are filled in; at once where the check `failed`. */
export function ByHand({ plan, station, failed }) {
  const turned = plan.attitudes > 0 && station.fixture === "asked";
  const papers = `/laboratory?station=${encodeURIComponent(station.id)}`;
  if (failed) return html`<p><a class="button" href=${papers}>${t("papers.title")}</a></p>`;
  return html`<ul class="by-hand small soft">
    <li>${turned ? t("ready.by_hand", { n: plan.attitudes }) : t("ready.nothing_by_hand")}</li>
    ${plan.certificate && html`<li><a href=${papers}>${t("papers.title")}</a>: ${t("ready.papers")}</li>`}
  </ul>`;
}
