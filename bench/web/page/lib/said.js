// A text of the bench in the reader's language.
import { html } from "./preact.js";
import { store, useStore } from "./store.js";
import { language } from "./words.js";

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

/** `text` in the reader's language; marked as English where it stays so. */
export function Said({ text }) {
  const known = useStore(sentences);
  const spoken = useStore(language);
  if (!text || spoken === "en") return text?.replaceAll(" +- ", " ± ");
  if (!asked) fetchThem();
  return known?.told(text, spoken) ?? html`<span lang="en">${text}</span>`;
}
