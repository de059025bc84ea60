// A text of the bench in the reader's language.
import { html } from "./preact.js";
import { runName } from "./names.js";
import { store, useStore } from "./store.js";
import { language, or, t, unbroken } from "./words.js";

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

/** What the page has in place of an option of a command, by the words of its field. */
const FIELDS = {
  check: "workbench.role.check", static: "workbench.role.static", sister: "workbench.role.sister", output: "workbench.chosen.output",
  limits: "verdict.head.limits", draft: "run.certificate.draft", laboratory: "papers.title", equipment: "papers.title",
};

/** Advice to somebody at a command line as it helps at the page: fields in place of options; a command says where it is given. */
export const advised = (text) =>
  text.replace(/`(bench [^`]+)`|(?<![\w-])--([a-z]+(?:-[a-z]+)*)/g, (option, command, name) => {
    const field = or(FIELDS[name], null);
    return command ? t("said.command", { command }) : field ? `“${field}”` : t("said.option", { option });
  }).replace(/`([^`]+)`/g, "“$1”");

/** Negative numbers with a true minus, as in the figures; what is to be typed (`…`), names, dates and exponents stay. */
export const signed = (text) => text.replace(/`[^`]*`|(?<![\w.,/+:–−-])-(?=\d)/g, (found) => (found === "-" ? "−" : found));

/** A run that is named by its folder, but for one in what is to be typed. */
const FOLDER = /`[^`]*`|(?<![\w./-])[^\s/:;,()“«`：；，。（）]+\/\d{8}T\d{6}Z_[^\s/:;,()”»`：；，。（）]+(?!\w)/g;
export const runsNamed = (text) => text.replace(FOLDER, (found) => (found[0] === "`" ? found : runName(found)));

const shown = (text, whole, names) => text && unbroken(advised(runsNamed(signed(whole ? sentence(text, names) : text))));

/** A finding as a sentence: a plain word at its begin is capital, but none of the user's `names`, and it ends. */
export const sentence = (text, names = []) =>
  text.replace(/^\p{Ll}[\p{Ll}’'-]*(?=[ ,])/u, (word) => (names.includes(word) ? word : word[0].toUpperCase() + word.slice(1))).replace(/[^.!?…。]$/, language.get() === "zh" ? "$&。" : "$&.");

/** `text` in the reader's language, `whole` as a sentence, which keeps the user's `names`; marked as English where it stays so. */
export function Said({ text, whole = false, names = [] }) {
  const known = useStore(sentences);
  const spoken = useStore(language);
  if (!text || spoken === "en") return shown(text && english(text), whole, names);
  if (!asked) fetchThem();
  return shown(known?.told(text, spoken), whole, names) ?? html`<span lang="en">${shown(english(text), whole, names)}</span>`;
}

/** A name or text that people may have written, that of a `segment`, then as they wrote it; one that the bench writes, too, in the reader's language. */
export function Written({ text, segment = false }) {
  const known = useStore(sentences);
  const spoken = useStore(language);
  if (text && spoken !== "en" && !asked) fetchThem();
  return text && (known?.ofBench(text, spoken, segment) ?? signed(text));
}
