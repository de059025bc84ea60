"""Inertial units of which each has a truth of its own: what calibration and diagnosis find of it.

    python -m benchmarks.imu --units 60 --seed 1 --out imu.jsonl

Each unit is calibrated by a tumble and the rate table at five temperatures and ramps between (`imu_data.calibration`).
Counted are: the parameters that lie within their U, at three temperatures, also of a plan of an hour; the scatter of
the corrected outputs in another run, of other attitudes, rates and ramps, over that of the truth's own inverse; of
units that have something hidden in one axis, how often axis and family are named and nothing else; of units whose
outputs, fixture or place are not as stated, how often that is named. Results are appended to the file as they come;
what stands there already is not run again. Prints one JSON object; exit code 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from bench.analysis.imu.diagnosis import Diagnosis, diagnose_imu
from bench.analysis.imu.fitting import ImuFit, fit_imu
from bench.analysis.imu.triad import Curve, TriadModel
from bench.base.channels import FloatArray
from benchmarks import campaigns, imu_data
from drivers.sim.truth.imu.drawn import drawn

TEMPERATURES = (-35.0, 25.0, 80.0)
HELD = (0.92, 0.98)
"""Share of the parameters within U = 2 u, of every kind."""
WORST_RATIO = 1.15
SHORT_TEMPERATURES = (21.0, 32.0, 44.0)
KINDS = ("parameters", "short", "hidden", "around")
HIDDEN = ("thermal_lag", "hysteresis", "g_sensitivity", "")
STRENGTH: dict[str, dict[str, Any]] = {
    "thermal_lag": {"lag_s": 30.0}, "hysteresis": {"loop": 10.0}, "": {},
    "g_sensitivity": {"g_sensitivity_per_degc": (0.15, -0.15, 0.15)},
}  # fmt: skip
"""Strength 1: a die behind its thermometer, the loop and one percent per degC of the g-sensitivity of a MEMS gyro."""
STEADY = {"g_sensitivity_per_degc": (0.0, 0.0, 0.0)}
FAULTS = ("swapped_axes", "wrong_sign", "unit turned", "fixture tilted", "latitude")
CAUSES = {"unit turned": "fixture_rotation", "fixture tilted": "fixture_rotation"}
TILT_DEG = 0.5
SHORT = ((-40.0, 20.0, 85.0), 2.0)
"""Temperatures and ramps [degC/min] of the calibrations that are diagnosed."""
NAMED = 0.95
Result = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One simulated unit and what is done with it."""

    kind: str
    number: int


def cases(units: int) -> Iterator[Case]:
    """All of them, unit by unit, so that a campaign cut short is a smaller campaign."""
    for number in range(units):
        yield from (Case(kind, number) for kind in KINDS)


def run_case(case: Case, seed: int) -> Result:
    """What was found of one unit."""
    own = 1000 * seed + case.number
    if case.kind == "parameters":
        return parameters(own)
    if case.kind == "short":
        return {"errors": errors(own, imu_data.short(own), SHORT_TEMPERATURES)[1]}
    return hidden(case.number, own) if case.kind == "hidden" else around(case.number, own)


