// One live run in full: state, time left, segment bar, figures, curves, guards, actions.
import { html, useEffect, useRef, useState } from "../../lib/preact.js";
import { Lamp, Shape } from "../../lib/parts.js";
import { traces } from "../../lib/live.js";
import { degrees, duration, joined, language, number, sign, t } from "../../lib/words.js";
import { Trace } from "../../lib/trace.js";
import { Actions } from "./actions.js";
import { Output, Temperatures, unitTone } from "./charts.js";
import { isResumed } from "./resume.js";
import { Guards, guardName } from "./guards.js";
import { Log } from "./log.js";
import { planName } from "../../lib/names.js";
import { isOld, lateText, segmentText, serials, stateWord, toneOf } from "./words.js";
import { Said } from "../../lib/said.js";

const EMPTY = new Trace();

export function RunView({ run }) {
  const trace = traces.get(run.run) ?? EMPTY;
  const units = run.units ?? [];
  const calm = (run.guards ?? []).every(({ state }) => state === "ok");
  const guards = html`<${Guards} key="guards" guards=${run.guards} old=${isOld(run)} />`;
  const log = html`<${Log} key="log" run=${run} />`;
  return html`<div class="live">
    <${Headline} run=${run} />
    <${Segments} run=${run} />
    <${Troubles} run=${run} />
    <div class="live-body" tabindex="0" role="region" aria-label=${t("live.curves")}>
      <div class="live-charts">
        <${Temperatures} run=${run} trace=${trace} />
        <div class=${units.length > 1 ? "outputs many" : "outputs"}>
          ${units.map((unit, index) => html`<div key=${unit.serial} class="output">
            <${Output} run=${run} trace=${trace} unit=${unit} index=${units.length > 1 ? index : null}>
              ${units.length > 1 && html`<${UnitLine} run=${run} unit=${unit} index=${index} />`}<//>
          </div>`)}
        </div>
      </div>
      <aside>
        ${units.length === 1 && html`<${Figures} run=${run} unit=${units[0]} />`}
        ${calm ? [log, guards] : [guards, log]}
      </aside>
    </div>
    <${Actions} run=${run} />
    <${Changes} run=${run} />
  </div>`;
}

/** When a real run will end, in wall time; a simulated one has a simulated clock. */
function ends(run) {
  if (run.simulated || run.state !== "running" || !Number.isFinite(run.left_s)) return "";
  const time = new Intl.DateTimeFormat(language.get(), { weekday: "short", hour: "2-digit", minute: "2-digit" });
  return t("live.ends", { time: time.format(Date.now() + run.left_s * 1000) });
}

export function Headline({ run, link = false }) {
  const title = serials(run).length > 2 ? t("start.all_units", { n: serials(run).length }) : serials(run).join(", ");
  return html`<header class=${`headline tone-${toneOf(run)}`}>
    <span class="headline-state"><${Shape} tone=${toneOf(run)} /><b>${stateWord(run)}</b></span>
    <div class="headline-what">${link ? html`<h2><a href=${`/live/${run.run}`}>${title}</a></h2>` : html`<h1>${title}</h1>`}
      <span class="soft">${planName(run)}${run.simulated ? ` · ${t("start.simulated")}` : ""}${run.who?.name ? ` · ${t("live.by", { who: run.who.name })}` : ""}${run.job && !link ? html` · <a href=${`/calibrations/${run.job}`}>${t("live.of_calibration")}</a>` : ""}</span></div>
    <div class="headline-time"><span class="soft">${t("live.left")}</span><b class="figures">${duration(run.left_s)}</b>
      <span class="soft">${[lateText(run.late_s), ends(run)].filter(Boolean).join(" · ")}</span></div>
  </header>`;
}

const MOST_CELLS = 60;

/** The segments as a bar: done, current with its progress, and next ones. */
export function Segments({ run }) {
  const segment = run.segment;
  if (!segment) return null;
  const over = segment.left_s <= 0 && run.state !== "ending";
  const done = Math.min(1, Math.max(0, run.t_s / (run.t_s + run.left_s || 1)));
  const cells = segment.of <= MOST_CELLS ? segment.of : 1;
  // In proportion to time, but none so narrow that it cannot be seen. A run that was resumed has other segments.
  const lengths = run.segments_s?.length === cells && cells > 1 ? run.segments_s : null;
  const least = lengths ? lengths.reduce((sum, s) => sum + s, 0) / 150 : 1;
  // What is left says it also of a segment that was held, which begins again where it stopped.
  const elapsed = lengths ? lengths[segment.index] - segment.left_s : run.t_s - segment.from_s;
  const share = elapsed > 0 ? elapsed / (elapsed + segment.left_s) : 0;
  const grow = (index) => (lengths ? Math.max(lengths[index], least) : 1);
  const filled = (index) => (cells === 1 ? done : index < segment.index ? 1 : index > segment.index ? 0 : share);
  return html`<section class="segments" aria-label=${t("live.segments")}>
    <div class="segment-bar" role="progressbar" aria-valuemin="0" aria-valuemax="100" aria-valuenow=${Math.round(done * 100)} aria-label=${t("live.progress")}
      aria-valuetext=${t("live.progress_text", { percent: String(Math.round(done * 100)), left: duration(run.left_s) })}>
      ${Array.from({ length: cells }, (_, index) => html`<i key=${index} class=${index === segment.index ? "now" : ""} ref=${(element) => element?.style.setProperty("flex-grow", String(grow(index)))}>
        <span ref=${(element) => element?.style.setProperty("transform", `scaleX(${filled(index).toFixed(4)})`)}></span></i>`)}
    </div>
    <p class="segment-words"><span><b>${t("live.segment", { index: segment.index + 1, of: segment.of })}</b>${sign(" ")}${segmentText(segment)}</span>
      <span class="figures">${over ? t("live.settling") : t("live.segment_left", { time: duration(segment.left_s) })}</span></p>
  </section>`;
}

