// The model to begin with.

const spline = (intervals) => ({ name: "spline", effects: [{ effect: "spline", intervals, ends: "natural" }] });

/** That of the library. A misfit of a coarser curve would look like an effect. */
export const START_MODEL = spline(24);

/** Where the data do not determine the first one: the number of intervals is chosen by the error on what each fit leaves out. */
export const FOLLOWING_MODEL = spline("auto");

/** Whether the data still have to choose an option of this model. */
export const isOpen = ({ effects }) => effects.some((effect) => Object.values(effect).includes("auto"));
