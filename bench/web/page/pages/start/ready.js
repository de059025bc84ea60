// Confirmation: findings of the check, what will happen, and START.
import { html, useEffect, useRef, useState } from "../../lib/preact.js";
import { Curve, range } from "../../lib/curve.js";
import { Busy, Lamp, Shape, Trouble } from "../../lib/parts.js";
import { useLive } from "../../lib/live.js";
import { navigate } from "../../lib/router.js";
import { startRun } from "../../lib/starts.js";
import { remembered } from "../../lib/store.js";
import { serialOf } from "../../lib/units.js";
import { between, degrees, forecast, inOneLine, language, number, t } from "../../lib/words.js";
import { Begun, ByHand, beginAll } from "./calibration.js";
import { useCheck } from "./check.js";
import { OperatorField, operatorOf } from "./operator.js";
import { limitsName, ofPlans, planTitle } from "../../lib/names.js";
import { Said } from "../../lib/said.js";

const TONES = { error: "bad", warning: "warn", info: "idle" };

const MINUTE_MS = 60_000;

/** Limits that were chosen for each plan in this browser. */
const lastLimits = remembered("limits_of", {});

export function Ready({ order, answer, plan, plans, station, limits, begun }) {
  const calibrating = Boolean(plan.calibration);
  const [starting, setStarting] = useState(false);
  const [refused, setRefused] = useState(null);
  const [within, setWithin] = useState(() => {
    const chosen = order.limits ?? lastLimits.get()[plan.id] ?? plan.limits;
    return limits.some(({ id }) => id === chosen) ? chosen : "";
  });
  const models = order.models ?? plan.models;
  const { result, error, again } = useCheck({ ...order, limits: within, models });
  const [later, setLater] = useState("");
  const start = async (queue = false) => {
    setStarting(true);
    setRefused(null);
    try {
      const more = { ...operatorOf(), queue, ...(later ? { not_before: new Date(later).toISOString() } : {}) };
      if (!calibrating) lastLimits.set((now) => ({ ...now, [plan.id]: within }));
      const way = calibrating ? await beginAll(order, result.begun, more)
        : await startRun("/starts", { plan: order.plan, station: order.station, units: order.units, ...more, models, ...(within ? { limits: within } : {}) }).then((run) => run && `/live/${run}`);
      begun();
      navigate(way ?? "/calibrations", { replace: true }); // Back must not lead to START again
    } catch (problem) {
      setRefused(problem);
      setStarting(false);
    }
  };
  const passed = later !== "" && new Date(later).getTime() < Date.now() - MINUTE_MS;
  const ready = result?.ok && !starting && !passed;
  return html`<div class="ready">
    <div class="ready-plan panel">
      <${Facts} plan=${plan} result=${result} station=${station} units=${order.units} />
      <${Curve} curve=${result?.curve ?? plan.curve} width=${760} height=${300} axes />
    </div>
    <div class="ready-go">
      <${Checked} result=${result} plans=${plans} error=${error} again=${again} units=${order.units.map(serialOf)} />
      ${calibrating && html`<${ByHand} plan=${plan} station=${station} failed=${result && !result.ok} />`}
      ${!calibrating && limits.length > 0 && html`<div class="field"><label for="limits">${t("ready.limits")}</label>
        <select id="limits" value=${within} onChange=${(event) => setWithin(event.target.value)}>
          <option value="">${t("ready.no_limits")}</option>
          ${limits.map((one) => html`<option key=${one.id} value=${one.id}>${limitsName(one.id, one.title ?? one.id)}</option>`)}
        </select>
        ${models.length > 0 && html`<p class="soft small">${t("ready.models", { models: models.join(", ") })}</p>`}</div>`}
      <${OperatorField} />
      <${Trouble} error=${refused} forget=${() => setRefused(null)} />
      ${refused?.status === 409 && html`<p><button type="button" onClick=${() => start(true)}>${t("ready.queue")}</button></p>`}
      ${calibrating && html`<${Begun} begun=${result?.begun} anew=${order.anew} setAnew=${(anew) => answer({ anew })} />`}
      <${StartButton} ready=${ready} starting=${starting} later=${later} wrong=${result?.ok === false} warnings=${result ? findingsOf(result, plans).serious.length : 0} start=${() => start()} />
      <div class="field"><label for="later">${t("ready.later")}</label>
        <input id="later" type="datetime-local" value=${later} aria-invalid=${passed ? "true" : undefined} aria-describedby="later-wrong" onInput=${(event) => setLater(event.target.value)} />
        <p id="later-wrong" class="tone-bad small" role="status">${passed && t("ready.passed")}</p></div>
    </div>
  </div>`;
}

