// The server's API: JSON requests and answers, and errors of one line.
import { session } from "./store.js";
import { t } from "./words.js";

const BASE = "/api/v1";
const WAIT_S = 20;

/** Error answer of the server; `status` is 0 without any answer, `wait_s` says when to ask again. */
export class ApiError extends Error {
  constructor(status, detail, wait_s = 0) {
    super(detail);
    Object.assign(this, { status, wait_s });
  }
}

async function answer(response) {
  const body = await response.json().catch((error) => {
    if (error.name === "AbortError") throw error;
    if (response.ok && error.name !== "SyntaxError") throw new ApiError(0, t("error.unreachable")); // cut off
    return null; // not JSON, or nothing
  });
  if (response.ok) return body;
  if (response.status === 401 && !response.url.endsWith("/pin")) session.set((now) => now && { ...now, name: null, role: null });
  // What a PIN allowed may be over: who is it now?
  if (response.status === 403 && session.get()?.pin_s) get("/session").then(session.set);
  throw new ApiError(response.status, body?.detail ?? t("error.no_reason", { status: String(response.status) }), Number(response.headers.get("Retry-After")));
}

async function send(method, path, /** @type {{body?: any, form?: FormData, signal?: AbortSignal}} */ { body, form, signal } = {}) {
  const headers = form ? { "X-Bench": "1" } : body === undefined ? {} : { "Content-Type": "application/json" };
  let response;
  try {
    response = await fetch(BASE + path, {
      method, headers, signal, credentials: "same-origin", body: form ?? (body === undefined ? undefined : JSON.stringify(body)),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ApiError(0, t("error.unreachable"));
  }
  const later_s = method === "GET" && response.status === 202 && Number(response.headers.get("Retry-After"));
  if (!later_s) return answer(response);
  await new Promise((done) => setTimeout(done, 1000 * later_s)); // it is being counted
  return send(method, path, { signal });
}

/** Path with its parts encoded: url`/live/${unit}/${run}`. */
export const url = (strings, ...parts) => String.raw({ raw: strings }, ...parts.map((part) => encodeURIComponent(part)));

/** `?a=1&b=2` of the entries that are not empty; empty without any. */
export function query(values) {
  const entries = Object.entries(values).filter(([, value]) => value !== undefined && value !== null && value !== "");
  return entries.length ? `?${new URLSearchParams(entries)}` : "";
}

export const get = (path, options) => send("GET", path, options);
export const post = (path, body = {}, options = {}) => send("POST", path, { ...options, body });
export const put = (path, body = {}, options = {}) => send("PUT", path, { ...options, body });
export const remove = (path, options) => send("DELETE", path, options);
/** Send a form with files (imports). */
export const upload = (path, form, options) => send("POST", path, { ...options, form });

/** Wait for a job to be done; its result. `told` gets each intermediate answer. Throws ApiError when it failed. */
export async function finished(job, /** @type {{told?: (seen: any) => void, signal?: AbortSignal}} */ { told, signal } = {}) {
  for (;;) {
    const seen = await get(`${url`/jobs/${job}`}?wait_s=${WAIT_S}`, { signal });
    told?.(seen);
    if (seen.state === "done") return seen.result;
    if (seen.state === "failed") throw new ApiError(422, seen.detail);
  }
}

/** Request a computation: POST that answers with a job, and its result. When it is aborted, the server need not go on. */
export async function compute(path, body, options = {}) {
  const { job } = await post(path, body, options);
  try {
    return await finished(job, options);
  } catch (error) {
    if (error.name === "AbortError") remove(url`/jobs/${job}`).catch(() => {});
    throw error;
  }
}
