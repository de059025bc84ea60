// Before the first paint: light or dark. A separate classic script, because the page does not allow inline scripts.
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const chosen = () => {
    try {
      return JSON.parse(localStorage.getItem("bench.theme"));
    } catch {
      return null; // storage may be forbidden
    }
  };
  const show = () => {
    const theme = chosen();
    document.documentElement.dataset.theme = theme === "light" || theme === "dark" ? theme : dark.matches ? "dark" : "light";
  };
  dark.addEventListener("change", show);
  addEventListener("storage", show);
  addEventListener("bench-theme", show);
  show();
})();
