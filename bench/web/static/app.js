// The page: its bar, and which page stands below it. Pages are fetched when they are wanted.
import { html, render, useEffect, useErrorBoundary, useState } from "./vendor/preact.js";
import { Bar } from "./lib/bar.js";
import { get } from "./lib/api.js";
import { Busy, Trouble } from "./lib/parts.js";
import { here, match, navigate, takeLinks } from "./lib/router.js";
import { session, useStore } from "./lib/store.js";
import { language, speak, t } from "./lib/words.js";

// Address, module below pages/, key of the title. A page's default export is a component; it gets {params, query}.
const ROUTES = [
  ["/", "start", "nav.start"],
  ["/start", "start", "nav.start"],
  ["/live", "live", "nav.live"],
  ["/live/:unit/:run", "live", "nav.live"],
  ["/verdict/:unit/:run", "verdict", "verdict.title"],
  ["/workbench", "workbench/main", "nav.workbench"],
  ["/workbench/*", "workbench/main", "nav.workbench"],
  ["/units", "units", "nav.units"],
  ["/units/:serial", "unit", "nav.units"],
  ["/fleet", "fleet", "nav.fleet"],
  ["/import", "import", "nav.import"],
  ["/login", "login", "login.title"],
];

const modules = new Map();

/** The module of a page, fetched once; a failure is not remembered. */
function fetched(name) {
  if (!modules.has(name)) {
    const loading = import(`./pages/${name}.js`).catch((error) => {
      modules.delete(name);
      throw error;
    });
    modules.set(name, loading);
  }
  return modules.get(name);
}

function usePage(name) {
  const [state, setState] = useState({});
  const load = () => {
    fetched(name).then(
      (module) => setState({ name, Page: module.default }),
      (error) => setState({ name, error }),
    );
  };
  useEffect(load, [name]);
  return { ...(state.name === name ? state : {}), reload: load };
}

function Place({ route, place }) {
  const [broken, mend] = useErrorBoundary((error) => console.error(error));
  const { Page, error, reload } = usePage(route.page);
  useEffect(() => {
    document.title = `${t(route.title)} · ${t("brand")}`;
  });
  useEffect(() => mend(), [place.path]);
  if (broken || error) return html`<div class="page"><${Trouble} error=${broken ?? error} retry=${broken ? mend : reload} /></div>`;
  if (!Page) return html`<div class="page"><${Busy} /></div>`;
  return html`<${Page} key=${route.page} params=${route.params} query=${place.query} />`;
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

/** The server may be just starting: try until it answers. */
async function insist() {
  try {
    await begin();
  } catch (error) {
    console.error(error);
    root.textContent = `The bench does not answer (${error.message}); trying again …`;
    setTimeout(insist, 1000);
  }
}

insist();
