// The model to begin with.

/** Follows the data: the number of intervals is chosen by the error on what each fit leaves out. */
export const START_MODEL = { name: "spline", effects: [{ effect: "spline", intervals: "auto", ends: "natural" }] };
