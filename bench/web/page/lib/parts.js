// Small components that several pages use.
import { html, useEffect, useLayoutEffect, useRef } from "./preact.js";
import { t } from "./words.js";
import { Said } from "./said.js";
import { live } from "./live.js";

/* Shapes that show a state without colour: circle, triangle, octagon, square, ring. */
const SHAPES = {
  good: html`<circle cx="12" cy="12" r="10" fill="currentColor" /><path class="cut" d="M7 12.5l3.5 3.5L17 9" />`,
  warn: html`<path d="M12 1.5 23 21.5H1z" fill="currentColor" /><path class="cut" d="M12 8.5v6M12 17.5v1" />`,
  bad: html`<path d="M7.5 1h9L23 7.5v9L16.5 23h-9L1 16.5v-9z" fill="currentColor" /><path class="cut" d="M8 8l8 8M16 8l-8 8" />`,
  idle: html`<rect x="3" y="3" width="18" height="18" rx="3" fill="currentColor" /><path class="cut" d="M8 12h8" />`,
  link: html`<circle cx="12" cy="12" r="8.5" fill="none" stroke="currentColor" stroke-width="5" />`,
};

/** The shape of a tone (good, warn, bad, idle, link). */
export const Shape = ({ tone }) => html`<svg class="shape" viewBox="0 0 24 24" aria-hidden="true">${SHAPES[tone]}</svg>`;

/** A state in colour, shape and word. */
export const Lamp = ({ tone, children }) => html`<span class=${`lamp tone-${tone}`}><${Shape} tone=${tone} /><span>${children}</span></span>`;

/** Shown while something is loading. */
export const Busy = ({ children }) => html`<p class="row" role="status"><span class="spinner"></span>${children ?? t("busy")}</p>`;

/** An error message of the server; without any answer of it, `retry` or `forget` is called when it answers again. */
export function Trouble({ error, retry, forget = retry }) {
  useEffect(() => {
    if (!forget || error?.status !== 0) return undefined;
    let before = live.get().connected;
    return live.subscribe(({ connected }) => {
      const back = connected && before === false;
      before = connected;
      if (back) forget();
    });
  }, [error]);
  return error && html`<div class="notice bad" role="alert">
    <p><${Said} text=${error.message ?? String(error)} whole /></p>
    ${retry && html`<p><button class="narrow" onClick=${retry}>${t("error.retry")}</button></p>`}
  </div>`;
}

/** Shown where the address names nothing: a sentence and a way on, an address or what a button does; of a whole page with its `title`. */
export const Unknown = ({ title, what, way, words }) => html`${title && html`<h1>${title}</h1>`}<div class="notice warn" role="alert"><p>${what}</p>
  <p>${typeof way === "string" ? html`<a class="button narrow" href=${way}>${words}</a>` : html`<button type="button" class="narrow" onClick=${way}>${words}</button>`}</p></div>`;

/** A text field: `onGiven(text)` when it is left or at Enter. Until then it keeps what is typed, also while the page is drawn again. */
export function TextField({ value, onGiven, ...rest }) {
  const draft = useRef(null);
  const give = () => {
    const text = draft.current;
    draft.current = null;
    if (text !== null) onGiven(text);
  };
  return html`<input type="text" autocomplete="off" spellcheck="false" ...${rest} value=${draft.current ?? value}
    onInput=${(event) => { draft.current = event.target.value; }} onChange=${give} onBlur=${give} />`;
}

/** A native dialog: focus stays in it, Escape closes it, focus returns to where it was. */
export function Dialog({ onClose, label, children }) {
  const element = useRef(null);
  useEffect(() => {
    element.current.showModal();
  }, []);
  return html`<dialog ref=${element} aria-label=${label} onClose=${onClose}>${children}</dialog>`;
}

/** The field that `choose()` returns has the focus as soon as it is shown, and takes it again when typing (or a scan) starts elsewhere. */
export function useTyping(choose) {
  useLayoutEffect(() => {
    choose().focus();
    const typed = (event) => {
      const elsewhere = !event.target.closest("input, select, textarea, dialog");
      if (elsewhere && event.key.length === 1 && event.key !== " " && !event.ctrlKey && !event.metaKey && !event.altKey) choose()?.focus();
    };
    document.addEventListener("keydown", typed);
    return () => document.removeEventListener("keydown", typed);
  }, []);
}
