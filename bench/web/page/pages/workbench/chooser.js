// Choosing a run among ten thousand: the server filters, only the visible rows are drawn.
import { html, t, or, api, moment, useEffect, useRef, useState } from "./parts.js";
import { searched } from "../../lib/words.js";
import { Said } from "../../lib/said.js";
import { dayIn } from "../../lib/days.js";
import { timesFloor } from "../../lib/floor.js";
import { outcomeWord } from "../verdict/judged.js";
import { planName } from "../../lib/names.js";

const ROW_PX = 52;
const PAGE = 100;
const SPARE = 6;
const PAUSE_MS = 70;

/** What the server calls the plans, verdicts and states of its runs, each with what the reader sees; of an import the first word. */
const namesOf = ({ profiles, verdicts, states }) => [
  ...profiles.map((profile) => [profile.split(" ")[0], planName({ profile })]),
  ...verdicts.map((verdict) => [verdict, outcomeWord(verdict)]),
  ...states.map((state) => [state, or(`units.state.${state}`, state)]),
];

/** What the server searches for: a day, and each other word as it was typed, or what it names in this language. */
function wanted(text, names) {
  const typed = text.trim().toLowerCase();
  const day = dayIn(typed);
  const words = typed.replace(day?.found ?? "", " ").trim().split(/\s+/).map((word) => {
    const named = names.filter(([, seen]) => word.length > 1 && searched(seen).includes(word));
    return [...new Set([word, ...named.map(([name]) => name)])].join("|");
  });
  return [...words, ...(day ? [day.hours.join("|")] : [])].join(" ");
}

/** Rows of a filtered list, fetched one page at a time; `at(i)` is undefined until its page is loaded. */
function useRows(text) {
  const [list, setList] = useState({ query: null, total: 0, matched: 0, pages: {}, failed: "", names: [] });
  const query = wanted(text, list.names);
  const requested = useRef({ query: null, pages: new Set() });
  const fetchPage = async (page) => {
    if (requested.current.pages.has(page)) return;
    requested.current.pages.add(page);
    const request = requested.current;
    try {
      const answer = await api.get(`/runs${api.query({ q: query, limit: PAGE, offset: page * PAGE })}`);
      if (request !== requested.current) return;
      setList((old) => ({ query, names: namesOf(answer), total: answer.total, matched: answer.matched, failed: "", pages: { ...(old.query === query ? old.pages : {}), [page]: answer.runs } }));
    } catch (error) {
      if (request === requested.current) setList((old) => ({ ...old, failed: error.message }));
    }
  };
  useEffect(() => {
    requested.current = { query, pages: new Set() };
    const timer = setTimeout(() => fetchPage(0), query ? PAUSE_MS : 0);
    return () => clearTimeout(timer);
  }, [query]);
  return { ...list, at: (i) => list.pages[Math.floor(i / PAGE)]?.[i % PAGE], need: (i) => list.query === query && fetchPage(Math.floor(i / PAGE)) };
}

function Row({ row, index, active, count, taken, onChoose }) {
  const style = { transform: `translateY(${index * ROW_PX}px)` };
  if (!row) return html`<div class="wb-row" style=${style} role="option" aria-selected="false" aria-label=${t("workbench.chooser.loading")}>…</div>`;
  const judged = row.held_out_rms_dph && row.floor_dph;
  return html`<div id=${`wb-row-${index}`} class=${`wb-row ${active ? "wb-active" : ""}`} style=${style} role="option" aria-setsize=${count}
      aria-posinset=${index + 1} aria-selected=${taken ? "true" : "false"} onClick=${() => onChoose(row)} data-run=${row.run}>
    <span class="wb-row-unit">${taken ? "✓ " : ""}${row.unit}</span>
    <span class="wb-row-name">${planName(row)}</span>
    <span class="wb-row-day">${row.start ? moment(row.start) : ""}</span>
    <span class="wb-row-state">${row.verdict ? outcomeWord(row.verdict) : or(`units.state.${row.state}`, row.state)}</span>
    <span class="wb-row-error">${judged ? timesFloor(row.held_out_rms_dph, row.floor_dph) : ""}</span>
  </div>`;
}

/** A list to choose from; `onChoose(row)`; `taken` is a set of run ids that are chosen already. */
export function Chooser({ taken, onChoose, label }) {
  const [query, setQuery] = useState("");
  const [active, setActive] = useState(0);
  const [view, setView] = useState({ top: 0, height: 520 });
  const frame = useRef(null);
  const field = useRef(null);
  const rows = useRows(query);
  const first = Math.max(0, Math.floor(view.top / ROW_PX) - SPARE);
  const last = Math.min(rows.matched - 1, Math.ceil((view.top + view.height) / ROW_PX) + SPARE);
  useEffect(() => {
    if (last >= 0 && rows.matched) [first, last].forEach(rows.need);
  }, [first, last, rows.matched, rows.query]);
  useEffect(() => setActive(0), [query]);
  useEffect(() => field.current.focus({ preventScroll: true }), []);
  const look = () => frame.current && setView({ top: frame.current.scrollTop, height: frame.current.clientHeight || 520 });
  useEffect(look, [rows.matched]);
  const move = (to) => {
    const next = Math.max(0, Math.min(rows.matched - 1, to));
    setActive(next);
    const box = frame.current;
    if (next * ROW_PX < box.scrollTop) box.scrollTop = next * ROW_PX;
    if ((next + 1) * ROW_PX > box.scrollTop + box.clientHeight) box.scrollTop = (next + 1) * ROW_PX - box.clientHeight;
  };
  const page = Math.max(1, Math.floor(view.height / ROW_PX) - 1);
  const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page };
  const key = (event) => {
    if (event.key in steps) move(active + steps[event.key]);
    else if (event.key === "Enter" && rows.at(active)) onChoose(rows.at(active));
    else return;
    event.preventDefault();
  };
  const shown = Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => first + i);
  return html`<div class="wb-chooser">
    <label class="wb-filter"><span>${label ?? t("workbench.chooser.title")}</span>
      <input type="search" ref=${field} role="combobox" aria-expanded="true" aria-controls="wb-rows" aria-autocomplete="list" autocomplete="off" spellcheck=${false}
        aria-activedescendant=${rows.at(active) ? `wb-row-${active}` : null} value=${query} placeholder=${t("workbench.chooser.placeholder")}
        onInput=${(event) => setQuery(event.target.value)} onKeyDown=${key} />
    </label>
    <p class="wb-soft" role="status">${rows.failed ? html`<${Said} text=${rows.failed} />` : (rows.query === null ? t("workbench.chooser.loading") : t("workbench.chooser.count", { matched: rows.matched, total: rows.total }))}</p>
    ${rows.query !== null && rows.total === 0 && html`<p>${t("workbench.chooser.none")}</p>`}
    <div class="wb-rows" ref=${frame} onScroll=${look} tabindex="0">
      <div id="wb-rows" role="listbox" aria-label=${t("workbench.chooser.title")} style=${{ height: `${rows.matched * ROW_PX}px` }}>
        ${shown.map((i) => html`<${Row} key=${i} index=${i} row=${rows.at(i)} active=${i === active} count=${rows.matched}
          taken=${taken.has(rows.at(i)?.run)} onChoose=${onChoose} />`)}
      </div>
    </div>
  </div>`;
}
