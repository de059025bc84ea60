// Curves of a live run: temperatures against the profile, and each unit's output as means and as a min/max envelope.
import { html, useMemo, useState } from "../../lib/preact.js";
import { Legend, Plot, colour, polyline } from "../../lib/plot.js";
import { SLOW_S } from "../../lib/trace.js";
import { degrees, duration, number, t } from "../../lib/words.js";

/** Colours of units, in the order of the run; dashed from the fifth on, so that all differ. */
const UNIT_TONES = ["--unit", "--figure-green", "--figure-purple", "--unit-4"];
const MOST_LINES = 8;
/** Least height of a chart with its axis [px]; the smallest and largest samples get half of it. */
const HEIGHT = 250;
export const unitTone = (index) => UNIT_TONES[index % UNIT_TONES.length];

/** Delay of the run relative to its nominal curve [s]. */
const shift = (run) => (run.curve?.length ? Math.max(0, (run.t_s ?? 0) + (run.left_s ?? 0) - run.curve.at(-1)[0]) : 0);

/** The rest of the profile, from now on. */
function ahead(run) {
  const moved = (run.curve ?? []).map(([s, degc]) => [s + shift(run), degc]);
  const next = moved.findIndex(([s]) => s > (run.t_s ?? 0));
  if (next < 0) return [];
  if (next === 0) return moved;
  const [[before, from], [after, to]] = [moved[next - 1], moved[next]];
  const now = [run.t_s, from + ((to - from) * (run.t_s - before)) / (after - before || 1)];
  return [now, ...moved.slice(next)];
}

const spanOf = (run) => () => [0, Math.max(run.t_s ?? 0, (run.t_s ?? 0) + (run.left_s ?? 0), 60)];

/** Lowest and highest drawn value, profile included, so that the scale does not change during the run. */
const reachOf = (run) => (_, low, high) => {
  const degc = [...(run.curve ?? []).map(([, value]) => value), ...(low === null ? [] : [low, high])];
  if (!degc.length) return [0, 50];
  const [least, most] = [Math.min(...degc), Math.max(...degc)];
  const edge = Math.max(most - least, 4) * 0.07;
  return [least - edge, most + edge];
};

const withOpen = (column, open) => (open === undefined ? column : [...column, open]);

function temperatures(trace, lines) {
  const { open } = trace;
  const last = open ?? [];
  const units = Array.from({ length: lines }, (_, unit) => withOpen(trace.degc[unit] ?? trace.t.map(() => null), open ? last[3]?.[unit] ?? null : undefined));
  return [withOpen(trace.t, last[0]), withOpen(trace.setpoint, last[1]), withOpen(trace.chamber, last[2]), ...units];
}

const line = (tone, width, dash) => ({ stroke: () => colour(tone), width, dash, points: { show: false } });

/** Chamber and units against the profile. */
export function Temperatures({ run, trace }) {
  const [pointed, setPointed] = useState(null);
  const units = run.units ?? [];
  const lines = Math.min(Math.max(units.length, trace.serials.length, 1), MOST_LINES);
  const series = useMemo(() => [
    line("--profile", 2, [6, 5]), line("--chamber", 2),
    ...Array.from({ length: lines }, (_, index) => line(unitTone(index), 2.5, index < UNIT_TONES.length ? undefined : [10, 3])),
  ], [lines]);
  const data = temperatures(trace, lines);
  const at = (column, otherwise) => degrees(pointed === null ? otherwise : data[column]?.[pointed] ?? null, 1);
  const named = units.length > 1 ? units.slice(0, MOST_LINES) : [{ ...units[0], name: t("live.unit_temperature") }];
  return html`<section class="chart" aria-label=${t("live.temperatures")}>
    <header><h2>${t("live.temperatures")} <small class="soft">°C</small></h2>
      <${Legend} entries=${[
        { name: t("live.profile"), tone: "--profile", dash: true, value: at(1, run.chamber?.working_setpoint_degc ?? run.chamber?.setpoint_degc) },
        { name: t("live.chamber"), tone: "--chamber", value: at(2, run.chamber?.temperature_degc) },
        ...named.map((unit, index) => ({ name: unit.name ?? unit.serial, tone: unitTone(index), dash: index >= UNIT_TONES.length, value: at(3 + index, unit.temperature_degc) })),
      ]} /></header>
    <${Plot} key=${lines} label=${t("live.temperatures_label", { chamber: degrees(run.chamber?.temperature_degc), unit: degrees(units[0]?.temperature_degc) })}
      series=${series} data=${data} version=${trace.version} span=${spanOf(run)} reach=${reachOf(run)} height=${HEIGHT}
      behind=${(plot) => polyline(plot, ahead(run), "--profile")} pointed=${setPointed} />
  </section>`;
}

const fill = (tone) => () => `${colour(tone)}55`;
const MEANS = [line("--edge", 1), line("--rate", 2.5)];
const BAND = [line("--rate", 1.25), line("--rate", 1.25)];
const FILLED = [{ series: [2, 1], fill: fill("--rate") }];

/**
 * A unit's output: its means, which show a bias below the noise, on a scale of their own; below them the smallest and
 * largest of all samples in each point, so that a spike of one sample is seen.
 */
export function Output({ run, trace, unit, index, children }) {
  const [pointed, setPointed] = useState(null);
  const place = trace.place(unit.serial);
  const column = (name) => trace[name][place] ?? trace.t.map(() => null);
  const span = trace.open?.[4]?.[place];
  const band = [
    withOpen(trace.t, trace.open?.[0]),
    ...["low", "high"].map((name, i) => withOpen(column(name), trace.open ? span?.[i] ?? null : undefined)),
  ];
  const means = [trace.t, column("mean"), column("slow")];
  const at = (values) => values[pointed ?? values.length - 1] ?? null;
  const [low, high, fast, slow] = [at(band[1]), at(band[2]), at(means[1]), at(means[2])];
  const range = low === null ? "–" : `${number(low, 1)} … ${number(high, 1)} ${t("unit.dph")}`;
  const longer = trace.every_s >= SLOW_S;
  const several = index !== null; // there is room for the time of a mean, with the unit beside its value
  const mean = (s, tone, value) => ({ name: several ? duration(s) : t("live.mean", { s: number(s) }), tone, value: several ? `${number(value, 2)} ${t("unit.dph")}` : number(value, 2) });
  const told = { serial: unit.serial, low: number(low, 1), high: number(high, 1), mean: number(slow, 2) };
  const shared = { version: trace.version, span: spanOf(run), pointed: setPointed };
  return html`<section class="chart" aria-label=${`${t("live.output")} ${unit.serial}`}>
    <header><h2>${several ? unit.serial : t("live.output")} <small class="soft">${t("unit.dph")}</small></h2>
      ${children}<${Legend} entries=${[
        ...(longer ? [] : [mean(trace.every_s, "--edge", fast)]), mean(longer ? trace.every_s : SLOW_S, "--rate", slow),
      ]} /></header>
    <${Plot} label=${t("live.means_label", told)} series=${MEANS} data=${means} least=${0.5} height=${HEIGHT} ...${shared} />
    <header class="chart-below"><${Legend} entries=${[{ name: t("live.envelope", { s: number(trace.every_s) }), tone: "--rate", band: true, value: range }]} /></header>
    <${Plot} label=${t("live.output_label", told)} series=${BAND} bands=${FILLED} data=${band} least=${0.5} height=${HEIGHT / 2} ...${shared} />
  </section>`;
}
