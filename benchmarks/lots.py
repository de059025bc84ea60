"""Lots of simulated units: what one calibration for all costs, and which units are refused as unlike their lot.

The truth shares no equation with the models: quadrature that leaks at a phase, an Arrhenius term, a loop of relays, a
thermometer that lags, and noise. Units of a lot differ in every number. `python -m benchmarks.lots [UNITS...]`.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.analysis.effects.model import load_model
from bench.analysis.judging.likeness import Cells, likeness
from bench.analysis.judging.lot import Lot, calibrate_lot
from bench.base import FloatArray
from bench.record import Dataset

STEP_S = 30.0
SIZES = (50, 200)
NEW = 200
"""Further units of the lot, and units of each kind that is unlike it."""
LOTS = 25
"""Lots of each size, of which the shares that are refused are counted."""


@dataclass(frozen=True)
class Truth:
    """Numbers of one unit."""

    constant_dph: float
    leak_dph: float
    phase: float
    swell_dph: float
    swell_k: float
    loop_dph: float
    lag_s: float
    knee_dph: float = 0.0
    knee_degc: float = 0.0
    sign: float = 1.0


def member(random: np.random.Generator) -> Truth:
    """A unit of the lot."""
    return Truth(
        constant_dph=random.normal(6.0, 1.5),
        leak_dph=random.normal(9.0, 0.9),
        phase=random.normal(0.6, 0.06),
        swell_dph=random.normal(2.5, 0.35),
        swell_k=random.normal(32.0, 1.0),
        loop_dph=random.lognormal(np.log(0.15), 0.25),
        lag_s=random.uniform(20.0, 40.0),
    )


UNLIKE = {
    "another design (temperature effect 1.7 times)": lambda u, r: replace(u, leak_dph=1.7 * u.leak_dph),
    "mounted the wrong way round": lambda u, r: replace(u, sign=-1.0),
    "a resonance crosses (knee of 1 deg/h)": lambda u, r: replace(u, knee_dph=1.0, knee_degc=r.uniform(-25.0, 70.0)),
    "loose mount (loop 6 times)": lambda u, r: replace(u, loop_dph=6.0 * u.loop_dph),
    "thermometer badly bonded (lag 5 min more)": lambda u, r: replace(u, lag_s=u.lag_s + 300.0),
    "constant 6 standard deviations off": lambda u, r: replace(u, constant_dph=6.0 + 6.0 * 1.5),
}


def record(truth: Truth, name: str, seed: int) -> Dataset:
    """30 s means of a run down to -40, up to 85 and back, at 1 degC/min, with half an hour at each end."""
    random = np.random.default_rng(seed)
    knots = np.array(
        [(0, 25), (30, 25), (95, -40), (125, -40), (250, 85), (280, 85), (340, 25), (370, 25)], dtype=float
    )
    time: FloatArray = np.arange(0.5 * STEP_S, 60.0 * knots[-1, 0], STEP_S)
    case = np.interp(time, 60.0 * knots[:, 0], knots[:, 1])
    shown = behind(case, truth.lag_s)
    noise = random.normal(0.0, 0.08, time.size) + np.cumsum(random.normal(0.0, 0.004, time.size))
    channels = {"rate": still(truth, case) + noise, "temperature": shown + random.normal(0.0, 0.01, time.size)}
    return Dataset(name, time, channels, np.zeros(time.size, dtype=np.int64), interval_s=STEP_S, unit=name)


def still(truth: Truth, degc: FloatArray) -> FloatArray:
    """Bias (n,) along temperatures of the case [degC], without noise [deg/h]."""
    x = (degc - 25.0) / 65.0
    bias = truth.constant_dph + truth.leak_dph * np.sin(truth.phase + 0.35 * x) * (1.0 + 0.3 * np.tanh(1.5 * x))
    bias += truth.swell_dph * np.exp((degc - 85.0) / truth.swell_k)
    bias += truth.knee_dph * np.exp(-(((degc - truth.knee_degc) / 8.0) ** 2))
    return truth.sign * bias + truth.loop_dph * _relays(degc)


def behind(values: FloatArray, tau_s: float) -> FloatArray:
    """What follows values at a time constant."""
    out, keep = np.empty_like(values), np.exp(-STEP_S / tau_s)
    state = values[0]
    for i, value in enumerate(values.tolist()):
        state = value + (state - value) * keep
        out[i] = state
    return out


def _relays(values: FloatArray) -> FloatArray:
    """Relays with thresholds 4, 10 and 20 degC apart; the branches of their loop are 1 apart on the average."""
    centres, half = np.repeat(np.linspace(-30.0, 75.0, 22), 3), np.tile([2.0, 5.0, 10.0], 22)
    state = np.where(values[0] < centres, -1.0, 1.0)
    out = np.empty_like(values)
    for i, value in enumerate(values.tolist()):
        state = np.where(value > centres + half, 1.0, np.where(value < centres - half, -1.0, state))
        out[i] = state.sum()
    # Along a branch the relays within their half width differ: (4 + 10 + 20) degC / 5 degC relays, two states each.
    return out / (2.0 * 34.0 / 5.0)


def lot_of(size: int, seed: int = 1, model: str = "spline") -> Lot:
    """A calibrated lot."""
    random = np.random.default_rng(seed)
    records = [record(member(random), f"U{i:03d}", seed * 100_000 + i) for i in range(size)]
    return calibrate_lot(load_model(model), records)


def _means(
    cells: Cells, kind: str | None, count: int, random: np.random.Generator, seeds: Iterator[int]
) -> list[FloatArray]:
    """Cells of new units of a kind; None: of the lot itself. A seed of the noise for each."""
    made = (member(random) for _ in range(count))
    changed = (unit if kind is None else UNLIKE[kind](unit, random) for unit in made)
    return [cells.means([record(unit, "X", next(seeds))]) for unit in changed]


def refused(lot: Lot, kind: str | None, count: int, seed: int) -> float:
    """Share of new units of a kind that are refused; None: of the lot itself."""
    units = _means(lot.cells, kind, count, np.random.default_rng(seed), itertools.count(seed * 100_000))
    return float(np.mean([not one.like for one in likeness(lot.table, lot.cells, units)]))


def many_lots(sizes: Sequence[int], count: int) -> Iterator[tuple[str, list[FloatArray]]]:
    """Shares of new units of each kind that are refused (lots,), for each size; the lots are drawn from one pool."""
    random, cells = np.random.default_rng(50), Cells.over(-38.0, 84.0)
    seeds = iter(lambda: int(random.integers(1 << 40)), -1)
    own = np.array(_means(cells, None, 2 * max(sizes) + count, random, seeds))
    drawn = [[random.permutation(len(own)) for _ in range(LOTS)] for _ in sizes]
    for kind in (None, *UNLIKE):
        others = None if kind is None else _means(cells, kind, count, random, seeds)
        shares = []
        for size, orders in zip(sizes, drawn, strict=True):
            found = []
            for order in orders:
                new = others if others is not None else list(own[order[size : size + count]])
                found.append([not one.like for one in likeness(own[order[:size]], cells, new)])
            shares.append(np.mean(found, axis=1))
        yield kind or "of the lot", shares


def losses(lot: Lot) -> Iterator[tuple[str, FloatArray]]:
    """Loss of each unit against its own calibration [deg/h RMS]."""
    own = np.array([loss.own_rms_dph for loss in lot.losses])
    yield "its own calibration", own
    yield "the lot's calibration", np.array([loss.lot_rms_dph for loss in lot.losses])
    yield "the lot's, and a constant of its own", np.array([loss.levelled_rms_dph for loss in lot.losses])


def main(sizes: tuple[int, ...] = SIZES, count: int = NEW) -> None:
    """Print both tables."""
    for size in sizes:
        lot = lot_of(size)
        print(f"\nlot of {size}\n\n| error [deg/h RMS] | median | 95 % |\n|---|---|---|")
        for name, values in losses(lot):
            print(f"| {name} | {np.median(values):.3f} | {np.quantile(values, 0.95):.3f} |")
    print(f"\n{count} new units beside {LOTS} lots of each size: refused, mean (lowest to highest of a lot)\n")
    print(f"| | {' | '.join(f'lots of {size}' for size in sizes)} |\n|---|{'---|' * len(sizes)}")
    for kind, shares in many_lots(sizes, count):
        cells = (f"{100 * one.mean():.1f} % ({100 * one.min():.0f} to {100 * one.max():.0f})" for one in shares)
        print(f"| {kind} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(tuple(int(word) for word in sys.argv[1:]) or SIZES)
