// What the bench says in English (findings, errors, events), in the reader's language. Its sentences are in told.json.
import { html } from "./preact.js";
import { store, useStore } from "./store.js";
import { language, or } from "./words.js";

/** Where a text of several sentences is cut, what joins it in Chinese. */
const JOINTS = [["; ", "；"], [". ", "。"], [": ", "："], [", ", "，"], [" and ", "和"], [" or ", "或"]];
const AND = { " and ": " і ", " or ": " або " };
const COLUMN = { uk: 0, zh: 1 };
const sentences = store(/** @type {any[] | null} */ (null));
let loading = /** @type {Promise<any> | null} */ (null);
const seen = new Map();

const escaped = (text) => text.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");

const PLACES = { text: "[^]+?", lost: "[^]+?", serial: "\\S+?" };

/** English with places `{name}` as a pattern. A place ends where a sentence does; `{text}` takes all, `{serial}` one word. */
function pattern(english) {
  const parts = english.split(/\{(\w+)\}/);
  const source = parts.map((part, i) => (i % 2 ? `(?<${part}>${PLACES[part] ?? "(?:(?![;.] )[^])+?"})` : escaped(part))).join("");
  return { regex: new RegExp(`^${source}$`), weight: parts.filter((_, i) => i % 2 === 0).join("").length };
}

async function load() {
  const { default: all } = await import("../../../base/words/told.json", { with: { type: "json" } });
  const made = Object.entries(all).map(([english, own]) => ({ ...pattern(english), own }));
  sentences.set(made.sort((one, other) => other.weight - one.weight));
}

/** Fetch the sentences once; again where that failed. */
export const ready = () => (loading ??= load().catch(() => (loading = null)));

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
  for (const { regex, own: words } of sentences.get()) {
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

/** The text in a language; null where no sentence of it is known, or before the sentences are here. */
export function told(text, spoken = language.get()) {
  if (!(spoken in COLUMN) || !text) return null;
  ready();
  return sentences.get() && tell(text, spoken);
}

/** A text of the bench in the reader's language; marked as English where it stays so. */
export function Said({ text }) {
  useStore(sentences);
  const spoken = useStore(language);
  if (!text || spoken === "en") return text;
  return told(text, spoken) ?? html`<span lang="en">${text}</span>`;
}
