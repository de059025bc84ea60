// State of a live run in words and tones.
import { degrees, duration, number, or, symbols, t } from "../../lib/words.js";

const TONES = { running: "good", starting: "link", holding: "warn", pausing: "warn", ending: "warn" };

/** State of a run for people: one that does not answer is not "running", regardless of its last report. */
export const stateOf = (run) => (isOld(run) ? run.condition : run.state);
/** Whether the last report of a run is shown instead of its current state. */
export const isOld = (run) => Boolean(run.condition) && run.condition !== "live";
export const toneOf = (run) => (run.condition === "unheard" ? "idle" : run.condition === "gone" || run.condition === "silent" ? "bad" : TONES[run.state] ?? "idle");
export const stateWord = (run) => or(`live.state.${stateOf(run)}`, stateOf(run));

/** A segment as text; its name if the kind is unknown. */
export function segmentText(segment) {
  if (!segment) return "";
  const values = { degc: degrees(segment.target_degc, 0), rate: number(Math.abs(segment.rate_degc_per_min ?? 0)) };
  const kind = segment.name === "hold" ? "hold" : segment.kind; // a hold of any segment is told as a soak
  return or(`segment.${kind}`, segment.name).replace(/\{(\w+)\}/g, (whole, name) => values[name] ?? whole);
}

/** Difference from the first estimate so far. */
export function lateText(late_s) {
  if (late_s === null || late_s === undefined) return "";
  if (Math.abs(late_s) < 30) return t("live.on_time");
  return t(late_s > 0 ? "live.late" : "live.early", { time: duration(Math.abs(late_s)) });
}

/** Serial numbers of all units of a run. */
export const serials = (run) => (run.units?.length ? run.units.map((unit) => unit.serial) : [run.unit]);

const UNITS = {
  chamber_temperature: "degC", unit_temperature: "degC", sensor_disagreement: "degC", frame_age: "s", disk_free_mb: "MB",
  unit_coldest: "degC", unit_excess: "K", setpoint_excess: "K", unit_doubted_s: "s", power: "%", frozen_s: "s", chamber_silent_s: "s", bus_failed_s: "s",
};

/** The value of a guard with the unit of the language; empty where the light says all. */
export function valueOf({ signal, value, per_min: rate }) {
  if (!(signal in UNITS)) return ""; // yes or no: the light says it
  if (value === null || value === undefined) return "–";
  if (rate !== null && rate !== undefined) return t("guards.per_min", { value: number(rate, 1), unit: symbols(UNITS[signal]) });
  return `${number(value, Math.abs(value) >= 100 ? 0 : 1)} ${symbols(UNITS[signal])}`;
}
