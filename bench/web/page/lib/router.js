// Navigation without reloading the page.
import { store } from "./store.js";

const read = (moved) => ({ path: location.pathname, query: Object.fromEntries(new URLSearchParams(location.search)), moved });

/** Current address: {path, query, moved: different from the first one}. */
export const here = store(read(false));

/** Go to an address of this page; `state` is kept with the entry of the history. */
export function navigate(address, { replace = false, state = null } = {}) {
  const same = address === location.pathname + location.search;
  if (same && !state) return;
  history[replace || same ? "replaceState" : "pushState"](state, "", address);
  here.set(read(true));
}

/** Forms with changes that are not saved, and the address of each. */
const unsaved = new Map();

/** What goes on when the person agrees to lose changes; null where nothing is asked. */
export const asked = store(null);

/** Whether a form has changes that leaving the page would lose. */
export function hold(form, changed) {
  if (changed) unsaved.set(form, location.pathname + location.search);
  else unsaved.delete(form);
}

/** Do `go`, which leaves the page; with changes that are not saved only when the person agrees. */
export function leave(go) {
  if (!unsaved.size) return go();
  asked.set({ go() {
    unsaved.clear();
    go();
  } });
  return undefined;
}

/** Keep a state of the page (a filter, a choice) in its address, without a new entry in the history. */
export function remember(query) {
  const entries = Object.entries(query).filter(([, value]) => value !== "" && value !== null && value !== undefined);
  history.replaceState(null, "", location.pathname + (entries.length ? `?${new URLSearchParams(entries)}` : ""));
}

/** A part of a path; undefined where it is not encoded as one. */
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return undefined;
  }
}

/** The route of a path: {page, title, params}; null without one. `:name` is one part, `*` the rest. */
export function match(routes, path) {
  for (const [pattern, page, title] of routes) {
    const params = fits(pattern.split("/"), path.replace(/(.)\/$/, "$1").split("/"));
    if (params) return { page, title, params };
  }
  return null;
}

function fits(pattern, parts) {
  const params = {};
  for (const [index, segment] of pattern.entries()) {
    if (segment === "*") return { ...params, rest: parts.slice(index).join("/") };
    const part = index < parts.length ? decoded(parts[index]) : undefined;
    if (part === undefined) return null;
    if (segment.startsWith(":")) params[segment.slice(1)] = part;
    else if (segment !== part) return null;
  }
  return parts.length === pattern.length ? params : null;
}

/** Links within the page change only the content below the bar. Other links load normally. */
export function takeLinks() {
  document.addEventListener("click", (event) => {
    const target = /** @type {Element} */ (event.target);
    const link = /** @type {HTMLAnchorElement} */ (target.closest?.("a[href]"));
    const ours = link && link.origin === location.origin && !/^\/(api|static)\//.test(link.pathname);
    const plain = event.button === 0 && !event.ctrlKey && !event.metaKey && !event.shiftKey && !event.altKey;
    if (!ours || !plain || event.defaultPrevented || link.target || link.hasAttribute("download")) return;
    if (link.hash && link.pathname === location.pathname) return;
    event.preventDefault();
    leave(() => navigate(link.pathname + link.search));
  });
  addEventListener("popstate", () => {
    if (!unsaved.size) return here.set(read(true));
    history.pushState(null, "", [...unsaved.values()][0]);
    return leave(() => history.back());
  });
  addEventListener("beforeunload", (event) => unsaved.size && event.preventDefault());
}
