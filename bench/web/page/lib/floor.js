// An error on unseen data beside the noise floor.
import { number, t } from "./words.js";

/** Floor over error above which the floor is no more than an upper bound: EXPLAINED_RATIO of bench/analysis/thresholds.py. */
export const BOUND = 1.15;

/** Error over floor above which an effect found is the nearest one of the catalogue only: NEAREST_RATIO there. */
export const NEAREST = 2;

/** Relative fall of an error on unseen data up to which an effect does not head an answer: NAMED_FALL there. */
export const UNCHANGED = 0.02;

/** Error over floor up to which nothing worth the effort is left: ADEQUATE_RATIO there. */
export const ADEQUATE = 1.5;

/** Whether the stretches that the floor was read from hold more than noise, since unseen data are predicted better. */
export const isBound = (error, floor) => error !== null && floor !== null && floor > BOUND * error;

/** How many times the floor an error is. */
export const timesFloor = (error, floor) =>
  isBound(error, floor) ? t("workbench.ladder.below_floor") : t("workbench.ladder.times_floor", { ratio: number(error / floor, 2) });
