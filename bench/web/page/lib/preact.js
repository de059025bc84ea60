// Components and their HTML as template literals: Preact, its hooks, htm.
export { html, render } from "htm/preact";
export * from "preact/hooks";
