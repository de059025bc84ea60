"""Random units: a smooth curve over temperature and mechanisms of the truth with amplitudes of a given strength.

The catalogue of the truth is larger than the library of effects. Mechanisms that a run cannot distinguish from a
constant or a smooth curve (turn-on, a knee) are never drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.sim.truth import MECHANISMS

Entry = dict[str, Any]
"""One mechanism as in a station's YAML."""

NOISE = {"angle_random_walk": 0.01, "bias_instability": 0.03, "rate_random_walk": 0.03}
CHANNELS: Entry = {
    # Channels also wander independently, as in a real unit, so that they differ from the temperature.
    "frequency": {"wander_ppm": 20.0},
    "drive": {"wander_ppm": 1000.0},
    "quadrature": {"offset_dps": 0.5, "slope_dps_per_degc": 0.004, "wander_dps": 0.05},
}


@dataclass(frozen=True)
class Hidden:
    """A mechanism that may be hidden, with the parameters to which its contribution is proportional.

    A unit has at most one mechanism of a `group`. `turns`: it shows only while a rate table turns. `one_run`: it occurs
    in one run only.
    """

    mechanism: str
    amplitudes: tuple[str, ...]
    group: str = ""
    turns: bool = False
    one_run: bool = False

    @property
    def effect(self) -> str | None:
        """The effect that the bench should name; None if its library does not cover the mechanism."""
        return MECHANISMS[self.mechanism].effect

    @property
    def thermal(self) -> bool:
        """Whether it changes the resonator's temperature; its time constants are only nearly proportional."""
        return MECHANISMS[self.mechanism].kind == "thermal"


HIDDEN: dict[str, Hidden] = {
    hidden.mechanism: hidden
    for hidden in (
        Hidden("thermal_lag", ("tau_s",), "thermal"),
        Hidden("thermal_network", ("direct_tau_s", "mount_tau_s", "frame_tau_s"), "thermal"),
        Hidden("two_pole_lag", ("first_tau_s", "second_tau_s"), "thermal"),
        Hidden("temperature_rate", ("k_dph_per_degc_per_min",)),
        Hidden("preisach", ("amplitude_dph",), "hysteresis"),
        Hidden("bouc_wen", ("amplitude_dph",), "hysteresis"),
        Hidden("creep", ("k_dph_per_degc",)),
        Hidden("warm_up", ("amplitude_dph",)),
        Hidden("aging", ("linear_dph_per_h",)),
        Hidden("quadrature_leakage", ("phase_mrad", "phase_slope_mrad_per_degc")),
        Hidden("drive_amplitude", ("k_dph_per_percent",)),
        Hidden("resonance_frequency", ("k_dph_per_hz",)),
        Hidden("supply_voltage", ("k_dph_per_v",)),
        Hidden("compressor", ("k_dph_per_g2",)),
        Hidden("bias_jump", ("step_dph",), one_run=True),
        Hidden("bias_kink", ("slope_dph_per_degc",)),
        Hidden("frost", ("amplitude_dph",)),
        Hidden("scale_factor_temperature", ("ppm_per_degc", "ppb_per_degc2"), turns=True),
        Hidden("scale_factor_nonlinearity", ("linear_ppm", "square_ppm"), turns=True),
        Hidden("periodic", ("amplitude_dph",)),
        Hidden("rate_squared", ("k_dph_per_degc2_per_min2",)),
        Hidden("etalon", ("amplitude_dph",)),
        Hidden("emi", ("amplitude_dph", "offset_dph")),
        Hidden("unlogged_drift", ("sigma_dph",)),
    )
}


def draw(mechanism: str, rng: np.random.Generator, hours: float) -> Entry:
    """The mechanism with random shape parameters; `hours` is the length of the run."""

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def uniform(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    shapes: dict[str, Callable[[], Entry]] = {
        "two_pole_lag": lambda: {"first_tau_s": 60.0, "second_tau_s": 60.0 * uniform(2, 4)},
        "temperature_rate": lambda: {"tau_s": log(8, 40)},
        "preisach": lambda: {"half_width_degc": uniform(3, 12), "relay_seed": int(rng.integers(1000))},
        "bouc_wen": lambda: {"length_degc": uniform(6, 25)},
        "creep": lambda: {"shortest_h": log(0.3, 1), "longest_h": log(4, 10)},
        "warm_up": lambda: {"tau_s": log(400, 1800)},
        "quadrature_leakage": lambda: {"phase_slope_mrad_per_degc": uniform(0, 0.01)},
        "bias_jump": lambda: {"at_s": [3600.0 * hours * uniform(0.2, 0.8)], "step_dph": [0.2]},
        "bias_kink": lambda: {"at_degc": uniform(-10, 60)},
        "frost": lambda: {"freezing_degc": uniform(-5, 5), "width_degc": uniform(2, 6)},
        "periodic": lambda: {"period_s": uniform(900, 2400), "phase_rad": uniform(0, 6.28)},
        "etalon": lambda: {"period_degc": uniform(6, 12), "phase_rad": uniform(0, 6.28)},
        "emi": lambda: {"alias_hz": log(0.0005, 0.002)},
        "unlogged_drift": lambda: {"tau_s": log(900, 3600)},
    }
    return {"mechanism": mechanism, **shapes.get(mechanism, dict)()}


def static_curve(rng: np.random.Generator) -> Entry:
    """A smooth bias over temperature, 2 to 6 deg/h, steep enough to show a lag."""
    slope = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0)
    shape = rng.uniform(2.0, 6.0) * np.array([rng.uniform(-1.0, 1.0), slope, *rng.uniform(-0.4, 0.4, 2)])
    return {"mechanism": "static_bias", "coefficients_dph": np.round(shape, 4).tolist()}


def scaled(entry: Entry, target: float, share: Callable[[Entry], float]) -> Entry:
    """The mechanism with its amplitudes multiplied until `share` of it [deg/h] is the target, within 1 % if thermal."""
    thermal, factor = HIDDEN[entry["mechanism"]].thermal, 1.0
    for _ in range(8 if thermal else 1):
        contribution = share(times(entry, factor))
        step = target / max(contribution, 1e-12)
        factor *= float(np.clip(step, 1.0 / 30.0, 30.0)) if thermal else step
        if abs(contribution / target - 1.0) < 0.01:
            break
    return times(entry, factor)


def times(entry: Entry, factor: float) -> Entry:
    """The mechanism with its amplitudes multiplied."""
    fields = MECHANISMS[entry["mechanism"]].model_fields
    values = {n: entry.get(n, fields[n].default) for n in HIDDEN[entry["mechanism"]].amplitudes}
    return entry | {n: [factor * x for x in v] if isinstance(v, list) else factor * v for n, v in values.items()}
