// The check of a run, or of a calibration for each of its units, before anything moves.
import { useEffect, useState } from "../../lib/preact.js";
import { compute } from "../../lib/api.js";
import { serialOf } from "../../lib/units.js";

/** One answer for all units; `begun` are the calibrations that were begun before, by unit. */
function merged(units, results) {
  const findings = results.flatMap((result, index) => result.findings.map((finding) => (units.length > 1 ? { ...finding, text: `${serialOf(units[index])}: ${finding.text}` } : finding)));
  return {
    ...results[0], findings, ok: results.every((result) => result.ok),
    begun: Object.fromEntries(results.flatMap((result, index) => (result.begun ? [[units[index], result.begun]] : []))),
  };
}

async function checked({ plan, calibration, station, units, limits, models }, options) {
  if (!calibration) return compute("/checks", { plan, station, units, models, ...(limits ? { limits } : {}) }, options);
  return merged(units, await Promise.all(units.map((unit) => compute("/calibrations/checks", { plan: calibration, station, unit, others: units.filter((one) => one !== unit) }, options))));
}

export function useCheck(order) {
  const [check, setCheck] = useState(/** @type {{key?: string, result?: any, error?: Error}} */ ({}));
  const key = JSON.stringify([order.plan, order.calibration, order.station, order.units, order.limits, order.models]);
  const [round, again] = useState(0);
  useEffect(() => {
    const leaving = new AbortController();
    setCheck({});
    checked(order, { signal: leaving.signal }).then(
      (result) => setCheck({ key, result }),
      (error) => error.name !== "AbortError" && setCheck({ key, error }),
    );
    return () => leaving.abort();
  }, [key, round]);
  const { result, error } = check.key === key ? check : {};
  return { result, error, again: () => again(round + 1) };
}