def hidden(number: int, seed: int) -> Result:
    """What is named of a unit that has something hidden in one gyro, or nothing in every fourth unit."""
    family, axis, settings = HIDDEN[number % 4], (number // 4) % 3, drawn(seed)
    constant = family in {"g_sensitivity", ""}
    model = TriadModel(g_sensitivity=Curve(0)) if constant else TriadModel()
    gyros = [gyro.model_copy(update=STEADY if constant else {}) for gyro in settings.gyros]
    gyros[axis] = gyros[axis].model_copy(update=STRENGTH[family])
    settings = settings.model_copy(update={"gyros": tuple(gyros)})
    data = imu_data.record(settings, imu_data.at_home(), seed, imu_data.calibration(seed, *SHORT))
    found = diagnose_imu(*data, imu_data.LATITUDE_DEG, model)
    return {"wanted": [family, f"gyro {'xyz'[axis]}"] if family else [], **_told(found)}


def around(number: int, seed: int) -> Result:
    """What is named of a unit whose outputs are swapped, or whose fixture or place are not as stated."""
    rng = np.random.default_rng([seed, 29])
    fault, home, change = FAULTS[number % len(FAULTS)], imu_data.at_home(), np.eye(3)
    direction = rng.standard_normal(3)
    i, j = rng.permutation(3)[:2].tolist()
    if fault == "swapped_axes":
        change[[i, j]] = change[[j, i]]
    elif fault == "wrong_sign":
        change[i, i] = -1.0
    elif fault == "unit turned":
        home = imu_data.at_home(unit_in_fixture_deg=_sized(direction))
    elif fault == "fixture tilted":
        home = imu_data.at_home(fixture_on_table_deg=_sized(direction * [1.0, 1.0, 0.0]))
    else:
        home = imu_data.at_home(latitude_deg=imu_data.LATITUDE_DEG + float(rng.choice([-10.0, 10.0])))
    gyro, accelerometer = imu_data.record(drawn(seed), home, seed, imu_data.calibration(seed, *SHORT))
    if rng.random() < 0.5:
        gyro = replace(gyro, output=gyro.output @ change)
    else:
        accelerometer = replace(accelerometer, output=accelerometer.output @ change)
    found = diagnose_imu(gyro, accelerometer, imu_data.LATITUDE_DEG)
    return {"fault": fault, "wanted": CAUSES.get(fault, fault), **_told(found)}


def _sized(direction: FloatArray) -> tuple[float, ...]:
    return tuple((TILT_DEG * direction / np.linalg.norm(direction)).tolist())


def _told(found: Diagnosis) -> Result:
    return {"named": [list(cause) for cause in found.causes], "told": [finding.text for finding in found.findings]}


def parameters(seed: int) -> Result:
    """Of every kind of parameter the errors in units of U; of every axis the scatter in the other run."""
    fit, found = errors(seed, imu_data.calibration(seed), TEMPERATURES)
    unseen = imu_data.record(drawn(seed), imu_data.at_home(), seed + 500_000, imu_data.check(seed))
    return {"errors": found, "scatter": imu_data.scatters(drawn(seed), fit, unseen)}


def errors(
    seed: int, plan: Sequence[imu_data.Move], temperatures: Sequence[float]
) -> tuple[ImuFit, dict[str, list[float]]]:
    """The fit of a unit by a plan, and of every kind of parameter the errors at the temperatures, in units of U."""
    settings = drawn(seed)
    fit = fit_imu(*imu_data.record(settings, imu_data.at_home(), seed, plan))
    found: dict[str, list[float]] = {}
    for triad in fit.triads:
        for degc in temperatures:
            true = dict(imu_data.truth(settings, triad.kind, degc))
            for one in triad.estimates([degc]):
                error = (one.value - true[one.name]) / one.U
                found.setdefault(f"{triad.kind} {one.kind}", []).append(round(error, 4))
    return fit, found


def table(results: Sequence[tuple[Case, Result]]) -> list[dict[str, Any]]:
    """One row for each bar."""
    rows = []
    for which, words in (("short", "an hour's plan: "), ("parameters", "")):
        mine = [found for case, found in results if case.kind == which]
        for kind in mine[0]["errors"] if mine else ():
            all_errors = np.array([error for found in mine for error in found["errors"][kind]])
            held = int(np.sum(np.abs(all_errors) <= 1.0))
            rows.append(_share(f"{words}{kind} within U", held, all_errors.size, len(mine)))
    for triad in ("gyro", "accelerometer") if mine else ():
        squares = np.mean([np.square(found["scatter"][triad]) for found in mine], axis=(0, 1))
        ratio = float(np.sqrt(squares[0] / squares[1]))
        worst = {"what": f"{triad} corrected, unseen run, over the true model", "units": len(mine)}
        rows.append({**worst, "ratio": round(ratio, 4), "missed": ratio > WORST_RATIO})
    of_hidden = [found for case, found in results if case.kind == "hidden"]
    for family in HIDDEN:
        if not (own := [found for found in of_hidden if (found["wanted"] or [""])[0] == family]):
            continue
        right = sum(found["named"] == ([found["wanted"]] if family else []) for found in own)
        rows.append(_named(f"{family} hidden in one gyro, axis and family" if family else "nothing hidden", right, own))
    of_around = [found for case, found in results if case.kind == "around"]
    for fault in FAULTS:
        if not (own := [found for found in of_around if found["fault"] == fault]):
            continue
        rows.append(_named(fault, sum(found["wanted"] in [cause for cause, _ in found["named"]] for found in own), own))
    return rows


def _named(what: str, right: int, of: Sequence[Result]) -> dict[str, Any]:
    ends = binomtest(right, len(of)).proportion_ci(0.95, method="exact")
    interval = [round(ends.low, 3), round(ends.high, 3)]
    return {"what": what, "n": len(of), "right": right, "interval": interval, "missed": bool(right < NAMED * len(of))}


def _share(what: str, held: int, of: int, units: int) -> dict[str, Any]:
    """A share of values; those of one unit hang together, so its interval is that of a share of axes."""
    ends = binomtest(round(held / of * 3 * units), 3 * units).proportion_ci(0.95, method="exact")
    share, outside = held / of, ends.high < HELD[0] or ends.low > HELD[1]
    interval = [round(ends.low, 3), round(ends.high, 3)]
    row = {"what": what, "units": units, "n": of, "share": round(share, 4), "interval": interval}
    return {**row, "missed": bool(outside)}


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this one; repeatable")
    parser.add_argument("--out", type=Path, default=Path("imu.jsonl"))
    arguments = parser.parse_args()
    todo = [case for case in cases(arguments.units) if case.kind in (arguments.kind or KINDS)]
    rows = table(campaigns.found(todo, lambda case: run_case(case, arguments.seed), arguments.out, Case))
    print(json.dumps({"seed": arguments.seed, "table": rows}, indent=1))
    return 1 if any(row["missed"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
