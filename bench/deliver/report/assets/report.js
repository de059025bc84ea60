// Draws every figure from the JSON beside it and keeps its colours those of the page (light, dark, paper).
(() => {
  "use strict";
  const { Plotly } = /** @type {any} */ (globalThis);
  const plots = /** @type {any[]} */ ([...document.querySelectorAll(".plot")]);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const axes = (layout) => Object.keys(layout).filter((key) => /^[xy]axis\d*$/.test(key));
  const theme = (layout) => {
    const change = { "font.color": colour("--ink") };
    for (const axis of axes(layout)) {
      change[`${axis}.gridcolor`] = colour("--grid");
      change[`${axis}.linecolor`] = colour("--soft");
      change[`${axis}.zerolinecolor`] = colour("--line");
      change[`${axis}.tickcolor`] = colour("--soft");
    }
    return change;
  };
  const paint = () => plots.forEach((plot) => plot.data && Plotly.relayout(plot, theme(plot.layout)));
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  for (const plot of plots) {
    const figure = JSON.parse(document.getElementById(plot.dataset.figure).textContent);
    Plotly.newPlot(plot, figure.data, figure.layout, config);
  }
  paint();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
  const print = matchMedia("print");
  print.addEventListener("change", () => {
    paint();
    plots.forEach((plot) => Plotly.Plots.resize(plot));
  });
})();
