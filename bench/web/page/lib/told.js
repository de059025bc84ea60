// What the bench says in English (findings, errors, events), in another language. Fetched with its sentences when it is wanted.
import all from "../../../base/words/told.json" with { type: "json" };
import { or } from "./words.js";

/** Where a text of several sentences is cut, what joins it in Chinese. */
const JOINTS = [["; ", "；"], [". ", "。"], [": ", "："], [", ", "，"], [" and ", "和"], [" or ", "或"]];
const AND = { " and ": " і ", " or ": " або " };
const COLUMN = { uk: 0, zh: 1 };
const seen = new Map();

const escaped = (text) => text.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");

const PLACES = { text: "[^]+?", lost: "[^]+?", serial: "\\S+?" };

/** English with places `{name}` as a pattern. A place ends where a sentence does; `{text}` takes all, `{serial}` one word. */
function pattern(english) {
  const parts = english.split(/\{(\w+)\}/);
  const source = parts.map((part, i) => (i % 2 ? `(?<${part}>${PLACES[part] ?? "(?:(?![;.] )[^])+?"})` : escaped(part))).join("");
  return { regex: new RegExp(`^${source}$`), weight: parts.filter((_, i) => i % 2 === 0).join("").length };
}

const sentences = Object.entries(all).map(([english, own]) => ({ ...pattern(english), own }));
sentences.sort((one, other) => other.weight - one.weight);

/** A number or a name with an underscore, as the language writes it; null for any other text. */
function plain(text, spoken) {
  if (/^[-+−]?\d+(\.\d+)?([eE][-+]?\d+)?$/.test(text)) return (spoken === "uk" ? text.replace(".", ",") : text).replace("-", "−");
  if (/^[-+−]?\d/.test(text) && text.includes(" ")) {
    const parts = text.split(" ").map((part) => plain(part, spoken) ?? tell(part, spoken) ?? (/^[-+−±…\d]/.test(part) ? part : null));
    return parts.includes(null) ? null : parts.join(" ");
  }
  return or(`workbench.effect.${text}`, null) ?? or(`import.channel.${text}`, null);
}

function found(text, spoken) {
  const own = plain(text, spoken);
  if (own !== null) return own;
  for (const { regex, own: words } of sentences) {
    const match = text.match(regex);
    if (match) return words[COLUMN[spoken]].replace(/\{(\w+)\}/g, (_, name) => tell(match.groups[name], spoken) ?? match.groups[name]);
  }
  for (const [joint, chinese] of JOINTS) {
    if (!text.includes(joint)) continue;
    const parts = text.split(joint);
    const pieces = parts.map((part) => tell(part, spoken));
    if (pieces.some((one) => one !== null)) return pieces.map((one, i) => one ?? parts[i]).join(spoken === "zh" ? chinese : AND[joint] ?? joint);
  }
  if (text.length > 1 && text.endsWith(".")) {
    const bare = tell(text.slice(0, -1), spoken);
    return bare === null ? null : bare + (spoken === "zh" ? "。" : ".");
  }
  return null;
}

function tell(text, spoken) {
  const key = `${spoken} ${text}`;
  if (!seen.has(key)) {
    if (seen.size > 5000) seen.clear();
    seen.set(key, found(text, spoken));
  }
  return seen.get(key);
}

/** The text in a language; null where no sentence of it is known. */
export const told = (text, spoken) => (spoken in COLUMN ? tell(text, spoken) : null);
