// Live runs: one in full, several side by side; the end of a run leads to its verdict.
import { html, useEffect, useState } from "../lib/preact.js";
import { get, url } from "../lib/api.js";
import { traces, useLive } from "../lib/live.js";
import { useLook } from "../lib/look.js";
import { Busy, Trouble, Unknown } from "../lib/parts.js";
import { runName } from "../lib/names.js";
import { navigate } from "../lib/router.js";
import { may } from "../lib/store.js";
import { Trace } from "../lib/trace.js";
import { t } from "../lib/words.js";
import { planOf, stepNow } from "./calibrations/words.js";
import { Temperatures } from "./live/charts.js";
import { Headline, RunView, Segments } from "./live/run.js";

const LOOK_MS = 2000;
const isRun = (run, id) => run.run === id || run.runs?.includes(id);

export default function Live({ params }) {
  const now = useLive();
  const id = params.unit && `${params.unit}/${params.run}`;
  const run = id ? now.runs.find((one) => isRun(one, id)) : now.runs.length === 1 ? now.runs[0] : null;
  const [shown, setShown] = useState(id);
  useEffect(() => run && setShown(run.run), [run?.run]);
  const ended = Object.values(now.ended).find((end) => (id ? isRun(end, id) : end.run === shown));
  useEffect(() => {
    if (ended && !run) navigate(ended.job ? `/calibrations/${ended.job}` : `/verdict/${shown && !id ? shown : id}`, { replace: true });
  }, [ended?.run, !run]);
  if (run) return html`<${RunView} key=${run.run} run=${run} />`;
  if (id) return html`<${Missing} key=${id} id=${id} params=${params} />`;
  if (now.connected === null) return html`<div class="page"><${Busy} /></div>`;
  return now.runs.length ? html`<${Several} runs=${now.runs} />` : html`<${Nothing} />`;
}

/** Without a live run: the calibrations that are at work between two runs, or a way to begin one. */
function Nothing() {
  const { data, error } = useLook("/calibrations", LOOK_MS);
  const jobs = data?.jobs.filter(({ state }) => state === "running") ?? [];
  if (!data && !error) return html`<div class="page"><${Busy} /></div>`;
  if (jobs.length) return html`<div class="page stack"><h1>${t("live.between")}</h1><p class="soft">${t("live.between_text")}</p>
    <ul class="findings">${jobs.map((job) => html`<li key=${job.job}><${Busy}><a href=${`/calibrations/${job.job}`}><b class="mono">${job.unit}</b></a> <span>${[planOf(job.plan), stepNow(job)].filter(Boolean).join(" · ")}</span><//></li>`)}</ul></div>`;
  return html`<div class="page empty">
    <h1>${t("live.nothing")}</h1><p class="soft">${t("live.nothing_text")}</p>
    ${may("operator") && html`<a class="button primary" href="/">${t("live.start_one")}</a>`}
  </div>`;
}

/** The run is not in the stream: it has ended, is starting, or does not exist; the server reports which. */
function Missing({ id, params }) {
  const [error, setError] = useState(null);
  useEffect(() => {
    let timer = 0;
    const look = () => get(url`/live/${params.unit}/${params.run}`).then(
      (seen) => {
        if (seen.condition === "ended") navigate(seen.job ? `/calibrations/${seen.job}` : `/verdict/${id}`, { replace: true });
        else timer = setTimeout(look, 1000);
      },
      (problem) => {
        setError(problem);
        timer = setTimeout(look, 3000);
      },
    );
    look();
    return () => clearTimeout(timer);
  }, [id]);
  if (error?.status === 404) return html`<div class="page stack"><${Unknown} title=${id.split("/")[0]} what=${t("live.unknown", { run: runName(id) })} way="/live" words=${t("nav.live")} /></div>`;
  return html`<div class="page">${error ? html`<${Trouble} error=${error} />` : html`<${Busy}>${t("live.looking")}<//>`}</div>`;
}

const EMPTY = new Trace();

function Several({ runs }) {
  return html`<div class="page several"><h1>${t("nav.live_count", { n: runs.length })}</h1>
    <div class="several-runs">${runs.map((run) => html`<article key=${run.run} class="panel several-run">
      <${Headline} run=${run} link />
      <${Segments} run=${run} />
      <${Temperatures} run=${run} trace=${traces.get(run.run) ?? EMPTY} />
    </article>`)}</div>
  </div>`;
}
