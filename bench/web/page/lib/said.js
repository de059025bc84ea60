// A text of the bench in the reader's language.
import { html } from "./preact.js";
import { store, useStore } from "./store.js";
import { language, or } from "./words.js";

const sentences = store(/** @type {any} */ (null));
let asked = false;

async function fetchThem() {
  asked = true;
  try {
    sentences.set(await import("./told.js"));
  } catch {
    asked = false; // the next text asks again
  }
}

/** A word of a program (`thermal_lag`) as people say it; any other one, and one in a path or in quotes, as it is. */
const NAME = /(?<![\w/.'"`-])[a-z]+(?:_[a-z]+)+(?![\w/'"`:=-]|\.\w)/g;

/** A name in the midst of a sentence, or at its begin. */
function named(name, at) {
  const word = or(`workbench.effect.${name}`, null) ?? or(`import.channel.${name}`, null);
  return word === null ? name : at === 0 ? word : word[0].toLowerCase() + word.slice(1);
}

/** What the bench writes in plain letters (names, degC, x, +-), as the page writes it. */
export const english = (text) =>
  text.replace(NAME, named).replaceAll(" +- ", " ± ").replace(/(?<=\d )degC\b/g, "°C").replace(/(\d) x(?=[ ,.;)]|$)/g, "$1 ×");

const quoted = (text, whole) => text && (whole ? sentence(text) : text).replace(/`([^`]+)`/g, "“$1”");

/** A finding as a sentence: a plain word at its begin is capital, and it ends. */
export const sentence = (text) => text.replace(/^\p{Ll}[\p{Ll}’'-]*(?=[ ,])/u, (word) => word[0].toUpperCase() + word.slice(1)).replace(/[^.!?…。]$/, language.get() === "zh" ? "$&。" : "$&.");

/** `text` in the reader's language, `whole` as a sentence; marked as English where it stays so. */
export function Said({ text, whole = false }) {
  const known = useStore(sentences);
  const spoken = useStore(language);
  if (!text || spoken === "en") return quoted(text && english(text), whole);
  if (!asked) fetchThem();
  return quoted(known?.told(text, spoken), whole) ?? html`<span lang="en">${quoted(english(text), whole)}</span>`;
}
