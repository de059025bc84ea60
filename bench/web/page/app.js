// The page: its bar, and the current page below it.
import { html, render, useEffect, useErrorBoundary } from "./lib/preact.js";
import { Bar } from "./lib/bar.js";
import { get } from "./lib/api.js";
import { Trouble } from "./lib/parts.js";
import { here, match, navigate, takeLinks } from "./lib/router.js";
import { session, useStore } from "./lib/store.js";
import { language, speak, t } from "./lib/words.js";
import Fleet from "./pages/fleet.js";
import Import from "./pages/import.js";
import Live from "./pages/live.js";
import Login from "./pages/login.js";
import Start from "./pages/start.js";
import Unit from "./pages/unit.js";
import Units from "./pages/units.js";
import Verdict from "./pages/verdict.js";
import Workbench from "./pages/workbench/main.js";

export { live, traces } from "./lib/live.js"; // what the page knows, for tests and measurements

// Address, component that gets {params, query}, key of the title.
const ROUTES = [
  ["/", Start, "nav.start"],
  ["/start", Start, "nav.start"],
  ["/live", Live, "nav.live"],
  ["/live/:unit/:run", Live, "nav.live"],
  ["/verdict/:unit/:run", Verdict, "verdict.title"],
  ["/workbench", Workbench, "nav.workbench"],
  ["/workbench/*", Workbench, "nav.workbench"],
  ["/units", Units, "nav.units"],
  ["/units/:serial", Unit, "nav.units"],
  ["/fleet", Fleet, "nav.fleet"],
  ["/import", Import, "nav.import"],
  ["/login", Login, "login.title"],
];

function Place({ route, place }) {
  const [broken, mend] = useErrorBoundary((error) => console.error(error));
  const Page = route.page;
  useEffect(() => {
    document.title = `${t(route.title)} · ${t("brand")}`;
  });
  useEffect(() => mend(), [place.path]);
  if (broken) return html`<div class="page"><${Trouble} error=${broken} retry=${mend} /></div>`;
  return html`<${Page} params=${route.params} query=${place.query} />`;
}

function Nowhere({ path }) {
  useEffect(() => {
    document.title = `${t("nowhere.title")} · ${t("brand")}`;
  });
  return html`<div class="page stack">
    <h1>${t("nowhere.title")}</h1><p>${t("nowhere.text", { path })}</p><a class="button" href="/">${t("nav.start")}</a>
  </div>`;
}

function App() {
  const place = useStore(here);
  const who = useStore(session);
  useStore(language);
  const route = match(ROUTES, place.path);
  const locked = who && !who.role && place.path !== "/login";
  useEffect(() => {
    if (locked) navigate(`/login?next=${encodeURIComponent(place.path)}`, { replace: true });
  }, [locked]);
  useEffect(() => {
    scrollTo(0, 0);
    if (place.moved) document.querySelector("main").focus({ preventScroll: true });
  }, [place.path]);
  return html`
    <a class="skip" href="#main">${t("skip")}</a>
    <${Bar} place=${place} who=${who} />
    <main id="main" tabindex="-1">
      ${route ? !locked && html`<${Place} route=${route} place=${place} />` : html`<${Nowhere} path=${place.path} />`}
    </main>`;
}

const root = document.getElementById("app");

async function begin() {
  const [, who] = await Promise.all([speak(), get("/session")]);
  session.set(who);
  takeLinks();
  root.replaceChildren();
  render(html`<${App} />`, root);
}

/** The server may be starting: try until it answers. */
async function insist() {
  try {
    await begin();
  } catch (error) {
    console.error(error);
    root.textContent = "The bench does not answer; trying again …";
    setTimeout(insist, 1000);
  }
}

insist();
