// All words of the page from one catalogue per language, and numbers in the format of that language.
import { remembered, store } from "./store.js";

/** Languages of the catalogues, each by its native name. */
export const LANGUAGES = { en: "English", uk: "Українська", zh: "中文" };

const chosen = remembered("language", null);
/** The language in use; set when its catalogue is loaded. */
export const language = store("en");
let words = {};

const preferred = () => {
  const known = [chosen.get(), ...navigator.languages.map((name) => name.slice(0, 2).toLowerCase())];
  return known.find((name) => name in LANGUAGES) ?? "en";
};

// Each is a file of its own; its name changes with its words.
const catalogues = {
  en: () => import("../words/en.json", { with: { type: "json" } }),
  uk: () => import("../words/uk.json", { with: { type: "json" } }),
  zh: () => import("../words/zh.json", { with: { type: "json" } }),
};

/** Words that only the workbench, the fleet, a run, its verdict, the files, the import and the laboratory say: no other page waits for them. */
const further = {
  en: () => import("../words/further/en.json", { with: { type: "json" } }),
  uk: () => import("../words/further/uk.json", { with: { type: "json" } }),
  zh: () => import("../words/further/zh.json", { with: { type: "json" } }),
};
let all = false;

/** Fetch the words of a language and use it; without one: of the one chosen before, else the browser's. */
export async function speak(name) {
  if (name) chosen.set(name);
  const next = name ?? preferred();
  const parts = await Promise.all([catalogues[next](), all ? further[next]() : { default: {} }]);
  words = { ...parts[0].default, ...parts[1].default }; // each language has all keys
  document.documentElement.lang = next === "zh" ? "zh-Hans" : next;
  language.set(next);
}

/** Fetch the further words, too. */
export function speakOfAll() {
  all = true;
  return speak();
}

/** The space between a number and its unit or sign. */
const BEFORE_UNIT = /(?<=\d) (?=[°%×±]|(?:h|min|m?s|Hz|V|[KMGT]i?B|deg\/h|год|хв|м?с|Гц|В|[КМГТ]і?Б)(?!\p{L}))|(?<=[×±]) (?=[\p{L}\d])/gu;

/** A text with a value and its unit or sign, and both ends of a range (0…50), in one line. */
export const unbroken = (text) => text.replace(BEFORE_UNIT, "\u00a0").replace(/(?<=\d)[…至](?=[−\d])/g, "\u2060$&\u2060");

/** A text as people type it, to be searched in. */
export const searched = (text) => text.toLowerCase().replaceAll("\u2060", "");

/** A text in one line: no-break spaces for all of its spaces. */
export const inOneLine = (text) => text.replaceAll(" ", "\u00a0");

/**
 * The words of a key with `{name}` replaced by `values.name`; the key where there are none.
 * An entry may be an object of plural forms (one, few, many, other), chosen by `values.n`.
 */
export function t(key, values = {}) {
  let text = words[key] ?? key;
  if (typeof text === "object") text = text[new Intl.PluralRules(language.get()).select(values.n)] ?? text.other;
  return unbroken(text.replace(/\{(\w+)\}/g, (whole, name) => {
    const value = values[name];
    return value === undefined ? whole : typeof value === "number" ? number(value) : value;
  }));
}

/** Whether the catalogue has this key. */
export const known = (key) => key in words;

/** The words of a key, or a default. */
export const or = (key, otherwise) => (known(key) ? t(key) : otherwise);

/** Name of a channel; an axis or a further one has its letter or number behind it. Without words its own name. */
export function channelWord(name) {
  const [, family, end] = name.match(/^(.+)_([xyz\d])$/) ?? [];
  return or(`import.channel.${name}`, family ? `${channelWord(family)} ${end}` : name.replaceAll("_", " "));
}

/** Name of an effect: "thermal lag" for `thermal_lag`; one that is not in the catalogue keeps its name. */
export const effectWord = (name) => or(`workbench.effect.${name}`, /^\w+$/.test(name) ? name.replaceAll("_", " ") : name);

/** Names of effects that stand together (`hysteresis + aging`); a formula as it is. */
export const effectsWord = (text) => {
  const parts = text.split(" + ");
  return parts.every((part) => known(`workbench.effect.${part}`)) ? parts.map(effectWord).join(" + ") : effectWord(text);
};

/** Name of a quantity that is measured or judged; `of` a verification it may have another one. */
export const quantityWord = (name, of = "") => (of && or(`units.q.${name}.${of}`, "")) || or(`units.q.${name}`, name.replaceAll("_", " "));

