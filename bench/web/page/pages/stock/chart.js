// A figure on a page: drawn, described in words, controlled by keys, saved as a file.
import { html, useEffect } from "../../lib/preact.js";
import { saveCsv } from "../../lib/download.js";
import { useDrawn } from "../../lib/drawn.js";
import { t } from "../../lib/words.js";
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
  const drawn = useDrawn(figure, spokenTitles, { onPick: (point) => onPick?.(point.x) });
  useEffect(() => {
    drawn.place.current.style.height = `${height}px`;
  }, [height]);
  const save = (kind) => () => (kind === "CSV" ? saveCsv(name, rowsOf(figure)) : drawn.save(kind, name));
  return html`<figure class="st-figure">
    <div ref=${drawn.place} class=${`st-plot ${onPick ? "picks" : ""}`} role="group" tabindex="0" aria-label=${words} aria-keyshortcuts="ArrowLeft ArrowRight + - 0" onKeyDown=${drawn.onKeyDown}></div>
    ${drawn.failed && html`<p role="alert"><${Said} text=${drawn.failed} /></p>`}
    <figcaption class="row spread"><span class="soft small">${words}</span>
      <span class="row st-saves">${["PNG", "SVG", "CSV"].map((kind) => html`<button type="button" key=${kind} class="narrow quiet" aria-label=${t("units.save", { kind })} onClick=${save(kind)}>${kind}</button>`)}</span>
    </figcaption>
  </figure>`;
}
