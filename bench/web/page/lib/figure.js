// One figure: plotly drawn from JSON in the page's colours, with its description, keyboard control and file export.
//
// Plotly is fetched as soon as there is a place for a figure, while its data are computed. A figure is updated by
// Plotly.react, never recreated: a figure that is recreated loses its zoom and has leaked memory in the past.
import { savePng, saveSvg } from "./download.js";

/** @type {[number, number]} */
const EXPORT_SIZE = [1200, 700];
/** Width that a date below an axis takes, with what is between it and the next one. */
const DATE_PX = 110;
const CONFIG = { displayModeBar: false, responsive: false, doubleClick: false, showTips: false };
const KEY_STEP = 0.2;
const KEYS = ["ArrowLeft", "ArrowRight", "+", "=", "-", "0", "Home"];

/** Plotly, after it was fetched. */
let Plotly = null;

/** Fetch plotly, once. */
async function plotly() {
  Plotly ??= (await import("plotly.js-cartesian-dist-min")).default;
  return Plotly;
}

/** Colours of the page as it is now (light or dark), as constants for a drawing. */
export function palette() {
  const style = getComputedStyle(document.documentElement);
  const of = (name, otherwise) => style.getPropertyValue(name).trim() || otherwise;
  return {
    paper: of("--paper", "#ffffff"), ink: of("--ink", "#16202a"), soft: of("--soft", "#56636f"),
    line: of("--line", "#d7dee4"), grid: of("--grid", "#e3e8ec"), raised: of("--raised", "#ffffff"),
    heldOut: of("--figure-blue", "#0072B2"), inSample: of("--figure-orange", "#E69F00"), floor: of("--figure-green", "#009E73"), good: of("--good", "#00664a"),
  };
}

/** Colours that the server draws with, each by its name here, and by that of a text in it: thin letters need more contrast than lines. */
const DRAWN = {
  "#0072B2": ["--figure-blue", "--link"], "#E69F00": ["--figure-orange", "--warn"], "#009E73": ["--figure-green", "--good"], "#D55E00": ["--figure-vermilion", "--bad"],
  "#56B4E9": ["--figure-sky", "--link"], "#CC79A7": ["--figure-purple", "--ink"], "#8A949D": ["--figure-grey", "--soft"],
};

/** A part of a figure with the colours of the page as it is now. */
function recoloured(part) {
  const style = getComputedStyle(document.documentElement);
  const of = (value, text) => {
    if (Array.isArray(value)) return value.map((one) => of(one, text));
    if (value && typeof value === "object" && !ArrayBuffer.isView(value)) return Object.fromEntries(Object.entries(value).map(([key, one]) => [key, of(one, /font$/.test(key))]));
    return DRAWN[value] ? style.getPropertyValue(DRAWN[value][text ? 1 : 0]).trim() || value : value;
  };
  return of(part, false);
}

/** Layout of a figure in the page's colours; `zoom` {axis: [low, high]} are ranges to keep. */
export function themed(layout, colours, zoom = {}) {
  const out = { ...layout, font: { ...layout.font, color: colours.ink }, autosize: true };
  delete out.height;
  delete out.width;
  for (const key of Object.keys(layout).filter((name) => /^[xy]axis\d*$/.test(name))) {
    out[key] = {
      ...layout[key], gridcolor: colours.grid, linecolor: colours.soft, tickcolor: colours.soft,
      zerolinecolor: colours.line, ...(zoom[key] ? { range: [...zoom[key]], autorange: false } : {}),
    };
  }
  if (layout.annotations) out.annotations = layout.annotations.map((one) => ({ arrowcolor: colours.ink, standoff: 5, ...one }));
  out.hoverlabel = { bgcolor: colours.paper, bordercolor: colours.soft, font: { color: colours.ink } };
  return out;
}

/** Call `change` whenever the page turns light or dark; returns a function that ends this. */
export function onTheme(change) {
  const media = matchMedia("(prefers-color-scheme: dark)");
  const watcher = new MutationObserver(change);
  watcher.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme", "class"] });
  media.addEventListener("change", change);
  return () => {
    watcher.disconnect();
    media.removeEventListener("change", change);
  };
}

/** The range of an axis after a key of `KEYS`, from `low` to `high` now, inside that of all data, `whole`; null for all of it. */
export function moved(name, [low, high], whole) {
  const step = KEY_STEP * (high - low);
  const moves = { ArrowLeft: [-step, -step], ArrowRight: [step, step], "+": [step, -step], "=": [step, -step], "-": [-step, step] };
  const [from, to] = [low + moves[name][0], high + moves[name][1]];
  if (!whole) return [from, to];
  const [first, last] = whole;
  if (to - from >= last - first) return null;
  const back = Math.max(first - from, Math.min(0, last - to));
  return [from + back, to + back];
}

