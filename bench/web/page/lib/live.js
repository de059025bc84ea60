// State of the live runs: one event stream for the whole page, with bounded traces that are completed after a gap.
import { useEffect } from "./preact.js";
import { get, query, url } from "./api.js";
import { store, useStore } from "./store.js";
import { Trace } from "./trace.js";

const STREAM = "/api/v1/live/stream";
const LINGER_MS = 4000;
const RETRY_MS = [500, 1000, 2000];
/** After this time without a message the connection counts as lost; the server sends one at least every few seconds. */
const SILENT_MS = 12000;
const ENDED_KEPT = 20;

/** {connected: null before the first message, true, false; runs: pictures; ended: {run: its end}; heard_ms}. */
export const live = store({ connected: null, runs: [], ended: {}, heard_ms: 0 });
/** Traces of live runs by their id; changed in place, so draw them when `live` changes. */
export const traces = new Map();

// Chromium keeps a page that is left, for its button `Back`, with its stream, even a closed one: of six connections to a
// server none is left after six pages, and the next page waits. A page that listens to this event is not kept.
addEventListener("unload", () => {});

let users = 0;
let source = null;
let tries = 0;
const timers = { linger: 0, retry: 0, silent: 0 };

/** One timer for the connection of now: that of an earlier one would end a connection that is well. */
function expect() {
  clearTimeout(timers.silent);
  timers.silent = setTimeout(lost, SILENT_MS);
}

function received(change) {
  expect();
  tries = 0;
  live.set((now) => ({ ...now, connected: true, heard_ms: Date.now(), ...change }));
}

/** The last report of a run is outdated. */
const unheard = (run) => (run.condition === "live" ? { ...run, condition: "unheard" } : run);

function lost() {
  clearTimeout(timers.silent);
  source?.close();
  source = null;
  live.set((now) => (now.connected === false ? now : { ...now, connected: false, runs: now.runs.map(unheard) }));
  clearTimeout(timers.retry);
  if (users) timers.retry = setTimeout(open, RETRY_MS[Math.min(tries++, RETRY_MS.length - 1)]);
}

function takeLive(event) {
  const { runs, traces: increments = {} } = JSON.parse(event.data);
  for (const { run } of runs) if (!traces.has(run)) traces.set(run, new Trace());
  for (const run of traces.keys()) if (!runs.some((seen) => seen.run === run)) traces.delete(run);
  const gaps = Object.entries(increments).filter(([run, increment]) => !traces.get(run)?.take(increment)).map(([run]) => run);
  for (const { run, condition } of runs) if (condition === "live" && (gaps.includes(run) || !traces.get(run).complete)) catchUp(run);
  received({ runs });
}

function takeEnded(event) {
  const end = JSON.parse(event.data);
  const ended = Object.entries({ ...live.get().ended, [end.run]: end }).slice(-ENDED_KEPT);
  received({ ended: Object.fromEntries(ended), runs: live.get().runs.filter((run) => run.run !== end.run) });
}

/** Fetch the pages of a trace that the stream did not deliver. */
async function catchUp(run) {
  const trace = traces.get(run);
  if (!trace || trace.fetching) return;
  trace.fetching = true;
  try {
    const [unit, folder] = run.split("/");
    do {
      const page = await get(`${url`/live/${unit}/${folder}/trace`}${query({ since: trace.next, generation: trace.generation })}`);
      trace.take(page.trace ?? page);
    } while (!trace.complete && traces.get(run) === trace);
    live.set((now) => ({ ...now }));
  } catch {
    // The run has ended, or the connection is lost: the stream shows which.
  } finally {
    trace.fetching = false;
  }
}

function open() {
  if (source || !users) return;
  source = new EventSource(STREAM);
  source.addEventListener("open", () => received({}));
  source.addEventListener("live", takeLive);
  source.addEventListener("ended", takeEnded);
  source.addEventListener("beat", () => received({}));
  source.onerror = lost;
  expect();
}

/** Keep the stream open until the returned function is called; closed shortly after the last user has gone. */
export function follow() {
  users += 1;
  clearTimeout(timers.linger);
  open();
  return () => {
    users -= 1;
    clearTimeout(timers.linger);
    timers.linger = setTimeout(() => {
      if (users) return;
      clearTimeout(timers.silent);
      clearTimeout(timers.retry);
      source?.close();
      source = null;
    }, LINGER_MS);
  };
}

/** The live runs, in a component that is drawn again when they change. */
export function useLive(select) {
  useEffect(follow, []);
  return useStore(live, select);
}

// A browser slows the timers of a page that is not seen.
for (const event of ["online", "visibilitychange"]) addEventListener(event, open);
