// A trace of a live run as columns for uPlot. Bounded: the bench halves the trace when it is full, and marks this by
// another generation; then the page fetches it again.

const MOST = 8192;
/** Time of the slow mean [s]: that of the means of an analysis. */
export const SLOW_S = 30;

/** Points so far: `t` [s], `setpoint` and `chamber` [degC], by unit `degc[u]` [degC], `low[u]`, `high[u]`, `mean[u]` and `slow[u]`, the mean over 30 s [deg/h]. */
export class Trace {
  generation = undefined;
  next = 0;
  count = 0;
  every_s = 1;
  serials = [];
  version = 0;
  open = null;
  t = [];
  setpoint = [];
  chamber = [];
  degc = [];
  low = [];
  high = [];
  mean = [];
  slow = [];
  fetching = false;

  clear() {
    Object.assign(this, new Trace(), { fetching: this.fetching });
  }

  /** Whether the trace is complete up to the last report of the bench. */
  get complete() {
    return this.generation !== undefined && this.next >= this.count;
  }

  /** Add a page or an increment; false when there is a gap before it, and it was not added. */
  take({ generation, first, next, count, every_s, serials, points, open }) {
    const from = first ?? next - points.length;
    if (generation !== this.generation) {
      if (from !== 0) return false;
      this.clear();
      this.generation = generation;
    }
    if (from > this.next) return false;
    // Without a point the bench does not know its units yet.
    Object.assign(this, { every_s, serials: serials ?? this.serials, count: Math.max(count ?? next, next), open: open ?? null, version: this.version + 1 });
    for (const point of points.slice(this.next - from)) this.add(point);
    this.next = Math.max(this.next, next);
    return true;
  }

  add([t, setpoint, chamber, degc, spans]) {
    if (this.t.length >= MOST) return; // the bench never has as many; a server that errs shall not fill the page
    this.t.push(t);
    this.setpoint.push(setpoint);
    this.chamber.push(chamber);
    degc.forEach((value, unit) => (this.degc[unit] ??= []).push(value));
    spans.forEach(([low, high, mean = null], unit) => {
      (this.low[unit] ??= []).push(low);
      (this.high[unit] ??= []).push(high);
      (this.mean[unit] ??= []).push(mean);
      (this.slow[unit] ??= []).push(this.over(SLOW_S, unit));
    });
  }

  /** Mean of a unit's rate over the last `span_s` up to the newest point; null without samples. */
  over(span_s, unit) {
    const since = this.t.at(-1) - span_s;
    let [sum, count] = [0, 0];
    for (let i = this.t.length - 1; i >= 0 && this.t[i] > since; i--) {
      const mean = this.mean[unit][i];
      if (mean !== null) [sum, count] = [sum + mean, count + 1];
    }
    return count ? sum / count : null;
  }

  /** Index of a unit in the columns, −1 without one; 0 when the trace does not name its units. */
  place(serial) {
    return this.serials.length ? this.serials.indexOf(serial) : 0;
  }
}
