// Names of the effects in the reader's language; one that is not in the catalogue keeps its name.
import { t } from "./parts.js";

const WORDS = () => ({
  polynomial: t("workbench.effect.polynomial"),
  regression: t("workbench.effect.regression"),
  spline: t("workbench.effect.spline"),
  surface: t("workbench.effect.surface"),
  thermal_lag: t("workbench.effect.thermal_lag"),
  temperature_rate: t("workbench.effect.temperature_rate"),
  hysteresis: t("workbench.effect.hysteresis"),
  creep: t("workbench.effect.creep"),
  warm_up: t("workbench.effect.warm_up"),
  aging: t("workbench.effect.aging"),
  quadrature_leakage: t("workbench.effect.quadrature_leakage"),
  drive_amplitude: t("workbench.effect.drive_amplitude"),
  resonance_frequency: t("workbench.effect.resonance_frequency"),
  supply_voltage: t("workbench.effect.supply_voltage"),
  compressor: t("workbench.effect.compressor"),
  bias_jump: t("workbench.effect.bias_jump"),
  bias_kink: t("workbench.effect.bias_kink"),
  frost: t("workbench.effect.frost"),
  scale_factor_temperature: t("workbench.effect.scale_factor_temperature"),
  scale_factor_nonlinearity: t("workbench.effect.scale_factor_nonlinearity"),
  thermometer_lag: t("workbench.effect.thermometer_lag"),
  thermometer_hysteresis: t("workbench.effect.thermometer_hysteresis"),
  thermometer_offset: t("workbench.effect.thermometer_offset"),
  clock_delay: t("workbench.effect.clock_delay"),
  lagged_product: t("workbench.effect.lagged_product"),
  partial_range: t("workbench.effect.partial_range"),
  expression: t("workbench.effect.expression"),
});

/** "thermal lag" for `thermal_lag`. */
export const effectWord = (name) => WORDS()[name] ?? name.replaceAll("_", " ");