export function Troubles({ run }) {
  const gone = isOld(run) && run.condition !== "ended";
  const detail = isResumed(run) ? "" : run.detail; // it names the command, beside the button
  return html`<div aria-live="assertive">
    ${gone && html`<div class="notice bad"><p><strong>${t(`live.${run.condition}`)}</strong>${sign(" ")}<${Said} text=${detail} whole /></p></div>`}
    ${run.chamber?.alarm?.length > 0 && html`<div class="notice bad"><p><strong>${t("live.alarm")}</strong>${sign(" ")}${run.chamber.alarm.join(", ")}</p></div>`}
    ${run.state === "holding" && html`<div class="notice warn"><p><strong>${t("live.held_by")}</strong>${sign(" ")}<${Said} text=${run.holding?.join("; ")} /></p></div>`}
    ${(run.units ?? []).filter((unit) => unit.dropped).map((unit) => html`<div key=${unit.serial} class="notice bad"><p><strong>${t("live.dropped", { serial: unit.serial })}</strong>${sign(" ")}<${Said} text=${unit.dropped} /></p></div>`)}
  </div>`;
}

const LOSSES = ["lost", "slow_lost", "corrupt", "late", "repeated", "invalid"];
const lossesOf = ({ losses }) => LOSSES.reduce((sum, kind) => sum + (losses?.[kind] ?? 0), 0);

/** State of the samples; losses are counted when the next sample arrives. */
const comes = (run, unit) => !isOld(run) && !unit.dropped && unit.losses?.received > 0 && (run.buses ?? []).every(({ state }) => state === "ok");

const Loss = ({ run, unit }) => {
  const lost = lossesOf(unit);
  if (lost) return html`<${Lamp} tone="warn">${t("live.losses", { n: lost })}<//>`;
  return comes(run, unit) ? html`<${Lamp} tone="good">${t("live.no_losses")}<//>` : html`<${Lamp} tone="idle">${t("live.no_samples")}<//>`;
};

function Figures({ run, unit }) {
  const losses = Object.entries(unit.losses ?? {}).filter(([name, count]) => count && name !== "received");
  return html`<dl class="figures-grid panel figures">
    <div><dt>${t("live.chamber")}</dt><dd>${degrees(run.chamber?.temperature_degc)}</dd></div>
    <div><dt>${t("live.unit_temperature")}</dt><dd>${degrees(unit.temperature_degc)}</dd></div>
    <div class="wide"><dt>${t("live.frames")}</dt><dd class="small-figure"><${Loss} run=${run} unit=${unit} /></dd>
      <dd class="soft">${t("live.received", { n: unit.losses?.received ?? 0 })}${losses.map(([name, count]) => html` · ${t(`loss.${name}`)} ${number(count)}`)}</dd></div>
  </dl>`;
}

const UnitLine = ({ run, unit, index }) => html`<p class="unit-line figures">
  <span class="lamp"><svg viewBox="0 0 12 12" aria-hidden="true" ref=${(element) => element?.style.setProperty("color", `var(${unitTone(index)})`)}><rect width="12" height="12" rx="2" fill="currentColor" /></svg>
  <b>${degrees(unit.temperature_degc)}</b></span> <${Loss} run=${run} unit=${unit} />
</p>`;

/** Announces changes to screen readers: states at once, segments politely. */
function Changes({ run }) {
  const tripped = joined((run.guards ?? []).filter((guard) => guard.state === "tripped").map(guardName));
  const last = useRef({ state: run.state, segment: run.segment?.index, tripped });
  const [message, setMessage] = useState("");
  useEffect(() => {
    const before = last.current;
    last.current = { state: run.state, segment: run.segment?.index, tripped };
    if (tripped && before.tripped !== tripped) setMessage(t("live.said_tripped", { guards: tripped }));
    else if (before.state !== run.state) setMessage(stateWord(run));
    else if (before.segment !== run.segment?.index) setMessage(`${t("live.segment", { index: run.segment.index + 1, of: run.segment.of })}${sign(" ")}${segmentText(run.segment)}`);
  }, [run.state, run.segment?.index, tripped]);
  return html`<p class="unseen" role="status">${message}</p>`;
}
