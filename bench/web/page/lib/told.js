// What the bench says in English (findings, errors, events), in another language. Fetched with its sentences when it is wanted.
// `rules` of told.json say how a text is cut and found; bench/base/language.py reads the same.
import all from "../../../base/words/told.json" with { type: "json" };
import { or } from "./words.js";

const { rules, sentences: known } = all;
const whole = (source) => new RegExp(`^(?:${source})$`);
const [NUMBER, MEASURED, BARE] = [rules.number, rules.measured, rules.bare].map(whole);
const PLACE = /\{(\w+)\}/g;
const TIGHT = new RegExp(rules.tight, "g");
const seen = new Map();

const escaped = (text) => text.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");

/** English with places `{name}` as a pattern. */
function pattern(english) {
  const parts = english.split(/\{(\w+)\}/);
  const source = parts.map((part, i) => (i % 2 ? `(?<${part}>${rules.places[part] ?? rules.places[""]})` : escaped(part))).join("");
  return { regex: whole(source), weight: parts.filter((_, i) => i % 2 === 0).join("").length };
}

const sentences = Object.entries(known).map(([english, own]) => ({ ...pattern(english), at: english.startsWith("{at}: "), own }));
// First what follows the name of a file: no other sentence may take the name for a part of itself.
sentences.sort((one, other) => Number(other.at) - Number(one.at) || other.weight - one.weight);

/** A number or a name with an underscore, as the language writes it; null for any other text. */
function plain(text, column) {
  if (NUMBER.test(text)) return text.replaceAll(",", rules.thousands[column]).replace(".", rules.decimal[column]).replace("-", "−");
  if (MEASURED.test(text)) {
    const parts = text.split(" ").map((part) => tell(part, column) ?? (BARE.test(part) ? part : null));
    return parts.includes(null) ? null : parts.join(" ").replace(TIGHT, "");
  }
  return named(text)?.replace(/^\p{Lu}(?!\p{Lu})/u, (letter) => letter.toLowerCase()) ?? null; // in a sentence
}

/** An effect or a channel by its name. */
const named = (text) => or(`workbench.effect.${text}`, null) ?? or(`import.channel.${text}`, null);

/** Whether a person wrote what stands at a place. */
const peoples = (name, value) => rules.kept.includes(name) || (name in rules.own && !whole(rules.own[name]).test(value));

/** What stands at a place: a list has the language's own joint, and no other change. */
function toldAt(name, value, column) {
  const [joint, ...own] = rules.lists[name] ?? [];
  return joint ? value.replaceAll(joint, own[column]) : tell(value, column);
}

function found(text, column) {
  if (Object.hasOwn(known, text)) return known[text][column]; // in a sentence a channel has no capital letter
  const own = plain(text, column);
  if (own !== null) return own;
  const bare = text.length > 1 && text.endsWith(".") ? tell(text.slice(0, -1), column) : null;
  if (bare !== null) return bare + rules.stop[column];
  for (const { regex, own: words } of sentences) {
    const match = text.match(regex);
    if (!match) continue;
    const given = Object.entries(match.groups ?? {}).map(([name, value]) => [name, peoples(name, value) ? null : toldAt(name, value, column), value]);
    const values = Object.fromEntries(given.map(([name, one, value]) => [name, one ?? value]));
    // Words that are only the places say nothing where nothing at them is known.
    if (given.some(([, one]) => one !== null) || !given.length || /\p{L}|\d/u.test(words[column].replace(PLACE, ""))) return words[column].replace(PLACE, (_, name) => values[name]);
  }
  for (const [joint, ...joined] of rules.joints) {
    const at = text.indexOf(joint);
    if (at < 0) continue;
    const parts = [text.slice(0, at), text.slice(at + joint.length)]; // a sentence behind it may have the same sign in it
    const pieces = parts.map((part) => tell(part, column));
    if (pieces.some((one) => one !== null)) return pieces.map((one, i) => one ?? parts[i]).join(joined[column]);
  }
  return null;
}

function tell(text, column) {
  const key = `${column} ${text}`;
  if (!seen.has(key)) {
    if (seen.size > 5000) seen.clear();
    seen.set(key, found(text, column));
  }
  return seen.get(key);
}

/** The text in a language; null where no sentence of it is known. */
export const told = (text, spoken) => (spoken in rules.columns ? named(text) ?? tell(text, rules.columns[spoken]) : null);

const MEANT = new RegExp(`^(?:${rules.number}|${rules.measured}|${rules.bare})$`);

/** The text in a language, where it is as a whole one that the bench writes, with nothing but numbers at its places; null for one that people wrote: a `segment` of the bench is no mere word. */
export function ofBench(text, spoken, segment = false) {
  if (segment && !whole(rules.segment).test(text)) return null;
  const one = sentences.map(({ regex }) => text.match(regex)).find(Boolean);
  return Object.hasOwn(known, text) || (one && Object.values(one.groups ?? {}).every((value) => MEANT.test(value))) ? told(text, spoken) : null;
}
