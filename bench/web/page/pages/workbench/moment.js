// The moment that the mouse points at in one figure, for the others: by the table of each figure, which has time and abscissa.
import { store } from "../../lib/store.js";

/** {of: run, view: figure and its abscissa, time_s}, or null before the mouse has pointed at anything. */
export const pointed = store(/** @type {{of: string, view: string, time_s: number} | null} */ (null));
const HOUR_S = 3600;
/** Column of the abscissa where it is not the one after the time. */
const ABSCISSA = { time: "time [s]", temperature: "temperature [degC]", loop: "temperature [degC]" };
/** A row shows a moment that is no further away, or no further than from it to the next row. */
const NEAR_S = 60;

/** Rows of a table, of a run where it has several, with the places of time and abscissa in them; null where it has no time. */
function tableOf(kind, csv, run) {
  const [head = [], ...all] = csv ?? [];
  const time = head.indexOf("time [s]");
  const x = kind in ABSCISSA ? head.indexOf(ABSCISSA[kind]) : time + 1;
  const rows = all.filter((row) => (head[0] !== "run" || row[0] === run) && row[x] !== null);
  return time < 0 || x < 0 || !rows.length ? null : { head, rows, time, x };
}

/** The row where `distance` is least. */
const nearest = (rows, distance) => rows.reduce((best, row) => (distance(row) < distance(best) ? row : best));

const spanOf = (values) => Math.max(...values) - Math.min(...values) || 1;

/** The moment [s] of a point of a figure: of its row that is nearest, by all that may be drawn of it. */
export function momentOf(kind, csv, { x, y }, run = "") {
  const table = tableOf(kind, csv, run);
  if (!table) return null;
  if (kind === "time") return x * HOUR_S;
  const { head, rows } = table;
  const [bias, model] = [head.indexOf("bias [deg/h]"), head.indexOf("model [deg/h]")];
  const last = head.length - 1;
  const drawn = (row) => (bias < 0 || model < 0 ? [row[last]] : [row[bias], row[bias] - row[model]]);
  const [wide, high] = [spanOf(rows.map((row) => row[table.x])), spanOf(rows.map((row) => drawn(row)[0]))];
  const off = (row) => Math.abs(row[table.x] - x) / wide + Math.min(...drawn(row).map((value) => Math.abs(value - y))) / high;
  return nearest(rows, off)[table.time];
}

/** Where a moment of a run is on the abscissa of a figure; null where the figure does not show it. */
export function placeOf(kind, csv, time_s, run = "") {
  const table = tableOf(kind, csv, run);
  if (!table) return null;
  const { rows, time } = table;
  const step_s = rows.length > 1 ? (rows.at(-1)[time] - rows[0][time]) / (rows.length - 1) : 0;
  const row = nearest(rows, (one) => Math.abs(one[time] - time_s));
  if (Math.abs(row[time] - time_s) > Math.max(NEAR_S, kind === "time" ? step_s : 0)) return null;
  return kind === "time" ? row[table.x] / HOUR_S : row[table.x];
}