/** A drawn figure in `place` (an element). `tell("onZoom", range|null)` has the range of x after the user has zoomed, `"onPoint"` the point below the mouse, `"onPick"` one that was clicked. */
export class Drawn {
  constructor(place, tell) {
    this.place = place;
    this.tell = tell;
    /** Where a line stands over all of x; null without one. */
    this.mark = null;
    this.figure = null;
    /** The figure that stands there, and the keys that were pressed before it did. */
    this.painted = null;
    this.waiting = [];
    this.zoom = {};
    /** The range of x with all that was drawn; a figure of which only a part came says its own. */
    this.whole = null;
    this.listening = false;
    // Plotly.Plots.resize alone would leave the legend at its place for the size before, over the curves.
    this.watcher = new ResizeObserver(() => this.listening && this.figure && Plotly.Plots.resize(place).then(() => this.paint()));
    this.watcher.observe(place);
    plotly().catch(() => {}); // told when the figure is drawn
    this.stop = onTheme(() => this.figure && this.paint());
  }

  /** Draw `figure` {data, layout}; `keep` keeps the zoom (finer data of the same picture), else x has the `range`. */
  async show(figure, keep = false, range = null, mark = null) {
    this.figure = figure;
    this.mark = mark;
    if (!keep) [this.zoom, this.whole] = [range ? { xaxis: range } : {}, null];
    await this.paint();
  }

  async paint() {
    await plotly();
    const { figure } = this;
    if (!figure || !this.place.isConnected) return;
    // Plotly changes its input, and the answer may be cached: it gets a copy, which this is.
    const { data, layout } = recoloured(figure);
    if (layout.xaxis?.type === "date") layout.xaxis = { ...layout.xaxis, nticks: Math.max(2, Math.min(layout.xaxis.nticks || Infinity, Math.floor(this.place.clientWidth / DATE_PX))) };
    const line = this.mark === null ? [] : [{ type: "line", xref: "x", yref: "paper", x0: this.mark, x1: this.mark, y0: 0, y1: 1, line: { width: 1.5, dash: "dot", color: palette().ink } }];
    await Plotly.react(this.place, data, { ...themed(layout, palette(), this.zoom), shapes: [...(layout.shapes ?? []), ...line] }, CONFIG);
    if (!this.zoom.xaxis) this.whole = this.place.layout.xaxis?.range?.slice();
    const [minallowed, maxallowed] = this.all ?? [];
    for (const { xaxis } of [this.place.layout, this.place._fullLayout]) if (this.all && xaxis) Object.assign(xaxis, { minallowed, maxallowed }); // what is dragged stays there
    if (!this.listening) {
      this.place.on("plotly_hover", ({ points }) => this.tell("onPoint", points[0]));
      this.place.on("plotly_click", ({ points }) => this.tell("onPick", points[0]));
      this.place.on("plotly_relayout", (change) => this.relayout(change));
      // Plotly would return to the last drawn range, which is the narrow one after finer data was fetched.
      this.place.on("plotly_doubleclick", () => this.reset());
      this.listening = true;
    }
    this.painted = figure;
    for (const name of this.waiting.splice(0)) this.key(name);
  }

  /** The range of x with all data, as far as it is known. */
  get all() {
    return this.figure.layout.meta?.whole ?? this.whole;
  }

  relayout(change) {
    const touched = Object.keys(change).filter((key) => /^[xy]axis\d*\.(range|autorange)/.test(key));
    if (!touched.length) return;
    for (const key of touched) {
      const axis = key.split(".")[0];
      const { range, autorange } = this.place.layout[axis];
      if (autorange) delete this.zoom[axis];
      else this.zoom[axis] = [...range];
    }
    this.tell("onZoom", this.zoom.xaxis ?? null);
  }

  /** Show the whole figure again. */
  reset() {
    this.zoom = {};
    this.tell("onZoom", null);
    return this.paint();
  }

  /** Arrow keys move, + and - zoom in time or temperature, 0 or Home shows all; a key that comes before the figure waits for it. True if the key was used. */
  key(name) {
    if (!KEYS.includes(name)) return false;
    if (!this.figure || this.painted !== this.figure) return this.waiting.push(name), true;
    const axis = this.place.layout?.xaxis;
    if (!axis?.range) return false;
    if (name === "0" || name === "Home") return this.reset(), true;
    const { r2l: toNumber, l2r: fromNumber } = this.place._fullLayout.xaxis; // dates are texts in a range
    const range = moved(name, axis.range.map(toNumber), this.all?.map(toNumber));
    if (!range) return this.reset(), true;
    Plotly.relayout(this.place, { "xaxis.range": range.map(fromNumber), "xaxis.autorange": false });
    return true;
  }

  async svg() {
    await plotly();
    const [width, height] = EXPORT_SIZE;
    const colours = palette();
    const { data, layout } = recoloured(this.figure);
    const painted = { ...themed(layout, colours, this.zoom), paper_bgcolor: colours.paper, autosize: false, width, height };
    const address = await Plotly.toImage({ data, layout: painted }, { format: "svg", width, height });
    return decodeURIComponent(address.slice(address.indexOf(",") + 1));
  }

  /** The figure as a file: "PNG" or "SVG", in the current colours and zoom. */
  async save(kind, name) {
    const text = await this.svg();
    return kind === "PNG" ? savePng(name, text, EXPORT_SIZE) : saveSvg(name, text);
  }

  end() {
    this.watcher.disconnect();
    this.stop();
    this.figure = null;
    if (this.listening) Plotly?.purge(this.place);
  }
}
