"""What a calibration of an inertial unit leaves unexplained, and what of: an axis, a die, the fixture or the place.

Order: first what makes all else meaningless (outputs, signs, attitudes), then fixture, table and place, then what each
axis lacks. A missing effect is named where the likelihood gains more than its parameters cost (G. Schwarz, Annals of
Statistics 6 (1978) 461) by a margin; those that gain nearly as much are its look-alikes. Two axes of a triad with one
effect and one time constant have it from their die.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.effects.base import Effect
from bench.analysis.effects.hysteresis import Hysteresis
from bench.analysis.effects.thermal_lag import ThermalLag
from bench.analysis.fit.solve import one_blas_thread
from bench.analysis.imu.curves import Reference
from bench.analysis.imu.fitting import AxisFit, ImuFit, fit_axis, fit_imu
from bench.analysis.imu.mounting import Finding, believed, place, straightened, turned, wiring, world
from bench.analysis.imu.scatter import ATTITUDES
from bench.analysis.imu.triad import Curve, Triad, TriadModel
from bench.record import AXES

MARGIN = 12.0
"""Twice the logarithm of the likelihood, less what the parameters cost, from which on an effect is named."""
TIE = 6.0
_SAME = 1.6
"""Ratio of time constants or widths up to which they count as one."""


@dataclass(frozen=True)
class Candidate:
    """One thing that an axis may lack."""

    family: str
    model: TriadModel
    effects: tuple[Effect, ...] = ()


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is wrong, worst first, and the fit beside which it was found."""

    findings: tuple[Finding, ...]
    fit: ImuFit

    @property
    def causes(self) -> tuple[tuple[str, str], ...]:
        """Cause and place of each finding."""
        return tuple((finding.cause, finding.where) for finding in self.findings)


def diagnose_imu(
    gyro: Triad,
    accelerometer: Triad,
    latitude_deg: float,
    model: TriadModel | None = None,
    reference: Reference | None = None,
) -> Diagnosis:
    """Everything that is wrong with a unit, its fixture and its place, as far as these rows show it."""
    model = model or TriadModel()
    findings, (first, second) = wiring(gyro, accelerometer)
    gyro, accelerometer = straightened(gyro, first), straightened(accelerometer, second)
    with one_blas_thread():
        seen = world(gyro, accelerometer, model)
        around = place(seen, latitude_deg)
        gyro, accelerometer = believed(gyro, seen, around), believed(accelerometer, seen, around)
        findings += around
        fit = fit_imu(gyro, accelerometer, model, reference=reference)
        findings += turned(fit)
        for data, triad in ((gyro, fit.gyro), (accelerometer, fit.accelerometer)):
            known = {name: value for name, value in triad.axes[0].scatter.variances.items() if name in ATTITUDES}
            lacking = [_lacks(data, axis, model, triad.axes[axis], known) for axis in range(3)]
            findings += _joined(data.kind, lacking)
    return Diagnosis(tuple(findings), fit)


def candidates(model: TriadModel, kind: str) -> list[Candidate]:
    """What an axis may lack, beside this model."""
    found = [
        Candidate("thermal_lag", model, (ThermalLag(),)),
        Candidate("hysteresis", model, (Hysteresis(),)),
        Candidate("hysteresis", model, (Hysteresis(shape="bouc_wen"),)),
    ]
    if kind == "gyro":
        steeper = Curve(1) if model.g_sensitivity is None else replace(
            model.g_sensitivity, order=model.g_sensitivity.order + 1
        )  # fmt: skip
        found.append(Candidate("g_sensitivity", replace(model, g_sensitivity=steeper)))
    return found


def _lacks(
    data: Triad, axis: int, model: TriadModel, base: AxisFit, known: dict[str, float]
) -> tuple[Finding, AxisFit] | None:
    """The effect that an axis lacks most, None where there is none."""
    rows, tried = len(data.time), []
    for candidate in candidates(model, data.kind):
        fit = fit_axis(data, axis, candidate.model, candidate.effects, known, base.scatter)
        more = len(fit.beta) + sum(len(own) for own in fit.theta.values()) - len(base.beta)
        gain = 2.0 * (fit.solution.log_likelihood - base.solution.log_likelihood) - more * np.log(rows)
        tried.append((float(gain), candidate.family, fit))
    best, family, fit = max(tried, key=lambda one: one[0])
    if best < MARGIN:
        return None
    others = {name for gain, name, _ in tried if name != family and gain > best - TIE}
    values = ", ".join(f"{name} {value:.3g}" for own in fit.theta.values() for name, value in own.items())
    where = f"{data.kind} {AXES[axis]}"
    text = f"{where} lacks {family}{f' ({values})' if values else ''}: evidence {best:.0f}, {MARGIN:g} is needed"
    return Finding(family, where, text, tuple(sorted(others))), fit


def _joined(kind: str, lacking: Sequence[tuple[Finding, AxisFit] | None]) -> list[Finding]:
    """Findings of three axes; one of the die where two or three axes have the same."""
    present = [one for one in lacking if one is not None]
    for family in {finding.cause for finding, _ in present}:
        mine = [(finding, fit) for finding, fit in present if finding.cause == family]
        values = [value for _, fit in mine for own in fit.theta.values() for value in own.values()]
        if len(mine) >= 2 and values and max(values) < _SAME * min(values):
            axes = ", ".join(finding.where.split()[-1] for finding, _ in mine)
            text = f"{kind} axes {axes} lack the same {family}: their die ({'; '.join(f.text for f, _ in mine)})"
            others = [finding for finding, _ in present if finding.cause != family]
            return [Finding(family, f"{kind} die", text), *others]
    return [finding for finding, _ in present]
