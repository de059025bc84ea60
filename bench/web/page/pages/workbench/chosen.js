// The chosen runs, each with its role: fitted, held out, isothermal for the noise, or isothermal of a unit like it.
import { html, or, t, runTitle, unitOf } from "./parts.js";
import { quantity } from "./sentence.js";
import { ROLES } from "./state.js";

const WORDS = () => ({ fit: t("workbench.role.fit"), check: t("workbench.role.check"), static: t("workbench.role.static"), sister: t("workbench.role.sister") });
const HINTS = () => ({ fit: t("workbench.role.fit_hint"), check: t("workbench.role.check_hint"), static: t("workbench.role.static_hint"), sister: t("workbench.role.sister_hint") });
const SHAPES = { fit: "●", check: "◇", static: "▬", sister: "▭" };

/** `chosen`, `offered`: [{run, role}]; `told`: what the server says of runs by their ids; `outputs`: those of a unit with several; a run that is offered is used only after a click, because it changes the numbers. The bar also opens the list again, to add a run or to start with another one. */
export function Chosen({ chosen, told, outputs, output, offered, act, onAdd, onOther, onCompare }) {
  const words = WORDS();
  const hints = HINTS();
  const more = offered.filter((one) => !chosen.some(({ run }) => run === one.run) && chosen.some(({ run }) => unitOf(run) === unitOf(one.run)));
  const units = [...new Set(chosen.map((one) => unitOf(one.run)))];
  return html`<section class="wb-chosen" aria-label=${t("workbench.chosen.title")}>
    ${units.length === 1 && html`<b class="wb-unit">${units[0]}</b>`}
    ${outputs.length > 0 && html`<label class="wb-inline">${t("workbench.chosen.output")} <select value=${output} onChange=${(event) => act({ type: "view", view: { output: event.target.value } })}>
      ${outputs.map((one) => html`<option key=${one} value=${one} selected=${one === output}>${quantity(one)}</option>`)}</select></label>`}
    <ul>${chosen.map((one) => html`<li key=${one.run} class=${`wb-chip wb-role-${one.role}`} title=${hints[one.role]}>
      <span class="wb-shape" aria-hidden="true">${SHAPES[one.role]}</span>
      <a class="wb-chip-name" href=${`/runs/${one.run}`}>${units.length > 1 && html`<b>${unitOf(one.run)}</b> `}${runTitle(one.run)}${told[one.run] && told[one.run].state !== "done" && html` <span class="wb-soft">· ${or(`units.state.${told[one.run].state}`, told[one.run].state)}</span>`}</a>
      <select value=${one.role} aria-label=${t("workbench.role.of", { run: runTitle(one.run) })} onChange=${(event) => act({ type: "role", run: one.run, role: event.target.value })}>
        ${ROLES.map((role) => html`<option key=${role} value=${role} selected=${role === one.role}>${words[role]}</option>`)}
      </select>
      <button type="button" class="wb-x" aria-label=${t("workbench.chosen.drop", { run: runTitle(one.run) })} onClick=${() => act({ type: "drop", run: one.run })}>×</button>
    </li>`)}</ul>
    ${more.map((one) => html`<button type="button" key=${one.run} class="narrow" title=${hints[one.role]} onClick=${() => act({ type: "take", run: one })}>
      + ${t("workbench.chosen.use", { run: runTitle(one.run), role: words[one.role] })}</button>`)}
    <div class="wb-chosen-tools">
      <button type="button" class="narrow" onClick=${onAdd}>${t("workbench.chosen.add")}</button>
      <button type="button" class="narrow" onClick=${onCompare}>${t("workbench.chosen.compare")}</button>
      <button type="button" class="narrow" onClick=${onOther}>${t("workbench.chosen.other")}</button>
    </div>
  </section>`;
}
