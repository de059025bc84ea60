// A figure on a page: drawn, described in words, controlled by keys, saved as a file.
import { html, useEffect, useLayoutEffect, useRef, useState } from "../../lib/preact.js";
import { Drawn, saveCsv } from "../../lib/figure.js";
import { useStore } from "../../lib/store.js";
import { language, t } from "../../lib/words.js";
import { Said } from "../../lib/said.js";
import { spokenTitles } from "../../lib/spoken.js";

/** Columns of the traces of a figure as rows for a CSV. */
function rowsOf(figure) {
  const rows = [["trace", "x", "y"]];
  for (const trace of figure.data) (trace.x ?? []).forEach((x, i) => rows.push([trace.name ?? "", x, trace.y[i]]));
  return rows;
}

/** `figure` {data, layout}; `words` describe it; `onPick(x)` gets the x of a clicked point. */
export function Chart({ figure, words, name, height = 380, onPick }) {
  const place = useRef(null);
  const drawn = useRef(null);
  const pick = useRef(onPick);
  const [trouble, setTrouble] = useState(null);
  pick.current = onPick;
  useLayoutEffect(() => {
    drawn.current = new Drawn(place.current);
    return () => drawn.current.end();
  }, []);
  const speech = useStore(language);
  const shown = useRef(null);
  useEffect(() => {
    const listening = drawn.current.listening;
    const keep = figure === shown.current;
    shown.current = figure;
    drawn.current.show(spokenTitles(figure), keep).then(
      () => !listening && place.current?.on?.("plotly_click", (event) => pick.current?.(event.points[0].x)),
      setTrouble,
    );
  }, [figure, speech]);
  useEffect(() => {
    place.current.style.height = `${height}px`;
  }, [height]);
  const key = (event) => {
    if (!event.ctrlKey && !event.metaKey && !event.altKey && drawn.current.key(event.key)) event.preventDefault();
  };
  const save = (kind) => () => (kind === "CSV" ? saveCsv(name, rowsOf(figure)) : drawn.current.save(kind, name));
  return html`<figure class="st-figure">
    <div ref=${place} class=${`st-plot ${onPick ? "picks" : ""}`} role="group" tabindex="0" aria-label=${words} aria-keyshortcuts="ArrowLeft ArrowRight + - 0" onKeyDown=${key}></div>
    ${trouble && html`<p role="alert"><${Said} text=${String(trouble.message ?? trouble)} /></p>`}
    <figcaption class="row spread"><span class="soft small">${words}</span>
      <span class="row st-saves">${["PNG", "SVG", "CSV"].map((kind) => html`<button type="button" key=${kind} class="narrow quiet" aria-label=${t("units.save", { kind })} onClick=${save(kind)}>${kind}</button>`)}</span>
    </figcaption>
  </figure>`;
}