/** START; where something is wrong it is described by the check, which says why. Warnings that the window is too low for are counted beside it. */
function StartButton({ ready, starting, later, wrong, warnings, start }) {
  const button = useRef(null);
  const words = useRef(null);
  const unheard = useLive((now) => now.connected === false);
  useEffect(() => {
    // Enter starts the run after the check has ended, unless another element has the focus.
    if (ready && (document.activeElement === document.body || ["question", "main"].includes(document.activeElement?.id))) {
      button.current.focus({ preventScroll: true });
      words.current.scrollIntoView({ block: "nearest" }); // START with what stands above it
    }
  }, [ready]);
  return html`<button type="button" ref=${button} class="go giant" disabled=${!ready} aria-describedby=${wrong ? "check" : undefined} onClick=${start}>
    ${starting ? t("ready.starting") : later ? t("ready.plan_it") : t("ready.start")}
  </button>
  <p class="soft" role="status" ref=${words}>${ready && warnings > 0 && html`<a class="tone-warn" href="#check">${t("ready.warnings", { n: warnings })}</a><br />`}${wrong ? html`<a class="tone-bad" href="#check">${t("ready.bad")}</a>` : starting ? t(unheard ? "ready.unheard" : "ready.starting_long") : ready && !later ? t("ready.consequence") : ""}</p>`;
}

function Facts({ plan, result, station, units }) {
  const curve = result?.curve ?? plan.curve;
  const [low, high] = range(curve);
  const time_s = result?.duration_s ?? plan.nominal_s;
  const ends = inOneLine(new Intl.DateTimeFormat(language.get(), { weekday: "short", hour: "2-digit", minute: "2-digit" }).format(Date.now() + time_s * 1000));
  return html`<dl class="ready-facts">
    <div><dt>${t("ready.unit", { n: units.length })}</dt><dd class="mono">${units.length > 2 ? t("start.all_units", { n: units.length }) : units.map(serialOf).join(", ")}</dd></div>
    <div><dt>${t("ready.plan")}</dt><dd>${planTitle(plan)}</dd></div>
    <div><dt>${t("ready.takes")}</dt><dd class="figures">${forecast(time_s)}</dd>
      ${forecast(time_s) !== forecast(plan.nominal_s) && html`<dd class="more">${t("ready.nominal", { time: forecast(plan.nominal_s) })}</dd>`}<dd class="more">${station.simulated ? t("ready.simulated") : t("ready.ends", { time: ends })}</dd></div>
    <div><dt>${t("ready.range")}</dt><dd class="figures">${low === high ? degrees(low, 0) : between(number(low, 0), degrees(high, 0))}</dd></div>
  </dl>`;
}

/** Findings that matter, the worst first, and notes. */
function findingsOf(result, plans) {
  const late = result.segments.filter((segment) => segment.outcome !== "done");
  const findings = [
    ...late.map((segment) => ({ level: "error", text: `${segment.name}: ${segment.reason}` })),
    ...result.findings.map((finding) => ({ ...finding, text: ofPlans(finding.text, plans) })),
  ].sort((one, other) => Object.keys(TONES).indexOf(one.level) - Object.keys(TONES).indexOf(other.level));
  return { serious: findings.filter(({ level }) => level !== "info"), notes: findings.filter(({ level }) => level === "info") };
}

/** Findings of the check: one lamp for all, and each finding. */
function Checked({ result, plans, error, again, units }) {
  if (error) return html`<${Trouble} error=${error} retry=${again} />`;
  if (!result) return html`<div class="panel"><${Busy}>${t("ready.checking")}<//></div>`;
  const { serious, notes } = findingsOf(result, plans);
  const tone = !result.ok ? "bad" : serious.length ? "warn" : "good";
  return html`<div id="check" class=${`checked notice ${tone}`} role="status">
    <p class="checked-word"><${Lamp} tone=${tone}>${t(`ready.${tone}`, { n: serious.length })}<//></p>
    ${result.ok && serious.length > 1 ? html`<details><summary>${t("ready.warnings", { n: serious.length })}</summary><${Findings} names=${units} findings=${serious} /></details>` : html`<${Findings} names=${units} findings=${serious} />`}
    ${notes.length > 0 && html`<details><summary>${t("ready.notes", { n: notes.length })}</summary><${Findings} names=${units} findings=${notes} /></details>`}
  </div>`;
}

/** Findings of a check; `lines` shows the line of the file before a finding that names one; `names` of the user in them. */
export const Findings = ({ findings, lines = null, names = [] }) => findings.length > 0 && html`<ul class="findings">
  ${findings.map(({ level, text, line }) => html`<li key=${`${line} ${text}`}><span class=${`tone-${TONES[level]}`}><${Shape} tone=${TONES[level]} /></span><span>${line && lines?.(line)} <${Said} text=${text} whole names=${names} /></span></li>`)}
</ul>`;
