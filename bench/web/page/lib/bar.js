// The bar above every page: navigation, number of live runs, language, light or dark, signed-in user.
import { html, useEffect, useRef, useState } from "./preact.js";
import { get, post, remove } from "./api.js";
import { call, calling } from "./calls.js";
import { useLive } from "./live.js";
import { Dialog, Trouble, useTyping } from "./parts.js";
import { leave, navigate } from "./router.js";
import { badge, session, theme, useStore } from "./store.js";
import { LANGUAGES, language, sign, speak, t } from "./words.js";

const PAGES = [
  ["/", "nav.start", "operator"],
  ["/live", "nav.live", "viewer"],
  ["/calibrations", "nav.calibrations", "viewer"],
  ["/workbench", "nav.workbench", "engineer"],
  ["/units", "nav.units", "viewer"],
  ["/fleet", "nav.fleet", "viewer"],
  ["/import", "nav.import", "engineer"],
  ["/files", "nav.files", "engineer"],
];
const RANK = { viewer: 1, operator: 2, engineer: 3 };

const isHere = (address, path) => (address === "/" ? path === "/" || path === "/start" : path === address || path.startsWith(`${address}/`));

const MOON = html`<path d="M20 14.5A8.5 8.5 0 0 1 9.5 4 8.5 8.5 0 1 0 20 14.5z" fill="none" stroke="currentColor" stroke-width="2" stroke-linejoin="round" />`;
const SUN = html`<circle cx="12" cy="12" r="4.2" fill="none" stroke="currentColor" stroke-width="2" /><path stroke="currentColor" stroke-width="2" stroke-linecap="round" d="M12 2.5v2M12 19.5v2M2.5 12h2M19.5 12h2M5.3 5.3l1.4 1.4M17.3 17.3l1.4 1.4M5.3 18.7l1.4-1.4M17.3 6.7l1.4-1.4" />`;

function Theme() {
  useStore(theme);
  const dark = document.documentElement.dataset.theme === "dark";
  const label = t(dark ? "theme.to_light" : "theme.to_dark");
  return html`<button type="button" aria-label=${label} title=${label} onClick=${() => theme.set(dark ? "light" : "dark")}>
    <svg viewBox="0 0 24 24" aria-hidden="true">${dark ? SUN : MOON}</svg>
  </button>`;
}

const BELL = html`<path d="M6 16.5V11a6 6 0 0 1 12 0v5.5l1.5 2h-15zM10 20.5a2 2 0 0 0 4 0" fill="none" stroke="currentColor" stroke-width="2" stroke-linejoin="round" stroke-linecap="round" />`;
const MUTED = html`<path stroke="currentColor" stroke-width="2" stroke-linecap="round" d="M4 4l16 16" />`;

/** Switches sound and notices on and off. */
function Calls() {
  const on = useStore(calling);
  const label = t("call.label");
  return html`<button type="button" aria-pressed=${on} aria-label=${label} title=${label} onClick=${() => call(!on)}>
    <svg viewBox="0 0 24 24" aria-hidden="true">${BELL}${!on && MUTED}</svg>
  </button>`;
}

function Language() {
  const now = useStore(language);
  return html`<select aria-label=${t("language")} value=${now} onChange=${(event) => speak(event.target.value)}>
    ${Object.entries(LANGUAGES).map(([name, title]) => html`<option key=${name} value=${name} lang=${name} selected=${name === now}>${title}</option>`)}
  </select>`;
}

const again = async () => session.set(await get("/session"));

/** Asks for the PIN; a reader types what is on a badge, and Enter. `Head`: level of its heading. */
export function Pin({ id, children, head: Head = "h2" }) {
  const [error, setError] = useState(null);
  const [wait_s, setWait] = useState(0);
  const field = useRef(null);
  useTyping(() => field.current);
  useEffect(() => {
    const timer = wait_s && setTimeout(() => setWait(wait_s - 1), 1000);
    return () => clearTimeout(timer);
  }, [wait_s]);
  const enter = async (event) => {
    event.preventDefault();
    try {
      const pin = field.current.value.trim();
      await post("/session/pin", { pin });
      await again();
      badge.set(pin);
    } catch (problem) {
      setWait(problem.wait_s);
      setError(problem.wait_s ? null : [401, 422].includes(problem.status) ? t("pin.wrong") : problem);
      field.current.value = "";
      field.current.focus();
    }
  };
  return html`<form class="stack pin" onSubmit=${enter}><${Head}>${t("pin.title")}<//>
    <label for=${id}>${t("pin.field")}</label><input id=${id} ref=${field} type="password" inputmode="numeric" autocomplete="off" maxlength="40" required autofocus />
    <${Trouble} error=${error} />
    ${wait_s > 0 && html`<p class="notice bad" role="alert">${t("pin.many")}${sign(" ")}<span aria-live="off">${t("pin.wait", { n: wait_s })}</span></p>`}
    <div class="dialog-row">${children}<button type="submit" class="primary" disabled=${wait_s > 0}>${t("login.enter")}</button></div></form>`;
}

/** The operator of a screen that is signed in: named by a PIN or a badge, for a while; then the screen is as before. */
function Operator({ who }) {
  const [asked, setAsked] = useState(false);
  useEffect(() => {
    setAsked(false);
    if (!who.pin_s) return undefined;
    const timer = setTimeout(again, 1000 * who.pin_s + 500);
    return () => clearTimeout(timer);
  }, [who]);
  if (who.pin_s) return html`<button type="button" onClick=${() => remove("/session/pin").then(again)}>${t("pin.leave")}</button>`;
  return html`<button type="button" onClick=${() => setAsked(true)}>${t("pin.ask")}</button>
    ${asked && html`<${Dialog} label=${t("pin.title")} onClose=${() => setAsked(false)}><${Pin} id="pin"><button type="button" onClick=${() => setAsked(false)}>${t("pin.back")}</button><//><//>`}`;
}

async function signOut() {
  session.set(await remove("/session"));
  navigate("/login");
}

/** The bar; the stream of live runs is open while it is shown. */
export function Bar({ place, who }) {
  const rank = RANK[who?.role] ?? 0;
  return html`<header class="bar">
      <a class="brand" href="/" aria-label=${t("brand")}><img src="/static/style/icon.svg" alt="" /><span>${t("brand")}</span></a>
      <nav aria-label=${t("nav.label")}>
        ${PAGES.filter(([, , role]) => rank >= RANK[role]).map(([address, key]) => html`
          <a key=${address} href=${address} aria-current=${isHere(address, place.path) ? "page" : undefined}>${t(key)}${address === "/live" && html`<${Count} />`}</a>`)}
      </nav>
      <div class="tools">
        ${who?.name && html`<span class="who" title=${t(`role.${who.role}`)}>${who.name}</span>`}
        ${who?.role && who.pins && html`<${Operator} who=${who} />`}
        ${who?.role && !who.open && !who.pin_s && html`<button type="button" onClick=${() => leave(signOut)}>${t("login.leave")}</button>`}
        <${Language} />${rank > 0 && html`<${Calls} />`}<${Theme} />
      </div>
    </header>
    ${rank > 0 && html`<${Line} />`}`;
}

function Count() {
  const count = useLive((now) => now.runs.length);
  return count > 0 && html`<span class="count"><span class="unseen">${t("nav.live_count", { n: count })}</span><span aria-hidden="true">${count}</span></span>`;
}

/** Shown without a connection: the data is old then, while the runs continue. */
function Line() {
  const connected = useLive((now) => now.connected);
  return html`<div role="status">${connected === false && html`<div class="lost">${t("line.lost")}</div>`}</div>`;
}
