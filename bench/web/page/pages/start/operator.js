// The operator's name, where nobody has to sign in.
import { html } from "../../lib/preact.js";
import { remembered, session, useStore } from "../../lib/store.js";
import { t } from "../../lib/words.js";

const name = remembered("operator", "");

/** What a request says of the operator; nothing where somebody signed in. */
export const operatorOf = () => (session.get()?.open && name.get().trim() ? { operator: name.get().trim() } : {});

export function OperatorField() {
  const now = useStore(name);
  if (!session.get()?.open) return null;
  return html`<div class="field"><label for="operator">${t("ready.operator")}</label>
    <input id="operator" value=${now} maxlength="80" autocomplete="name" placeholder=${session.get().name ?? ""} onInput=${(event) => name.set(event.target.value)} /></div>`;
}
