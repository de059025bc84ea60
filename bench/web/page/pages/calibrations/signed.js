// Who signed a certificate; a warning where nobody did.
import { html } from "../../lib/preact.js";
import { Lamp } from "../../lib/parts.js";
import { Written } from "../../lib/said.js";
import { sign, t } from "../../lib/words.js";

/** Nothing where it is not known: an older bench did not keep it. */
export function Signed({ signer }) {
  if (signer === undefined) return null;
  if (signer === null) return html`<${Lamp} tone="warn">${t("certificate.unsigned")}<//>`;
  const name = signer.subject.match(/(?:^|,)CN=((?:\\.|[^,\\])+)/)?.[1].replace(/\\(.)/g, "$1");
  return html`${t("certificate.signed")}${sign(": ")}<${Written} text=${name ?? signer.subject} />`;
}
