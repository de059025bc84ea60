// Going on with a run that was cut off: what that does, and the button.
import { html, useState } from "../../lib/preact.js";
import { url } from "../../lib/api.js";
import { Busy, Trouble } from "../../lib/parts.js";
import { navigate } from "../../lib/router.js";
import { startRun } from "../../lib/starts.js";
import { may, store, useStore } from "../../lib/store.js";
import { t } from "../../lib/words.js";
import { operatorOf } from "../start/operator.js";

/** Why a run could not go on: it has an end then, and is shown on another page. */
const refused = store(/** @type {{run?: string, error?: any}} */ ({}));

/** Whether the page has this button for a live run. */
export const isResumed = (run) => run.condition === "gone" && !run.job && may("operator");

export function GoOn({ run }) {
  const [busy, setBusy] = useState(false);
  const why = useStore(refused);
  if (!may("operator")) return null;
  const resume = async () => {
    setBusy(true);
    refused.set({});
    try {
      const [unit, folder] = run.split("/");
      navigate(`/live/${await startRun(url`/runs/${unit}/${folder}/resume`, operatorOf())}`);
    } catch (error) {
      refused.set({ run, error });
    }
    setBusy(false);
  };
  return html`<div class="stack"><${Trouble} error=${why.run === run ? why.error : null} />
    <div class="row"><button type="button" class="go" disabled=${busy} onClick=${resume}>${t("actions.resume")}</button>
      ${busy ? html`<${Busy}>${t("ready.starting_long")}<//>` : html`<span class="soft">${t("live.cut_off")}</span>`}</div></div>`;
}
