"""Simulated calibrations of inertial units: tumble, table and ramps, and the runs that check them.

The truth is `drivers.sim.truth.imu`; what it was given as inputs is thrown away, but for judging. The bench gets what a
laboratory has: outputs, thermometers, attitudes as commanded, the table's encoder.

    python -m benchmarks.imu_data FOLDER

writes the table and the plan of such a calibration to FOLDER, for `bench imu FOLDER/imu.csv --plan FOLDER/imu.yaml`,
and those of a check of the same unit, `check.csv` and `check.yaml`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from bench.analysis.imu.attitudes import Stay, gravity_at, inputs
from bench.analysis.imu.fitting import ImuFit
from bench.analysis.imu.triad import Triad
from bench.base.channels import FloatArray
from bench.record.attitudes import ATTITUDES, Attitude, faces, tumble
from bench.record.dataset import Dataset
from drivers.sim.truth.imu.mounting import MountingSettings, Stand
from drivers.sim.truth.imu.unit import ImuSettings, SimulatedImu, respond

ROW_S = 60
LATITUDE_DEG = 47.0
SOAKS_DEGC = (-40.0, -10.0, 25.0, 55.0, 85.0)


@dataclass(frozen=True)
class Move:
    """One minute or more: an attitude, a rate of the table, the case's temperature from its last value to this."""

    attitude: Attitude
    turn_dps: float
    to_degc: float
    rows: int = 1


@dataclass(frozen=True)
class Lab:
    """What the laboratory believes of where it is; the truth is in `MountingSettings`."""

    latitude_deg: float = LATITUDE_DEG


def at_home(**changes: object) -> MountingSettings:
    """A mounting in order at the laboratory's place, with changes."""
    return MountingSettings(latitude_deg=LATITUDE_DEG, gravity=gravity_at(LATITUDE_DEG)).model_copy(update=changes)


def calibration(seed: int, soaks: Sequence[float] = SOAKS_DEGC, degc_per_min: float = 1.0) -> list[Move]:
    """At five temperatures a tumble and each axis on the table at four rates, both ends up; ramps between."""
    rng = np.random.default_rng([seed, 19])
    plan: list[Move] = []
    here = 25.0
    table = [(face, 120.0 if face.name.endswith("_up") else 90.0) for face in faces()]
    for soak in soaks:
        plan += _ramp(here, soak, degc_per_min, tumble(24), rng)
        plan += [Move(attitude, 0.0, soak) for attitude in tumble(12)]
        plan += [Move(face, sign * rate, soak) for face, rate in table for sign in (1.0, -1.0)]
        here = soak
    return [*plan, *_ramp(here, 25.0, degc_per_min, tumble(24), rng)]


def short(seed: int) -> list[Move]:
    """About an hour, as `profiles/imu_quick.yaml`: table at three temperatures, tumbles throughout two ramps."""
    rng = np.random.default_rng([seed, 31])

    def table(rate: float, degc: float) -> list[Move]:
        return [Move(face, sign * rate, degc) for face in faces() for sign in (1.0, -1.0)]

    up, down = _ramp(15.0, 45.0, 1.25, tumble(24), rng), _ramp(45.0, 25.0, 1.6, tumble(12), rng)
    return [*table(60.0, 15.0), *up, *table(90.0, 45.0), *down, *table(60.0, 25.0)]


def check(seed: int) -> list[Move]:
    """Other attitudes, other rates and another ramp."""
    rng = np.random.default_rng([seed, 23])
    random = [Attitude.of(f"random {i}", _three(rng.standard_normal(3)), rng.uniform(0, 360)) for i in range(20)]
    plan = _ramp(20.0, 70.0, 2.0, random, rng)
    plan += [Move(a, float(rng.choice([-72.0, 48.0, 96.0, 0.0])), 70.0) for a in random]
    plan += _ramp(70.0, -30.0, 2.0, random, rng)
    return plan + [Move(a, float(rng.choice([-72.0, 48.0, 96.0, 0.0])), -30.0) for a in random]


