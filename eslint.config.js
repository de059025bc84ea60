// eslint looks at our own JavaScript: the page, what builds it, and the script of a report.
import js from "@eslint/js";
import globals from "globals";

export default [
  { ignores: ["bench/web/static/"] },
  js.configs.recommended,
  {
    languageOptions: { globals: globals.browser },
    rules: {
      eqeqeq: "error",
      "no-shadow": "error",
      "no-unused-vars": ["error", { argsIgnorePattern: "^_", varsIgnorePattern: "^_" }],
      "no-var": "error",
      "prefer-const": "error",
    },
  },
  { files: ["*.js", "bench/web/page/build.js"], languageOptions: { globals: globals.node } },
];
