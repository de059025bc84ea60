// Names of plans and runs for people.
import { may } from "./store.js";
import { known, moment, or, t } from "./words.js";

/** The words of a plan that is as the bench ships it; another one, also of the same name, has its own. */
const ofPlan = (plan, what, own) => (plan.shipped === false ? own : or(`${plan.calibration ? "calibration" : "plan"}.${plan.id}${what}`, own));
export const planTitle = (plan) => ofPlan(plan, "", plan.title);
export const planPurpose = (plan) => ofPlan(plan, ".for", plan.summary);

/** A finding about the file of one of these plans, or of a shipped one (`quick_check.yaml: …`), which people know by its name. */
export const ofPlans = (text, plans = []) =>
  text.replace(/(^|: )(?:\S*\/)?([^\s/:]+)\.yaml(?::\d+)?(?=: )/, (file, before, id) => {
    const plan = plans.find((one) => one.id === id) ?? (known(`plan.${id}`) && { id });
    return plan ? `${before}${planTitle(plan)}` : file;
  });

/** Whether people wrote the plan: its words are theirs, in their language. */
export const isOwn = (plan) => plan.shipped === false && !plan.proposed;

/** Whether a plan is offered to who is signed in: what a diagnosis proposed is for engineers. */
export const isOffered = (plan) => !plan.proposed || may("engineer");

/** The same for limits and for a station, which is named by its file or, with a hyphen, by what is in it. */
export const limitsName = (id, title = id) => or(`limits.${id}`, title);
/** A lot by its name; `cut` are those that are only the beginnings of serial numbers (`choices` of GET /fleet). */
export const lotName = (lot, cut) => (lot === "no lot" ? t("fleet.no_lot") : cut?.includes(lot) ? t("fleet.cut_lot", { lot }) : lot);
export const stationName = (name) => or(`station.${name?.replaceAll("-", "_")}`, name);

/** Name of the plan of a run; of an import its file, or what the folder of the run kept of its name. */
export function planName(run) {
  const [, of, folder] = run.profile?.match(/^import(?: of (.+)|_(.+))$/) ?? [];
  const file = of?.replace(/\.[^.]*$/, "") || folder;
  return file ? t("units.kind.import_of", { file }) : planTitle({ id: run.profile, shipped: run.shipped, title: run.profile?.replaceAll("_", " ") || t("live.run") });
}

/** A run by its id, with its unit. */
export const runName = (run) => `${run.split("/")[0]} · ${runTitle(run)}`;

/** A run by its id, for people: plan and moment; a folder that is not named by both keeps its name. */
export function runTitle(run) {
  const folder = run.split("/").pop();
  const [, day, hour, minute, second, profile] = folder.match(/^(\d{8})T(\d\d)(\d\d)(\d\d)Z_(.+)$/) ?? [];
  if (!profile) return folder;
  return `${planName({ profile })} · ${moment(`${day.replace(/(....)(..)(..)/, "$1-$2-$3")}T${hour}:${minute}:${second}Z`)}`;
}
