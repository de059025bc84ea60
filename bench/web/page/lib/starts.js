// What the server starts in a process of its own: followed until it has a run, or has ended.
import { ApiError, get, post, url } from "./api.js";
import { t } from "./words.js";

const LOOK_MS = 300;
/** After this time without an answer of the bench, the operator is asked to look at the chamber. */
const PATIENCE_MS = 120000;
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Start by POST `path`, and wait until `done` finds something in the start; null where it waits for its station. Throws the message of the bench when it refuses. */
async function followed(path, body, done) {
  const { start, state } = await post(path, body);
  if (state === "waiting") return null;
  const until = Date.now() + PATIENCE_MS;
  while (Date.now() < until) {
    const seen = await get(url`/starts/${start}`);
    if (seen.state === "refused") throw new ApiError(422, seen.message);
    const found = done(seen);
    if (found) return found;
    if (seen.state === "ended") throw new ApiError(422, seen.message || seen.sentence);
    await pause(LOOK_MS);
  }
  throw new ApiError(504, t("ready.no_word"));
}

/** Start a run; its id as soon as it has a folder. */
export const startRun = (path, body) => followed(path, body, ({ runs }) => runs[0]);

/** Start what makes no run; its end, which was good. */
export const startAct = (path, body) => followed(path, body, (seen) => seen.state === "ended" && seen.exit_code === 0 && seen);
