// Calibrations: what waits, what goes on, what is done; or one of them in full.
import { html, useState } from "../lib/preact.js";
import { post, remove, url } from "../lib/api.js";
import { useLook } from "../lib/look.js";
import { Busy, Lamp, Trouble } from "../lib/parts.js";
import { Said } from "../lib/said.js";
import { may } from "../lib/store.js";
import { serialOf } from "../lib/units.js";
import { moment, t } from "../lib/words.js";
import { CalibrationView } from "./calibrations/view.js";

import { planTitle, stationName } from "../lib/names.js";
import { planOf, stateWord, toneOf } from "./calibrations/words.js";

const LOOK_MS = 2000;

export default function Calibrations({ params }) {
  if (params.rest) return html`<${CalibrationView} key=${params.rest} id=${params.rest} />`;
  return html`<${List} />`;
}

function List() {
  const [round, setRound] = useState(0);
  const [problem, setProblem] = useState(null);
  const { data: listed, error: unheard } = useLook("/calibrations", LOOK_MS, round);
  const error = unheard ?? problem;
  if (!listed) return html`<div class="page">${error ? html`<${Trouble} error=${error} />` : html`<${Busy} />`}</div>`;
  const change = (asked) => asked.then(() => setProblem(null), setProblem).then(() => setRound(round + 1));
  const units = (start) => start.units.map(serialOf).join(", ") || start.station;
  const last = listed.waiting.length - 1;
  return html`<div class="page stack"><h1>${t("nav.calibrations")}</h1>
    <${Trouble} error=${error} />
    ${listed.waiting.length > 0 && html`<section aria-labelledby="queue"><h2 id="queue">${t("job.queue")}</h2>
      <ol class="queue">${listed.waiting.map((start, index) => html`<li key=${start.start} class="row spread"><span><b class="mono">${units(start)}</b> ${start.digest ? planOf(start.plan) : planTitle({ id: start.plan, title: start.plan })} <span class="soft">${stationName(start.station)} · ${start.who.name}${start.not_before && ` · ${t("job.not_before", { time: moment(start.not_before) })}`}</span>
        ${start.message && html`<span class="tone-warn small" role="status"><br /><${Said} text=${start.message} /></span>`}</span>
        ${may("operator") && html`<span class="row">${last > 0 && [["job.earlier", "↑", -1, 0], ["job.later", "↓", 1, last]].map(([key, sign, by, end]) => html`<button type="button" key=${key} class="narrow" disabled=${index === end}
            title=${t(key)} aria-label=${`${t(key)}: ${units(start)}`} onClick=${() => change(post(url`/starts/${start.start}/move`, { by }))}>${sign}</button>`)}
          <button type="button" class="narrow" onClick=${() => change(remove(url`/starts/${start.start}`))}>${t("job.give_up")}<span class="unseen"> ${units(start)}</span></button></span>`}</li>`)}</ol></section>`}
    ${listed.jobs.length > 0 ? html`<div class="scroll" tabindex="0" role="region" aria-label=${t("nav.calibrations")}><table class="job-list lines">
      <thead><tr>${["unit", "state", "plan", "begun", "certificate"].map((key) => html`<th key=${key} scope="col" class=${key === "plan" ? "whole" : undefined}>${t(`job.head.${key}`)}</th>`)}</tr></thead>
      <tbody>${listed.jobs.map((job) => html`<tr key=${job.job}><th scope="row"><a class="mono" href=${`/calibrations/${job.job}`}>${job.unit}</a></th><td><${Lamp} tone=${toneOf(job)}>${stateWord(job)}<//></td>
        <td class="whole">${planOf(job.plan)}</td><td>${moment(job.created)}</td><td class="mono">${job.certificate ?? "–"}</td></tr>`)}</tbody></table></div>`
      : html`<p class="soft">${t("job.none")}</p>`}
    ${may("operator") && html`<p><a class="button primary" href="/">${t("job.start_one")}</a></p>`}
  </div>`;
}
