// The moment that the mouse points at in one figure, for the others: by the table of each figure, which has time and abscissa.
import { store } from "../../lib/store.js";

/** {of: run, kind: figure, time_s}, or null before the mouse has pointed at anything. */
export const pointed = store(/** @type {{of: string, kind: string, time_s: number} | null} */ (null));
const HOUR_S = 3600;
/** Column of the abscissa where it is not the second. */
const ABSCISSA = { time: "time [s]", temperature: "temperature [degC]", loop: "temperature [degC]" };

/** Rows of a table with the places of time and abscissa in them; null where it has no time. */
function tableOf(kind, csv) {
  const [head = [], ...rows] = csv ?? [];
  const [time, x] = [head.indexOf("time [s]"), kind in ABSCISSA ? head.indexOf(ABSCISSA[kind]) : 1];
  return time < 0 || x < 0 || !rows.length ? null : { head, rows, time, x };
}

/** The row where `distance` is least. */
const nearest = (rows, distance) => rows.reduce((best, row) => (distance(row) < distance(best) ? row : best));

/** The moment [s] of a point of a figure: of its row that is nearest, by all that may be drawn of it. */
export function momentOf(kind, csv, { x, y }) {
  const table = tableOf(kind, csv);
  if (!table) return null;
  if (kind === "time") return x * HOUR_S;
  const { head, rows } = table;
  const [bias, model] = [head.indexOf("bias [deg/h]"), head.indexOf("model [deg/h]")];
  const last = head.length - 1;
  const drawn = (row) => (bias < 0 || model < 0 ? [row[last]] : [row[bias], row[bias] - row[model]]);
  const span = Math.max(...rows.map((row) => row[table.x])) - Math.min(...rows.map((row) => row[table.x])) || 1;
  const off = (row) => Math.abs(row[table.x] - x) / span + Math.min(...drawn(row).map((value) => Math.abs(value - y))) / (Math.abs(y) || 1);
  return nearest(rows, off)[table.time];
}

/** Where a moment is on the abscissa of a figure; null where the figure does not show it. */
export function placeOf(kind, csv, time_s) {
  const table = tableOf(kind, csv);
  if (!table) return null;
  const times = table.rows.map((row) => row[table.time]);
  if (time_s < times[0] - 60 || time_s > times.at(-1) + 60) return null;
  const x = nearest(table.rows, (row) => Math.abs(row[table.time] - time_s))[table.x];
  return kind === "time" ? x / HOUR_S : x;
}
