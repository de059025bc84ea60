// Small observable values, and those that a browser remembers.
import { useEffect, useState } from "./preact.js";

/** A value that tells its listeners when it is set to another one. */
export function store(initial) {
  let value = initial;
  const listeners = new Set();
  return {
    get: () => value,
    set(next) {
      const wanted = typeof next === "function" ? next(value) : next;
      if (Object.is(wanted, value)) return;
      value = wanted;
      for (const listener of [...listeners]) listener(value);
    },
    subscribe(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
  };
}

/** A store that outlives the page, as JSON in localStorage; works without it, too. */
export function remembered(name, initial) {
  const key = `bench.${name}`;
  let first = initial;
  try {
    first = JSON.parse(localStorage.getItem(key)) ?? initial;
  } catch {
    // Forbidden or not JSON: begin anew.
  }
  const made = store(first);
  made.subscribe((value) => {
    try {
      localStorage.setItem(key, JSON.stringify(value));
    } catch {
      // Not remembered, then.
    }
  });
  return made;
}

/** The value of a store (or what `select` takes from it) in a component that is drawn again when it changes. */
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

/** "light", "dark" or null: as the system wants it. */
export const theme = remembered("theme", null);
theme.subscribe(() => dispatchEvent(new Event("bench-theme")));

/** Who is signed in: the answer of `/session`, null before it is known. */
export const session = store(null);

const RANK = { viewer: 1, operator: 2, engineer: 3 };

/** Whether who is signed in may do what needs `role`. */
export const may = (role) => (RANK[session.get()?.role] ?? 0) >= RANK[role];
