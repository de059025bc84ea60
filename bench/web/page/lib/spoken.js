// Figures and captions of the server in the reader's language: labels, units, hovers, numbers.
import { lotName, planTitle, runTitle, stationName } from "./names.js";
import { degrees, effectWord, known, language, quantityWord, sig, sign, symbols, t } from "./words.js";

/** Letters of a title beside a third of a figure. */
const MOST_IN_LINE = 14;
const NAMED = /^(.*?)(?: ?\[([^\]]+)\])?$/s;

const separators = () => {
  const parts = new Intl.NumberFormat(language.get()).formatToParts(12345.6);
  return { decimal: parts.find(({ type }) => type === "decimal").value, group: parts.find(({ type }) => type === "group")?.value ?? "" };
};

/** A number with fixed decimals, or to significant digits as the bench writes it: no digit before the point is dropped. */
function written({ number, digits = 3, decimals = undefined }) {
  if (number === null || number === undefined) return "–";
  if (number === 0) return "0";
  const exponent = Math.floor(Math.log10(Math.abs(number)));
  if (decimals === undefined && (exponent < -4 || exponent >= 7)) return sig(number, digits);
  return number.toFixed(decimals ?? Math.max(0, digits - 1 - exponent)).replace(".", separators().decimal).replace("-", "−");
}

/** What a model without a name of its own is called: by its effects. */
const UNNAMED = /^\w+(?: \+ \w+)+$/;

/** A run that a text names by its id, a soak, a lot, or a model by its effects, as people know it; any other text as it is. */
function named(text) {
  const [, order = "", degc] = text.match(/^(\d+: )?(?:soak|constant) at (-?[\d.]+)$/) ?? [];
  if (degc) return order + t("segment.soak", { degc: degrees(Number(degc), 0) });
  const [, lot] = text.match(/^lot (.+)$/) ?? [];
  if (lot) return lot === "no lot" ? lotName(lot, []) : `${t("fleet.kind.lot")} ${lot}`;
  if (UNNAMED.test(text)) return text.split(" + ").map(effectWord).join(" + ");
  return /^[^/]+\/\d{8}T\d{6}Z_/.test(text) ? `${text.split("/")[0]} ${runTitle(text)}` : text;
}

/** A value of a caption, or a whole one (`{key, values}`), as text. */
function told(value) {
  if (value === null || typeof value === "number") return written({ number: value });
  if (typeof value === "string") return named(value);
  if (Array.isArray(value)) {
    const parts = value.map(told);
    return value.some((part) => part?.key) ? parts.join(sign("; ")) : new Intl.ListFormat(language.get()).format(parts);
  }
  if ("number" in value) return written(value);
  if ("effect" in value) return effectWord(value.effect);
  if ("unit" in value) return symbols(value.unit);
  if ("label" in value) return labelled(value.label);
  return t(`workbench.caption.${value.key}`, Object.fromEntries(Object.entries(value.values).map(([name, part]) => [name, told(part)])));
}

/** The caption of an answer. */
export const caption = ({ said, words }) => (said ? said.map(told).join(sign(" ")) : words ?? "");

/** A label of a figure: the parts that have a word in it, and units; names stay. */
export const labelled = (text) =>
  text.split("<br>").map((line) => line.split(", ").map((part) => {
    const [, name, unit] = part.match(NAMED);
    const [, whose, axis] = name.match(/^(rate)_([xyz])$/) ?? [];
    const word = axis ? `${labelled(whose)} ${axis}` : known(`figure.label.${name}`) ? t(`figure.label.${name}`) : UNNAMED.test(name) ? t("figure.label.model") : name;
    return unit ? `${word}${word && " "}[${symbols(unit)}]` : word;
  }).join(sign(", "))).join("<br>");

/** A title of an axis that shares its side with others; a long one in two lines. */
const stacked = ({ domain: [low, high] = [0, 1] }, text) => (high - low < 0.5 && text.length > MOST_IN_LINE ? text.replace(" [", "<br>[") : text);

const titled = (holder) => (holder?.title?.text ? { ...holder, title: { ...holder.title, text: stacked(holder, labelled(holder.title.text)) } } : holder);

