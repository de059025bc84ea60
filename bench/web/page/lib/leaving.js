// Changes that are not saved: whoever leaves them is asked first.
import { Dialog } from "./parts.js";
import { html, useEffect, useRef } from "./preact.js";
import { asked, hold, leave } from "./router.js";
import { useStore } from "./store.js";
import { t } from "./words.js";

/** A form of the page has `changed`: the page is not left without a question. */
export function useUnsaved(changed) {
  const form = useRef(null);
  useEffect(() => {
    hold(form, changed);
    return () => hold(form, false);
  }, [changed]);
}

/** `take` what was chosen in place of `before`, when the person has agreed to lose changes. */
export function choose(event, before, take) {
  const next = event.target.value;
  event.target.value = before;
  leave(() => take(next));
}

/** The question; to stay has the focus, and Escape stays. */
export function Leaving() {
  const way = useStore(asked);
  const close = () => asked.set(null);
  return way && html`<${Question} close=${close} go=${() => {
    close();
    way.go();
  }} />`;
}

function Question({ close, go }) {
  const stay = useRef(null);
  useEffect(() => stay.current.focus(), []);
  return html`<${Dialog} label=${t("leaving.question")} onClose=${close}>
    <h2>${t("leaving.question")}</h2>
    <div class="dialog-row">
      <button type="button" ref=${stay} onClick=${close}>${t("leaving.stay")}</button>
      <button type="button" class="stop" onClick=${go}>${t("files.back")}</button>
    </div>
  <//>`;
}
