// Names of the effects in the reader's language; one that is not in the catalogue keeps its name.
import { or } from "../../lib/words.js";

/** "thermal lag" for `thermal_lag`. */
export const effectWord = (name) => or(`workbench.effect.${name}`, /^\w+$/.test(name) ? name.replaceAll("_", " ") : name);
