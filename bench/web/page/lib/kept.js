// The focus of somebody at a keyboard, when what has it is disabled or goes away: browsers drop it to the whole page.

/** What the page itself does with the focus after a change comes first. */
const AFTER_MS = 100;
const usable = (element) => element.isConnected && !element.disabled && element.getClientRects().length > 0;

/** Put the focus on the nearest heading around what lost it, and back as soon as that can be used again. */
export function keepFocus(root) {
  let held = null;
  let lent = null;
  let timer = 0;
  const focus = (element) => element.focus({ preventScroll: true });
  function look() {
    timer = 0;
    const now = document.activeElement;
    if (lent && now === lent && usable(held.element)) focus(held.element);
    if (now !== document.body || !held) return;
    if (usable(held.element)) return focus(held.element);
    const around = held.around.find((part) => part.isConnected && part.querySelector("h1, h2, h3, h4"));
    lent = around?.querySelector("h1, h2, h3, h4") ?? null;
    if (lent) {
      lent.tabIndex = -1;
      focus(lent);
    }
  }
  document.addEventListener("focusin", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (target === lent) return;
    lent = held = null;
    if (!target.closest("main")) return;
    held = { element: target, around: [] };
    for (let part = target.parentElement; part && part !== root; part = part.parentElement) held.around.push(part);
  });
  document.addEventListener("pointerdown", () => { lent = held = null; }, true); // somebody points elsewhere
  new MutationObserver(() => { timer ||= setTimeout(look, AFTER_MS); }).observe(root, { subtree: true, childList: true, attributeFilter: ["disabled", "hidden"] });
}
