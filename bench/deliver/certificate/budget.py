"""The uncertainty budget of the corrected output (JCGM 100); docs/uncertainty.md explains the contributions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.analysis import SETTLED_DEGC_PER_MIN, HeldOut, error_of, turn_ons, turning
from bench.base import DPH_PER_DPS, BoolArray, counted, number
from bench.deliver.certificate.evidence import Evidence, Verification, day
from bench.deliver.certificate.laboratory import Instrument
from bench.deliver.certificate.propagation import PERCENT, Budget, Contribution
from bench.deliver.certificate.stated import Unit
from bench.record import EARTH_DPH, Dataset, Orientation

LEAST_TURN_ONS = 3
"""Turn-ons from which their spread is told from chance; the effective degrees of freedom say how well."""
STEP_DEGC = 12.5
"""Distance of the temperatures at which the uncertainty is stated."""
_QUANTILE = 1.96
_NEAR_RATE = 0.02
_MOST_RATES = 6


@dataclass(frozen=True)
class Uncertainty:
    """Budgets of the corrected output: at rest over the whole range, at temperatures, and at rates of a rate table."""

    at_rest: Budget
    by_temperature: tuple[tuple[float, Budget], ...]
    """Temperature [degC] and budget at rest."""
    by_rate: tuple[tuple[float, Budget], ...]
    """Rate [deg/s] and budget over the whole range of temperature."""
    turn_ons: tuple[float, ...]
    """Mean error of each turn-on that was verified [deg/h]."""

    @property
    def expanded_dph(self) -> float:
        """Expanded uncertainty [deg/h] at rest, over the whole range of temperature."""
        return self.at_rest.expanded_dph

    def to_json(self) -> dict[str, Any]:
        """Rows, sums, and what Monte Carlo says beside the formula."""
        drawn, trials = self.at_rest.monte_carlo
        return {
            "measurand": "bias left in the corrected output at rest, a mean over the averaging time at one temperature",
            "contributions": [part.to_json() for part in self.at_rest.contributions],
            "correlations": [[*pair, value] for pair, value in self.at_rest.correlations.items()],
            **self.at_rest.figures(),
            "coverage_probability": PERCENT / 100.0,
            "monte_carlo": {"expanded_dph": drawn, "trials": trials},
            "turn_ons": list(self.turn_ons),
            "scope": f"{_scope(len(self.turn_ons))}, in the orientation of the run",
            "by_temperature": [{"temperature_degc": at, **found.figures()} for at, found in self.by_temperature],
            "by_rate": [
                {
                    "rate_dps": rate,
                    **found.figures(),
                    "unknown": list(found.unknown),
                    "contributions": [part.to_json() for part in found.contributions],
                }
                for rate, found in self.by_rate
            ],
        }


def _scope(turn_ons: int) -> str:
    """What the expanded uncertainty holds for."""
    if turn_ons == 0:
        return "within the turn-on of the calibration run; no other turn-on was measured"
    if turn_ons < LEAST_TURN_ONS:
        few = counted(turn_ons, "turn-on")
        return f"any turn-on, as far as {few} can tell; {LEAST_TURN_ONS} or more make the figure reliable"
    return f"any turn-on, from {turn_ons} turn-ons after the calibration"


def budget(evidence: Evidence) -> Uncertainty:
    """Propagate all sources at rest, at temperatures and at rates; docs/uncertainty.md defines each source."""
    correlations = _correlations(evidence.instruments)
    runs = evidence.verifications
    found = turn_ons([run.data for run in runs], [run.left for run in runs])
    means = tuple(one.mean_dph for one in found.each)

    def at(rows: BoolArray | None, rate_dps: float = 0.0) -> Budget:
        seen = (_observed(evidence, rows), *_turn_on(means, evidence))
        return Budget((*seen, *_instruments(evidence, rate_dps), *_digital(evidence)), correlations)

    check = evidence.verification
    if check is None:
        return Uncertainty(at(None), (), (), means)
    turned = turning(check.data)
    temperature = check.data.channel("temperature")
    present = np.isfinite(check.left) & ~turned
    low, high = np.nanmin(temperature[present]), np.nanmax(temperature[present])
    steps = np.arange(np.ceil(low / STEP_DEGC), np.floor(high / STEP_DEGC) + 1) * STEP_DEGC
    near = [(float(step), present & (np.abs(temperature - step) <= STEP_DEGC / 2)) for step in steps]
    by_temperature = tuple((step, at(rows)) for step, rows in near if rows.any())
    return Uncertainty(at(~turned), by_temperature, tuple(_rates(check, at)), means)


def _rates(check: Verification, at: Any) -> Iterator[tuple[float, Budget]]:
    """Budget at each rate [deg/s] of the table in the verification."""
    applied = np.abs(check.data.channels.get("applied_rate", np.zeros(len(check.data))))
    turned = turning(check.data) & np.isfinite(check.left)
    left = turned.copy()
    for _ in range(_MOST_RATES):
        if not left.any():
            return
        rate = float(applied[left].max())
        rows = turned & (np.abs(applied - rate) <= _NEAR_RATE * rate)
        yield rate, at(rows, rate)
        left &= ~rows


def _observed(evidence: Evidence, rows: BoolArray | None) -> Contribution:
    """Error of one mean on unseen data: what the model misses, and noise. The two are observed together."""
    known = {quantity.name: quantity for quantity in evidence.quantities()}
    floor_dph = known["noise_floor_dph"].value
    noise = f"; noise floor {number(floor_dph)} deg/h" if np.isfinite(floor_dph) else ""
    check = evidence.verification
    if check is None or rows is None:
        held_out = known["residual_rms_dph"]
        value, ends, most = held_out.value, (held_out.low, held_out.high), np.inf
        origin = "data held out of the fit"
    else:
        found = _error(check, rows)
        value, ends, most = found.rms_dph, found.interval_dph, float(np.count_nonzero(rows & np.isfinite(check.left)))
        origin = f"verification run {check.manifest.run}, about the mean of each turn-on"
    standard_error = (ends[1] - ends[0]) / 2.0 / _QUANTILE
    dof = min(most, 0.5 * (value / standard_error) ** 2) if standard_error else most
    source = "model error and noise of one mean"
    return Contribution(source, "A", "normal", value, "deg/h", 1.0, max(1.0, dof), origin + noise)


def _error(check: Verification, rows: BoolArray) -> HeldOut:
    """Error of rows about the mean of their turn-on."""
    means = {one.number: one.mean_dph for one in turn_ons([check.data], [check.left]).each}
    about = np.array([means.get(number, 0.0) for number in check.data.turn_on.tolist()])
    return error_of("verification", (check.data,), (np.where(rows, check.left - about, np.nan),))


def _turn_on(means: Sequence[float], evidence: Evidence) -> Iterator[Contribution]:
    """Mean errors of turn-ons after the calibration, about zero: each is a draw of what the next one will be."""
    if means:
        rms = float(np.sqrt(np.mean(np.square(means))))
        origin = f"{counted(len(means), 'turn-on')} in {counted(len(evidence.verifications), 'verification run')}"
        yield Contribution("turn-on to turn-on, drift since the calibration", "A", "normal", rms, "deg/h", 1.0,
                           float(len(means)), origin)  # fmt: skip


def _instruments(evidence: Evidence, rate_dps: float) -> Iterator[Contribution]:
    """Errors of reference instruments that act on the output at this rate."""
    rate_dph = rate_dps * DPH_PER_DPS
    slope = _slope(evidence)
    if slope is not None:
        yield from _stated(evidence, "degC", slope, "temperature at which the value holds")
    tilt = _earth_per_degree(evidence.manifest.orientation)
    if tilt:
        yield from _stated(evidence, "deg", tilt, "Earth rate by the direction of the axis")
    if not rate_dps:
        return
    scale = tuple(_stated(evidence, "ppm", 1e-6 * rate_dph, "scale of the rate"))
    tables = [tool for tool in evidence.instruments if tool.turns]
    if not any(stated.unit == "ppm" for tool in tables for stated in tool.uncertainty):
        yield _unknown("rate table", 1e-6 * rate_dph, "ppm")
    yield from scale
    aligned = tuple(_stated(evidence, "deg", rate_dph * np.radians(1.0) ** 2 / 2.0, "alignment of the axes"))
    yield from (replace(part, power=2) for part in aligned)
    if not aligned:
        yield _unknown("alignment of the axes", rate_dph, "deg")


def _earth_per_degree(orientation: Orientation | None) -> float:
    """Change of the Earth rate along the axis [deg/h] with a degree of error in its direction; 0: it is not removed."""
    if orientation is None:
        return 0.0
    latitude, azimuth = np.radians([orientation.latitude_deg, orientation.azimuth_deg or 0.0])
    level = np.hypot(np.cos(latitude) * np.sin(azimuth), np.sin(latitude))
    across = level if orientation.axis == "level" else np.cos(latitude)
    return float(np.radians(1.0) * EARTH_DPH * across)


def _unknown(source: str, sensitivity: float, unit: str) -> Contribution:
    origin = "not stated: give the instrument an `uncertainty` in equipment.yaml"
    return Contribution(source, "B", "unknown", np.nan, unit, sensitivity, np.inf, origin)


def _stated(evidence: Evidence, unit: Unit, sensitivity: float, what: str) -> Iterator[Contribution]:
    """Uncertainty and drift of every instrument that states one in a unit."""
    for tool in evidence.instruments:
        for stated in tool.uncertainty:
            if stated.unit != unit:
                continue
            origin = f"{tool.certificate or 'certificate not named'}, {tool.name} {tool.serial}"
            dof = stated.degrees_of_freedom or np.inf
            source = f"{tool.name}: {what}"
            yield Contribution(source, "B", stated.distribution, stated.standard, unit, sensitivity, dof,
                               origin, label=tool.serial)  # fmt: skip
            if stated.drift_per_year:
                drift = stated.drifted(tool.calibrated, day(evidence.manifest))
                yield Contribution(f"{tool.name}: drift since {tool.calibrated or 'a year'}", "B", "rectangular", drift,
                                   unit, sensitivity, np.inf, origin)  # fmt: skip


def _correlations(instruments: Sequence[Instrument]) -> dict[tuple[str, str], float]:
    return {
        (tool.serial, other.serial): other.coefficient
        for tool in instruments
        for other in tool.correlated_with
        if other.coefficient
    }


def _slope(evidence: Evidence) -> float | None:
    """Slope of what the verification left over temperature [deg/h/degC]."""
    check = evidence.verification
    if check is None:
        return None
    rows = np.isfinite(check.left) & ~turning(check.data)
    temperature = check.data.channel("temperature")[rows]
    if np.ptp(temperature) < STEP_DEGC:
        return None
    return float(np.polyfit(temperature, check.left[rows], 1)[0])


def _digital(evidence: Evidence) -> Iterator[Contribution]:
    """Steps of the unit's thermometer and of its output, whatever the data show of them already."""
    known = {quantity.name: quantity.value for quantity in evidence.quantities()}
    step = known.get("temperature_step_error_dph", 0.0)
    yield Contribution("steps of the unit's temperature sensor", "B", "rectangular", step, "deg/h", 1.0, np.inf,
                       "steps found in its values, times the RMS slope of the model")  # fmt: skip
    resolution = float(evidence.manifest.rate_step_dph or 0.0) / float(np.sqrt(12.0))
    yield Contribution("resolution of the output", "B", "rectangular", resolution, "deg/h", 1.0, np.inf,
                       "step of one sample by the DBC; an upper bound, since means resolve more")  # fmt: skip


def compared_thermometers(data: Dataset) -> list[dict[str, float]]:
    """The unit's thermometer less the air in the chamber [degC], where both stand still in a soak.

    The air is that of the station's reference thermometer where the run has one.
    """
    air = data.channels.get("reference_temperature", data.channels.get("chamber_temperature"))
    if air is None:
        return []
    rows = []
    still = np.isfinite(air) & (np.abs(np.nan_to_num(data.dT_dt, nan=np.inf)) < SETTLED_DEGC_PER_MIN)
    for segment in (one for one in data.segments if one.settles):
        own = still & (data.segment == segment.index)
        if np.count_nonzero(own) > 1:
            apart = (data.channel("temperature") - air)[own]
            rows.append({"chamber_degc": float(air[own].mean()), "difference_degc": float(apart.mean()),
                         "spread_degc": float(apart.std())})  # fmt: skip
    return rows