/** Quantity and value of an axis below the mouse, to four digits with its unit. */
function hovered(axis, side) {
  const [, name, unit] = (axis?.title?.text ?? "").split(/<br>|, /)[0].match(NAMED);
  const value = axis?.type === "category" || !unit ? `%{${side}}` : `%{${side}:.4~r}`;
  return `${name ? `${labelled(name)} ` : ""}${value}${unit ? ` ${symbols(unit)}` : ""}`;
}

const nameOf = ({ name = "", meta }) => (meta === "station" ? stationName(name) : meta === "effect" && known(`workbench.effect.${name}`) ? effectWord(name) : known(`units.q.${name}`) ? quantityWord(name) : planTitle({ id: name, title: UNNAMED.test(name) ? labelled(name) : labelled(named(name)) }));

function spokenTrace(trace, layout) {
  const axes = { x: layout[`xaxis${(trace.xaxis ?? "x").slice(1)}`], y: layout[`yaxis${(trace.yaxis ?? "y").slice(1)}`] };
  const next = { ...trace, name: nameOf(trace) };
  if (trace.colorbar) next.colorbar = titled(trace.colorbar);
  if (trace.marker?.colorbar) next.marker = { ...trace.marker, colorbar: titled(trace.marker.colorbar) };
  if (trace.hoverinfo === "skip") return next;
  const z = trace.z ? `<br>%{z:.3~r} ${symbols((trace.colorbar?.title?.text ?? "").match(/\[(.*)\]/)?.[1] ?? "")}` : "";
  next.hovertemplate = `${hovered(axes.x, "x")}<br>${hovered(axes.y, "y")}${z}<extra>${z ? "" : next.name}</extra>`;
  return next;
}

/** Ticks of a date, the same in every language; plotly's own have English months. */
const DATES = [{ dtickrange: [null, 6e4], value: "%H:%M:%S\n%Y-%m-%d" }, { dtickrange: [6e4, 864e5 - 1], value: "%H:%M\n%Y-%m-%d" }, { dtickrange: [864e5, null], value: "%Y-%m-%d" }];

/** A moment (ISO 8601) by the reader's clock, without its zone: plotly draws what is written. */
const local = (iso) => {
  const moment = new Date(iso);
  return new Date(moment.getTime() - moment.getTimezoneOffset() * 60000).toISOString().slice(0, -1);
};

/** A figure over dates by the reader's clock. */
function dated({ data, layout }) {
  if (layout.xaxis?.type !== "date") return { data, layout };
  const xaxis = { ...layout.xaxis, title: undefined, range: layout.xaxis.range?.map(local) };
  return { data: data.map((trace) => ({ ...trace, x: trace.x.map(local) })), layout: { ...layout, xaxis } };
}

/** What names a unit's point in a figure of many, "serial · lot · station · day", with the words for lot and station. */
export function pointName(text) {
  const [serial, lot, station, ...day] = text.split(" · ");
  return day.length === 1 ? [serial, lotName(lot, []), stationName(station), ...day].join(" · ") : text;
}

/** A figure with titles, legend and labels in the language of the page, and dates by the reader's clock. */
export function spokenTitles(figure) {
  const { data, layout } = dated(figure);
  return { data: data.map((trace) => ({ ...trace, name: nameOf(trace), text: trace.text?.map(pointName) })), layout: spokenLayout(layout) };
}

function spokenLayout(layout) {
  const { decimal, group } = separators();
  const said = { ...layout, separators: decimal + group, hoverlabel: { ...layout.hoverlabel, namelength: -1 } };
  for (const key of Object.keys(layout).filter((name) => /^[xy]axis\d*$/.test(name))) {
    said[key] = titled(layout[key]);
    if (layout[key].type === "date") said[key] = { ...said[key], tickformatstops: DATES };
    if (layout[key].ticktext) said[key] = { ...said[key], ticktext: layout[key].ticktext.map((text) => text.replace(".", decimal)) };
  }
  if (layout.annotations) said.annotations = layout.annotations.map((one) => ({ ...one, text: labelled(one.text) }));
  return said;
}

/** The same with what is said below the mouse. */
export const spoken = ({ data, layout }) => ({ data: data.map((trace) => spokenTrace(trace, layout)), layout: spokenLayout(layout) });
