// The page: its bar, and the current page below it.
import { html, render, useEffect, useErrorBoundary, useState } from "./lib/preact.js";
import { Bar } from "./lib/bar.js";
import { ApiError, get } from "./lib/api.js";
import { Leaving } from "./lib/leaving.js";
import { keepFocus } from "./lib/kept.js";
import { live } from "./lib/live.js";
import { Busy, Trouble } from "./lib/parts.js";
import { here, match, navigate, takeLinks } from "./lib/router.js";
import { outcome, session, useStore } from "./lib/store.js";
import { language, speak, speakOfAll, t } from "./lib/words.js";
import { stateWord } from "./pages/live/words.js";

export { live, traces } from "./lib/live.js"; // what the page knows, for tests and measurements

const withAllWords = async (page) => (await Promise.all([page, speakOfAll()]))[0];
const PAGES = {
  calibrations: () => import("./pages/calibrations.js"),
  files: () => withAllWords(import("./pages/files.js")),
  fleet: () => withAllWords(import("./pages/fleet.js")),
  import: () => withAllWords(import("./pages/import.js")),
  laboratory: () => withAllWords(import("./pages/laboratory.js")),
  live: () => import("./pages/live.js"),
  login: () => import("./pages/login.js"),
  run: () => withAllWords(import("./pages/run.js")),
  start: () => import("./pages/start.js"),
  unit: () => import("./pages/unit.js"),
  units: () => import("./pages/units.js"),
  verdict: () => withAllWords(import("./pages/verdict.js")),
  workbench: () => withAllWords(import("./pages/workbench/main.js")),
};
/** Components of the pages that were fetched; each gets {params, query}. */
const fetched = {};
/** The page of the address, which is fetched beside its words and not after them. */
const early = {};

// Address, page, key of the title.
const ROUTES = [
  ["/", "start", "nav.start"],
  ["/start", "start", "nav.start"],
  ["/live", "live", "nav.live"],
  ["/live/:unit/:run", "live", "nav.live"],
  ["/verdict/:unit/:run", "verdict", "verdict.title"],
  ["/runs/:unit/:run", "run", "run.title"],
  ["/files", "files", "files.title"],
  ["/workbench", "workbench", "nav.workbench"],
  ["/workbench/*", "workbench", "nav.workbench"],
  ["/units", "units", "nav.units"],
  ["/units/:serial", "unit", "nav.units"],
  ["/fleet", "fleet", "nav.fleet"],
  ["/calibrations", "calibrations", "nav.calibrations"],
  ["/calibrations/*", "calibrations", "nav.calibrations"],
  ["/laboratory", "laboratory", "papers.title"],
  ["/import", "import", "nav.import"],
  ["/login", "login", "login.title"],
];

/** States of the live runs, for the title of the browser's tab. */
const statesOf = ({ runs }) => [...new Set(runs.map(stateWord))].join(", ");

/** Fetch everything again where the server answers; without it the browser would show a page of its own. */
const reload = () => get("/session").then(() => location.reload(), () => {});
const RELOADED = "bench.reloaded";

/** A page that cannot be fetched may be that of an older server: the newest one is fetched whole, by itself only once. */
function reloadOnce(page) {
  if (sessionStorage.getItem(RELOADED) === page) return;
  sessionStorage.setItem(RELOADED, page);
  reload();
}

function Place({ route, place }) {
  const [broken, mend] = useErrorBoundary((error) => console.error(error));
  const [missing, setMissing] = useState(/** @type {{page?: string, error?: Error}} */ ({}));
  const [, redraw] = useState("");
  const Page = fetched[route.page];
  useEffect(() => {
    if (Page) return;
    const asked = early[route.page] ?? PAGES[route.page]();
    delete early[route.page];
    asked.then(({ default: page }) => {
      fetched[route.page] = page;
      redraw(route.page);
      sessionStorage.removeItem(RELOADED);
    }, () => {
      setMissing({ page: route.page, error: new ApiError(0, t("error.unreachable")) });
      reloadOnce(route.page);
    });
  }, [route.page]);
  const doing = useStore(live, statesOf);
  const word = useStore(outcome);
  useEffect(() => {
    document.title = [...new Set([word, doing, t(route.title), t("brand")])].filter(Boolean).join(" · ");
  });
  useEffect(() => mend(), [place.path]);
  if (broken) return html`<div class="page"><${Trouble} error=${broken} retry=${mend} /></div>`;
  if (!Page) return html`<div class="page">${missing.page === route.page ? html`<${Trouble} error=${missing.error} retry=${reload} />` : html`<${Busy} />`}</div>`;
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
    if (locked) navigate(`/login?next=${encodeURIComponent(location.pathname + location.search)}`, { replace: true });
  }, [locked]);
  useEffect(() => {
    scrollTo(0, 0);
    const taken = document.activeElement?.matches("main input"); // by a field of the new page
    if (place.moved && !taken) document.querySelector("main").focus({ preventScroll: true });
  }, [place.path]);
  return html`
    <a class="skip" href="#main">${t("skip")}</a>
    <${Bar} place=${place} who=${who} />
    <main id="main" tabindex="-1">
      ${route ? !locked && html`<${Place} route=${route} place=${place} />` : html`<${Nowhere} path=${place.path} />`}
    </main>
    <${Leaving} />`;
}

const root = document.getElementById("app");
keepFocus(root);

async function begin() {
  const page = match(ROUTES, here.get().path)?.page;
  if (page) (early[page] = PAGES[page]()).catch(() => {}); // told in its place
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
