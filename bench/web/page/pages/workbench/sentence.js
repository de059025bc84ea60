// What a diagnosis says, in the reader's language, made of its numbers.
import { channelWord, effectWord, joined, or, sign, symbols, t } from "../../lib/words.js";
import { measured, number } from "./parts.js";
import { ADEQUATE, NEAREST, UNCHANGED } from "../../lib/floor.js";
import { labelled } from "../../lib/spoken.js";

/** Name of a fitted parameter of an effect, as people read it. */
export const parameterWord = (name) => or(`workbench.parameter.${name}`, name.replaceAll("_", " "));

/** Name of a quantity that something is drawn or fails over. */
export const quantity = (name) => (name === "dT_dt" ? "dT/dt" : labelled(channelWord(name)));

const named = ({ effect, parameters }) => {
  const values = Object.entries(parameters ?? {}).map(([name, value]) => `${parameterWord(name)} ${measured(value)}`);
  return values.length ? `${effectWord(effect)}${sign(" (")}${values.join(sign(", "))}${sign(")")}` : effectWord(effect);
};
const list = (suspects) => joined(suspects.map(named));
const unseen = (proof) => t(`workbench.say.unseen.${proof?.by ?? "other"}`);
const errors = ({ proof }, scale = 1) => ({ unseen: unseen(proof), before: number(proof.before_dph / scale), after: number(proof.after_dph / scale) });

const alike = ({ effect, look_alikes }) => (look_alikes.length
  ? [t("workbench.say.alike", { effect: effectWord(effect), others: joined(look_alikes.map(effectWord)) })] : []);

const doubt = (suspect) => (suspect.proof.before_dph === null ? t("workbench.say.unjudged", { effect: effectWord(suspect.effect) })
  : t("workbench.say.changes", { effect: effectWord(suspect.effect), ...errors(suspect) }));

const where = ({ channel, from, to, unit, misfit_dph }) => t("workbench.say.where", {
  channel: quantity(channel), low: number(from, 4), high: number(to, 4), misfit: number(misfit_dph),
  unit: symbols(unit),
}).replace("  ", " ");

function missing(found) {
  const judged = found.suspects.filter((one) => one.found);
  const [proved, doubtful] = [judged.filter((one) => one.proved), judged.filter((one) => !one.proved)];
  const refuted = !proved.length && doubtful.every(({ proof }) => proof.after_dph !== null && proof.after_dph >= (1 - UNCHANGED) * proof.before_dph);
  return [
    ...(proved.length ? [t("workbench.say.missing", { effects: list(proved) })] : []),
    ...proved.flatMap((one) => [t("workbench.say.proof", { effect: effectWord(one.effect), ...errors(one) }), ...alike(one)]),
    ...(doubtful.length ? [t(`workbench.say.${found.contradicted ? "contradicted" : refuted ? "resembles" : "suspected"}`, { effects: list(doubtful) })] : []),
    ...doubtful.flatMap((one) => [doubt(one), ...alike(one)]),
    ...(proved.length || found.check?.length ? [] : [t("workbench.say.record")]),
    ...(judged.length > 1 ? [t("workbench.say.several")] : []),
    ...found.unexplained.slice(0, 1).map((place) => t("workbench.say.small", { where: where(place) })),
  ];
}

function unknown(found) {
  const near = found.suspects.filter((one) => one.found);
  const first = t("workbench.say.unknown");
  const nearest = near.find((one) => one.effect === found.nearest);
  if (nearest) {
    const much = found.floor_dph && nearest.proof.after_dph > NEAREST * found.floor_dph;
    return [first, t(`workbench.say.nearest${much ? "" : "_dph"}`, { effect: list([nearest]), ...errors(nearest, much ? found.floor_dph : 1) })];
  }
  return [
    first,
    ...found.unexplained.slice(0, 1).map((place) => t("workbench.say.unknown_where", { where: where(place) })),
    ...(near.length ? [t("workbench.say.part", { effect: list(near.slice(0, 1)) })]
      : found.suspects.length ? [t("workbench.say.chance", { effect: effectWord(found.suspects[0].effect) })] : []),
  ];
}

const still = ({ floor_ratio }) => (floor_ratio > ADEQUATE ? [t("workbench.say.still", { ratio: number(floor_ratio, 2) })] : []);

/** What is told apart by a proposed run: effects, formulas or kinds of causes. */
export const rival = (name) => or(`workbench.cause.${name}`, effectWord(name));

const percent = (share) => String(Math.round(100 * share));

/** Why a run is proposed; `next` is the `next_experiment` of a diagnosis. */
export function reasons(next) {
  if (next.use === "by_hand") {
    const what = next.channels.map((name) => or(`workbench.excite.${name}`, t("workbench.why.move", { channel: quantity(name) })));
    return [t("workbench.why.by_hand", { channels: joined(next.channels.map(quantity)), what: what.join(sign("; ")) })];
  }
  if (next.use !== "run") return [t(`workbench.why.${next.use}`)];
  if (next.predicted_before === null) return [t("workbench.why.thermal")];
  const [after, often] = [next.probability_after, next.probability_after_repeats].map(percent);
  const [heating, cooling] = next.faster_degc_per_min ?? [];
  if (!next.decides) return [t("workbench.why.hopeless", { percent: often })];
  return [
    t(`workbench.why.${next.name.match(/loops|steps|cycle|soaks|reversals/)[0]}`),
    ...(often === after ? [] : [t("workbench.why.again", { percent: often })]),
    ...(heating ? [t("workbench.why.faster", { heating: number(heating, 2), cooling: number(cooling, 2) })] : []),
  ];
}

/** Sentences about `found`, the content of `bench diagnose`; the first is the one that matters most. */
export function sentences(found) {
  const sizes = { rms: number(found.rms_dph), floor: number(found.floor_dph) };
  if (found.verdict === "adequate")
    return [t("workbench.say.adequate", sizes), ...(found.static ? [] : [t("workbench.say.slow")])];
  if (found.verdict === "missing_effect") return [...missing(found), ...still(found)];
  if (found.resolution) return [t("workbench.say.steps", sizes), t("workbench.say.record_finer")];
  if (found.verdict === "undecided")
    return found.suspects.some((one) => one.found) ? missing(found)
      : [...(found.floor_dph === null ? [t("workbench.caption.no_floor")] : []), t("workbench.say.cause_or_noise", sizes), found.static ? t("workbench.say.record_next") : t("workbench.say.record_static")];
  return [...unknown(found), ...still(found)];
}
