// What the server says of a thing that changes, asked for again and again while it is shown.
import { useEffect, useState } from "./preact.js";
import { get } from "./api.js";

/** The answer of GET `path` as {data, error}, asked for again after `ms`, and at once in another `round`; data stays beside a later error. */
export function useLook(path, ms, round = 0) {
  const [seen, setSeen] = useState(/** @type {{data?: any, error?: any}} */ ({}));
  useEffect(() => {
    let timer = 0;
    let left = false;
    const look = () => get(path).then((data) => !left && setSeen({ data }), (error) => !left && setSeen((now) => ({ ...now, error })))
      .finally(() => (timer = left ? 0 : window.setTimeout(look, ms)));
    look();
    return () => {
      left = true;
      clearTimeout(timer);
    };
  }, [path, round]);
  return seen;
}
