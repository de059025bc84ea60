// Signing in with a token; the server keeps the identity in a cookie that scripts cannot read.
import { html, useEffect, useRef, useState } from "../lib/preact.js";
import { post } from "../lib/api.js";
import { Trouble } from "../lib/parts.js";
import { navigate } from "../lib/router.js";
import { session, useStore } from "../lib/store.js";
import { t } from "../lib/words.js";

/** Only addresses of this page, not of other sites. */
const inside = (address) => (/^\/(?![/\\])/.test(address ?? "") && address !== "/login" ? address : "/");

export default function Login({ query }) {
  const field = useRef(null);
  const who = useStore(session);
  const [error, setError] = useState(null);
  const [busy, setBusy] = useState(false);
  useEffect(() => {
    if (who?.role) navigate(inside(query.next), { replace: true });
    else field.current?.focus();
  }, [who?.role]);
  const submit = async (event) => {
    event.preventDefault();
    setBusy(true);
    setError(null);
    try {
      session.set(await post("/session", { token: field.current.value.trim() }));
    } catch (problem) {
      setError(problem.status === 401 ? { message: t("login.wrong") } : problem);
      field.current.select();
    }
    setBusy(false);
  };
  return html`<div class="login"><form class="panel" onSubmit=${submit}>
    <h1>${t("login.title")}</h1>
    <p class="soft">${t("login.text")}</p>
    <label for="token">${t("login.token")}</label>
    <input id="token" ref=${field} type="password" autocomplete="current-password" required maxlength="200" />
    <${Trouble} error=${error} />
    <button type="submit" class="primary" disabled=${busy}>${t("login.enter")}</button>
  </form></div>`;
}
