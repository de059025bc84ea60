// Notes about the run, and saved views of the workbench; both stay with the run.
import { html, t, api, moment, useEffect, useState } from "./parts.js";
import { sign } from "../../lib/words.js";
import { may } from "../../lib/store.js";
import { Said } from "../../lib/said.js";

/** A field with its button; `keep(text)` is awaited, then the field is empty. */
function Field({ id, label, button, most, area = false, keep }) {
  const [text, setText] = useState("");
  const [busy, setBusy] = useState(false);
  const given = text.trim();
  const send = async (event) => {
    event.preventDefault();
    if (!given || busy) return;
    setBusy(true);
    if (await keep(given)) setText("");
    setBusy(false);
  };
  const common = { id, value: text, maxlength: most, autocomplete: "off", onInput: (event) => setText(event.target.value) };
  return html`<form onSubmit=${send}><label for=${id}>${label}</label><div class="wb-field">
    ${area ? html`<textarea rows="2" ...${common}></textarea>` : html`<input type="text" ...${common} />`}
    <button type="submit" class="narrow" disabled=${!given || busy}>${button}</button></div></form>`;
}

/** `run`: the id of the run that they are kept with; `address`: what a view saves. */
export function Notes({ run, address }) {
  const [kept, setKept] = useState(/** @type {any} */ ({ notes: [], views: [] }));
  const [failed, setFailed] = useState("");
  const [unit, folder] = run.split("/");
  const place = api.url`/runs/${unit}/${folder}`;
  const ask = (request) => request.then((answer) => {
    setKept(answer);
    setFailed("");
    return true;
  }, (error) => setFailed(error.message));
  useEffect(() => void ask(api.get(`${place}/notes`)), [place]);
  const view = (name) => place + api.url`/views/${name}`;
  const writes = may("operator");
  const whose = ({ who, utc }) => html`<span class="wb-soft">${who}${sign(", ")}${moment(utc)}</span>`;
  return html`<section class="wb-card wb-notes" aria-labelledby="wb-notes-title"><h2 id="wb-notes-title">${t("workbench.notes.title")}</h2>
    ${!kept.notes.length && !kept.views.length && html`<p class="wb-soft">${t("workbench.notes.none")}</p>`}
    <ul>${kept.notes.map((note, i) => html`<li key=${`note ${i}`}><p class="wb-note">${note.text}</p>${whose(note)}</li>`)}</ul>
    ${writes && html`<${Field} id="wb-note" area label=${t("workbench.notes.note")} button=${t("workbench.notes.add")} most="4000" keep=${(text) => ask(api.post(`${place}/notes`, { text }))} />`}
    ${kept.views.length > 0 && html`<h3>${t("workbench.notes.views")}</h3>`}
    <ul>${kept.views.map((one) => html`<li key=${one.name} class="wb-view"><span><a href=${`/workbench${one.address}`}>${one.name}</a> ${whose(one)}</span>
      ${writes && html`<button type="button" class="wb-x" aria-label=${t("workbench.notes.remove", { name: one.name })} onClick=${() => ask(api.remove(view(one.name)))}>×</button>`}</li>`)}</ul>
    ${writes && html`<${Field} id="wb-view" label=${t("workbench.notes.name")} button=${t("workbench.notes.save")} most="80" keep=${(name) => ask(api.put(view(name), { address }))} />`}
    <p class="wb-bad" role="status"><${Said} text=${failed} /></p>
  </section>`;
}
