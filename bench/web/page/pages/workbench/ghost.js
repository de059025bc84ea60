// The residual of the model before, beside that of the new one.

const GHOST = "#8A949D";

/** A figure with the residual of the model before, pale and behind, on the same axes. */
export function haunted(figure, before) {
  const ghosts = before.data.filter(({ meta }) => meta === "residual").map((trace, i) => ({
    ...trace, name: "residual before", meta: "before", legendgroup: "before", showlegend: i === 0, line: { ...trace.line, color: GHOST }, opacity: 0.7,
    ...(trace.marker ? { marker: { size: trace.marker.size, color: GHOST } } : {}),
  }));
  return { ...figure, data: [...ghosts, ...figure.data] };
}
