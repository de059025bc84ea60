// Small observable values, optionally stored in the browser.
import { useEffect, useState } from "./preact.js";

/** A value that notifies its listeners of changes. */
export function store(initial) {
  let value = initial;
  const listeners = new Set();
  return {
    get: () => value,
    set(next) {
      const updated = typeof next === "function" ? next(value) : next;
      if (Object.is(updated, value)) return;
      value = updated;
      for (const listener of [...listeners]) listener(value);
    },
    subscribe(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
  };
}

/** A persistent store, as JSON in localStorage; works without localStorage, too. */
export function remembered(name, initial) {
  const key = `bench.${name}`;
  let first = initial;
  try {
    first = JSON.parse(localStorage.getItem(key)) ?? initial;
  } catch {
    // Not accessible or not JSON: use the default.
  }
  const made = store(first);
  made.subscribe((value) => {
    try {
      localStorage.setItem(key, JSON.stringify(value));
    } catch {
      // The value is not stored.
    }
  });
  return made;
}

/** The value of a store (or its part by `select`) in a component, which is drawn again when it changes. */
export function useStore(source, select = (value) => value) {
  const [, redraw] = useState(0);
  const seen = select(source.get());
  useEffect(() => {
    let last = select(source.get());
    if (!Object.is(last, seen)) redraw((count) => count + 1);
    return source.subscribe((value) => {
      const now = select(value);
      if (Object.is(now, last)) return;
      last = now;
      redraw((count) => count + 1);
    });
  }, [source]);
  return seen;
}

/** "light", "dark" or null: the setting of the system. */
export const theme = remembered("theme", null);
theme.subscribe(() => dispatchEvent(new Event("bench-theme")));

/** How what the page shows has ended, or waits, in a word for the title of the browser's tab. */
export const outcome = store("");
export function useOutcome(word) {
  useEffect(() => {
    outcome.set(word);
    return () => outcome.set("");
  }, [word]);
}

/** The signed-in user: the answer of `/session`, null before it. */
export const session = store(null);
/** The PIN or badge that named the operator on this page, kept nowhere else and only while it does. */
export const badge = store("");
session.subscribe((who) => !who?.pin_s && badge.set(""));

const RANK = { viewer: 1, operator: 2, engineer: 3 };

/** Whether the signed-in user has at least `role`. */
export const may = (role) => (RANK[session.get()?.role] ?? 0) >= RANK[role];
