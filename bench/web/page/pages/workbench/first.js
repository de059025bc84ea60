// The model to begin with.

/** Follows the data: the number of intervals is chosen by the error on what each fit leaves out. */
export const START_MODEL = { name: "spline", effects: [{ effect: "spline", intervals: "auto", ends: "natural" }] };

/** Whether the data still have to choose an option of this model. */
export const isOpen = ({ effects }) => effects.some((effect) => Object.values(effect).includes("auto"));