def _three(v: FloatArray) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def _ramp(
    start: float, end: float, speed: float, attitudes: Sequence[Attitude], rng: np.random.Generator
) -> list[Move]:
    minutes = max(1, round(abs(end - start) / speed))
    order = rng.permutation(len(attitudes))
    steps = np.linspace(start, end, minutes + 1)[1:]
    return [Move(attitudes[order[(i // 3) % len(order)]], 0.0, float(t)) for i, t in enumerate(steps)]


def record(
    settings: ImuSettings, mounting: MountingSettings, seed: int, plan: Iterable[Move], lab: Lab | None = None
) -> tuple[Triad, Triad]:
    """Gyros and accelerometers of a simulated run, in rows of a minute, as the laboratory believes them driven."""
    imu = SimulatedImu(settings, mounting, seed)
    outputs, warm, seconds, stays = [], [], [], []
    here, visit, last = 25.0, 0, None
    names: dict[str, int] = {}
    for move in plan:
        visit += move.attitude.name != last
        last = move.attitude.name
        number = names.setdefault(move.attitude.name, len(names))
        case = np.linspace(here, move.to_degc, ROW_S * move.rows + 1)[1:]
        begun, here = imu.mounting.angle_deg, move.to_degc
        signals = imu.stay(Stand(len(case), move.attitude.matrix, move.turn_dps, visit), case)
        seconds.append(signals.temperatures)
        for row in range(move.rows):
            rows = slice(row * ROW_S, (row + 1) * ROW_S)
            outputs.append(np.concatenate([signals.rate[rows].mean(axis=0), signals.acceleration[rows].mean(axis=0)]))
            warm.append(signals.temperatures[rows].mean(axis=0))
            angle = begun + move.turn_dps * ROW_S * (row + 0.5)
            stays.append((move.attitude.matrix, angle, move.turn_dps, visit, number))
    return _triads(np.array(outputs), np.array(warm), np.concatenate(seconds), stays, lab or Lab())


def written(
    settings: ImuSettings, mounting: MountingSettings, seed: int, plan: Sequence[Move], folder: Path, name: str = "imu"
) -> None:
    """`imu.csv`, the outputs second by second, and `imu.yaml`, the plan, as `bench imu` reads them."""
    imu, here, visit, last = SimulatedImu(settings, mounting, seed), 25.0, 0, ""
    pieces, stays = [], []
    for i, move in enumerate(plan):
        visit, last = visit + (move.attitude.name != last), move.attitude.name
        case = np.linspace(here, move.to_degc, ROW_S + 1)[1:]
        here = move.to_degc
        signals = imu.stay(Stand(ROW_S, move.attitude.matrix, move.turn_dps, visit), case)
        table = np.full((ROW_S, 1), move.turn_dps)
        pieces.append(np.hstack([signals.rate, signals.acceleration, signals.temperatures, table]))
        if stays and stays[-1][1] == last:
            stays[-1][0]["to_s"] = float(ROW_S * (i + 1))
        else:
            times = {"from_s": float(ROW_S * i), "to_s": float(ROW_S * (i + 1))}
            stays.append(({**times, **_as_planned(move.attitude)}, last))
    values = np.vstack(pieces)
    channels = [*(f"{what}_{a}" for what in ("rate", "acceleration") for a in "xyz")]
    channels += [*(f"temperature_{k}" for k in (1, 2, 3, 4)), "applied_rate"]
    frame = pd.DataFrame(values, columns=channels)
    frame.insert(0, "time", np.arange(len(values)) + 0.5)
    frame.to_csv(folder / f"{name}.csv", index=False, float_format="%.9g")
    gyros, others = ["temperature_1", "temperature_2", "temperature_3"], ["temperature_4"] * 3
    content = {"latitude_deg": LATITUDE_DEG, "row_s": float(ROW_S), "gyro_thermometers": gyros,
               "accelerometer_thermometers": others, "stays": [stay for stay, _ in stays]}  # fmt: skip
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _as_planned(attitude: Attitude) -> dict[str, object]:
    """An attitude as a stay of a plan names it: one without a name by what points up, and its heading."""
    if attitude.name in ATTITUDES:
        return {"attitude": attitude.name}
    up = _three(attitude.matrix[:, 2])
    turned = Attitude.of("", up).matrix.T @ attitude.matrix
    heading = float(np.degrees(np.arctan2(turned[0, 1], turned[0, 0])))
    return {"up": [round(value, 9) for value in up], "heading_deg": round(heading, 6)}


def _triads(
    outputs: FloatArray, warm: FloatArray, seconds: FloatArray,
    stays: Sequence[tuple[FloatArray, float, float, int, int]], lab: Lab,
) -> tuple[Triad, Triad]:  # fmt: skip
    stay = Stay(
        np.array([s[0] for s in stays]), np.array([s[1] for s in stays]), np.array([s[2] for s in stays]), float(ROW_S)
    )
    rate, force = inputs(stay, lab.latitude_deg)
    time = ROW_S * (np.arange(len(outputs)) + 0.5)
    each = np.arange(0, len(seconds), 10)
    histories = tuple(_history(each + 0.5, seconds[each, i]) for i in (0, 1, 2, 3))
    visit, attitude = (np.array([s[k] for s in stays], dtype=np.int64) for k in (3, 4))
    gyro = Triad(
        "gyro", time, outputs[:, :3], warm[:, :3], rate, force, stay, visit, attitude, float(ROW_S), histories[:3]
    )
    common = np.repeat(warm[:, 3:], 3, axis=1)
    kept = (histories[3],) * 3
    return gyro, replace(gyro, kind="accelerometer", output=outputs[:, 3:], temperature=common, history=kept)


def _history(time: FloatArray, temperature: FloatArray) -> Dataset:
    segment = np.zeros(len(time), dtype=np.int64)
    return Dataset("imu", time, {"temperature": temperature}, segment, interval_s=10.0)


def truth(settings: ImuSettings, kind: str, temperature: float) -> Iterator[tuple[str, float]]:
    """The parameters of a truth at one temperature of all elements, from its answers to inputs that differ."""
    zero, degc = np.zeros((1, 3)), [np.array([temperature])] * 6
    gyro = kind == "gyro"
    columns, size = (slice(0, 3), 1e5) if gyro else (slice(3, 6), 10.0)

    def out(rate: FloatArray = zero, force: FloatArray = zero) -> FloatArray:
        return respond(settings, rate, force, degc)[0]

    def driven(k: int, sign: float) -> FloatArray:
        one = zero + sign * size * np.eye(3)[k]
        return (out(rate=one) if gyro else out(force=one))[columns]

    bias = out()[columns]
    matrix = np.stack([(driven(k, 1.0) - driven(k, -1.0)) / (2.0 * size) for k in range(3)], axis=1)
    pulled = np.stack([out(force=zero + 9.80665 * np.eye(3)[k])[:3] - out()[:3] for k in range(3)], axis=1)
    for i, axis in enumerate("xyz"):
        own = f"{kind} {axis}"
        yield f"{own}: bias", float(bias[i])
        yield f"{own}: scale factor", 1e6 * float(matrix[i, i] - 1.0)
        for k in (k for k in range(3) if k != i):
            yield f"{own}: misalignment towards {'xyz'[k]}", 1e3 * float(matrix[i, k])
        if gyro:
            for k in range(3):
                yield f"{own}: g-sensitivity along {'xyz'[k]}", float(pulled[i, k])
        else:
            second = (driven(i, 1.0) + driven(i, -1.0) - 2.0 * bias)[i] / 2.0 / size**2 * 9.80665
            yield f"{own}: second order", 1e6 * float(second)


def scatters(settings: ImuSettings, fit: ImuFit, unseen: Sequence[Triad]) -> dict[str, list[list[float]]]:
    """Of each triad and axis the scatter of the corrected outputs against what the laboratory believes, and of those
    of the true model.

    Not the mean of an axis over the unseen run: between two runs a bias wanders, which no model knows.
    """
    gyro, accelerometer = unseen
    own_rate, own_force = fit.corrected(gyro, accelerometer)
    true_force = _inverse(settings, accelerometer, None)
    true_rate = _inverse(settings, gyro, true_force)
    return {
        data.kind: np.stack([np.std(found - data.driving, axis=0) for found in (own, true)], axis=1).tolist()
        for own, true, data in ((own_rate, true_rate, gyro), (own_force, true_force, accelerometer))
    }


def _inverse(settings: ImuSettings, data: Triad, force: FloatArray | None) -> FloatArray:
    """Inputs (n, 3) with which the truth itself would give these outputs, by Newton's method without its formulas."""
    found = data.output.copy()
    columns = slice(0, 3) if data.kind == "gyro" else slice(3, 6)
    inner = [data.temperature[:, i % 3] for i in range(6)]
    for _ in range(6):
        rate, pull = (found, force) if force is not None else (found, found)
        found = found - (respond(settings, rate, pull, inner)[:, columns] - data.output)
    return found


if __name__ == "__main__":
    from drivers.sim.truth.imu.drawn import drawn

    Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
    written(drawn(1), at_home(), 1, calibration(1, degc_per_min=2.0), Path(sys.argv[1]))
    written(drawn(1), at_home(), 2, check(1), Path(sys.argv[1]), "check")