/** A unit (deg/h/degC) with the symbols of the language; nothing for a plain number. */
export const symbols = (unit) =>
  unit === "1" ? "" : or(`symbol.${unit}`, (unit ?? "").replace(/sqrt\((\w+)\)/g, "√$1").replace(/\^([2-5])/g, (_, power) => "²³⁴⁵"[power - 2]).replace(/[A-Za-z]+/g, (one) => or(`symbol.${one}`, one)));

/** Signs that stand between parts of a text where they are not those of English: wide ones have their space in them. */
const SIGNS = { zh: { ", ": "，", "; ": "；", ": ": "：", " (": "（", ")": "）", " ": "", " %": "%" } };

/** A sign between parts of a text (`, ` `; ` `: ` …) as the language writes it. */
export const sign = (mark) => SIGNS[language.get()]?.[mark] ?? mark;

/** A list in one line: A, B, C. */
export const joined = (parts) => new Intl.ListFormat(language.get(), { style: "narrow" }).format(parts);

const formatters = new Map();

/** A number format of the language in use, made once: a live page writes hundreds of numbers per second. */
function formatter(options) {
  const key = `${language.get()} ${Object.entries(options).join(" ")}`;
  if (!formatters.has(key)) formatters.set(key, new Intl.NumberFormat(language.get(), options));
  return formatters.get(key);
}

const MINUS = /^-(?=[\d.,]*[1-9])/;

/** A number with fixed decimals and a real minus sign, but not before zero; a dash when it is unknown. */
export function number(value, decimals) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const digits = decimals === undefined ? { maximumFractionDigits: 3 } : { minimumFractionDigits: decimals, maximumFractionDigits: decimals };
  const text = formatter({ ...digits, useGrouping: Math.abs(value) >= 1e4 }).format(value);
  return text.replace(MINUS, "−").replace(/^-/, "");
}

/** A number as it was given (a limit, a sample), without zeros at its end; a dash when there is none. */
export function asGiven(value, digits = 12) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return formatter({ maximumSignificantDigits: digits, useGrouping: Math.abs(value) >= 1e4 }).format(value).replace(MINUS, "−").replace(/^-/, "");
}

/** A measured value to so many significant digits, zeros at its end too, whole numbers as they are; a dash when there is none. */
export function sig(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const power = size ? Math.floor(Math.log10(size)) : 0;
  const far = power < -4 || power >= 6;
  const whole = Number.isInteger(value);
  const text = far ? number(value / 10 ** power, whole ? undefined : digits - 1) : number(value, whole ? 0 : Math.max(0, digits - 1 - power));
  return far ? `${text}·10${String(power).replace(/[-0-9]/g, (one) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(one)])}` : text;
}

/** A temperature with its unit. */
export const degrees = (value, decimals = 1) => `${number(value, decimals)}\u00a0°C`;

const lasting = (key, values) => inOneLine(t(key, values));

/** A time of seconds, at most two units of it: 3 h 05 min, 4 min 20 s, 12 s. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  const whole = Math.max(0, Math.round(seconds));
  if (whole < 60) return lasting("time.s", { s: String(whole) });
  const two = (value) => String(value).padStart(2, "0");
  if (whole < 3600) return lasting("time.min_s", { min: String(Math.floor(whole / 60)), s: two(whole % 60) });
  const minutes = Math.round(whole / 60);
  return lasting("time.h_min", { h: String(Math.floor(minutes / 60)), min: two(minutes % 60) });
}

/** A time that is expected: from ten minutes on in whole minutes. */
export function forecast(seconds) {
  const rounded = seconds >= 600 ? 60 * Math.round(seconds / 60) : seconds;
  return rounded >= 600 && rounded < 3600 ? lasting("time.min", { min: String(rounded / 60) }) : duration(rounded);
}

/** Both ends of a range in one line; the unit is in the second one. */
export const between = (from, to) => inOneLine(`${from} … ${to}`);

/**
 * A time (ISO 8601) as the language writes it, in one line; a dash for an empty one.
 * @param {Intl.DateTimeFormatOptions} style
 */
function dated(iso, style) {
  const date = new Date(iso);
  if (!iso || Number.isNaN(date.valueOf())) return "–";
  return inOneLine(new Intl.DateTimeFormat(language.get(), style).format(date));
}

/** A day. */
export const day = (iso) => dated(iso, { dateStyle: "medium" });

/** A moment in local time, broken before the time only. */
export const moment = (iso) => dated(iso, { dateStyle: "medium", timeStyle: "short" }).replace(/\u00a0(?=\d+:)/, " ");
