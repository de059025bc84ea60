// Going on with a run that was cut off: what that does, and the button.
import { html, useState } from "../../lib/preact.js";
import { url } from "../../lib/api.js";
import { Busy, Trouble } from "../../lib/parts.js";
import { navigate } from "../../lib/router.js";
import { startRun } from "../../lib/starts.js";
import { may } from "../../lib/store.js";
import { t } from "../../lib/words.js";
import { operatorOf } from "../start/operator.js";

export function GoOn({ run }) {
  const [state, setState] = useState(/** @type {{busy?: boolean, error?: any}} */ ({}));
  if (!may("operator")) return null;
  const resume = async () => {
    setState({ busy: true });
    try {
      const [unit, folder] = run.split("/");
      navigate(`/live/${await startRun(url`/runs/${unit}/${folder}/resume`, operatorOf())}`);
      setState({});
    } catch (error) {
      setState({ error });
    }
  };
  return html`<div class="stack"><${Trouble} error=${state.error} />
    <div class="row"><button type="button" class="go" disabled=${state.busy} onClick=${resume}>${t("actions.resume")}</button>
      ${state.busy ? html`<${Busy}>${t("ready.starting_long")}<//>` : html`<span class="soft">${t("live.cut_off")}</span>`}</div></div>`;
}
