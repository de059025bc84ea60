// A place for a figure on a page: drawn again in another language with the zoom that it has, controlled by keys, saved.
import { useEffect, useLayoutEffect, useRef, useState } from "./preact.js";
import { Drawn } from "./figure.js";
import { useStore } from "./store.js";
import { language } from "./words.js";

/**
 * `draw` makes the figure of `source`, which is null while there is none; `keep`, `range` and `mark` are those of
 * `Drawn.show`, `listeners` those of `Drawn`. Of what it gives, `place` and `onKeyDown` are of the element.
 */
export function useDrawn(source, draw, listeners, { keep = false, range = null, mark = null } = {}) {
  const place = useRef(null);
  const drawn = useRef(null);
  const shown = useRef(null);
  const heard = useRef(listeners);
  const [failed, setFailed] = useState("");
  const speech = useStore(language);
  heard.current = listeners;
  useLayoutEffect(() => {
    drawn.current = new Drawn(place.current, (name, told) => heard.current[name]?.(told));
    return () => drawn.current.end();
  }, []);
  const fail = (error) => setFailed(String(error.message ?? error));
  useEffect(() => {
    if (!source) return;
    drawn.current.show(draw(source), keep || source === shown.current, range, mark).then(() => setFailed(""), fail);
    shown.current = source;
  }, [source, mark, speech]);
  const onKeyDown = (event) => {
    if (!event.ctrlKey && !event.metaKey && !event.altKey && drawn.current.key(event.key)) event.preventDefault();
  };
  return { place, onKeyDown, failed, reset: () => drawn.current.reset(), save: (kind, name) => drawn.current.save(kind, name).catch(fail) };
}
