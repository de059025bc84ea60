"""Refit of a large fleet: units per second, serial, in a pool and on Dask; checks that all results agree bit for bit.

    python -m benchmarks.fleet_refit --units 100000 --model "spline 24" --engine serial --engine dask:1 --engine dask:2

Each simulated unit is a run of 8.4 h at 30 s means (1006 rows, two cycles of -40 to 85 degC) with a separate bias
curve, noise and gaps; only its moments are kept.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from bench.analysis.effects.model import Model
from bench.analysis.effects.polynomial import Polynomial
from bench.analysis.effects.regression import Regression
from bench.analysis.effects.spline import Spline
from bench.analysis.fit.moments import Moments
from bench.archive.fleet import engines, moments_file
from bench.archive.fleet.refit import refits, write_records
from bench.record.dataset import Dataset

ROWS, INTERVAL_S = 1006, 30.0
MODELS = {
    "spline 24": Model("spline 24", (Spline(24),)),
    "regression": Model("regression", (Regression(),)),
    "polynomial": Model("polynomial", (Polynomial(),)),
}


def unit(number: int) -> Dataset:
    """A simulated run; the same for the same number."""
    random = np.random.default_rng(number)
    time_s = (np.arange(ROWS) + 0.5) * INTERVAL_S
    temperature = 22.5 - 62.5 * np.cos(4 * np.pi * time_s / time_s[-1]) + random.normal(0.0, 0.01, ROWS)
    x = temperature / 60.0
    a = random.normal([12.0, 3.0, -2.0, 1.5, 0.4], [5.0, 1.0, 1.0, 0.5, 0.2])
    bias = a[0] + a[1] * x + a[2] * x**2 + a[3] * x**3 + a[4] * np.sin(4 * x) + random.normal(0.0, 0.1, ROWS)
    channels = {
        "rate": np.where(random.random(ROWS) < 0.001, np.nan, bias),
        "temperature": temperature,
        "frequency": 14000.0 * (1 - 25e-6 * temperature) + random.normal(0.0, 0.05, ROWS),
        "drive": 2.5 + 2e-4 * temperature + random.normal(0.0, 1e-4, ROWS),
        "quadrature": 0.05 + 3e-4 * temperature + random.normal(0.0, 1e-4, ROWS),
    }
    return Dataset(f"run-{number}", time_s, channels, np.zeros(ROWS, np.int64), (), INTERVAL_S)


def fleet(units: int) -> Iterator[moments_file.Stored]:
    """Moments of units 0, 1, 2 …; every ten-thousandth is damaged and must fail alone."""
    for number in range(units):
        values = Moments.of([unit(number)]).pack()
        if number % 10_000 == 9_999:
            values[300] = np.nan
        yield moments_file.Stored(f"U-{number:06d}", f"run-{number}", "", values)


def engine(name: str) -> engines.Engine:
    """serial, pool:N or dask:N."""
    kind, _, workers = name.partition(":")
    count = int(workers or 1)
    return engines.dask_engine(count, None) if kind == "dask" else engines.local_engine(count)


def digest(path: Path) -> str:
    """SHA-256 over every number of the records."""
    table = pq.read_table(path)
    return hashlib.sha256(repr(table.to_pydict()).encode()).hexdigest()[:16]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--units", type=int, default=100_000)
    parser.add_argument("--folder", type=Path, default=Path("fleet_refit"))
    parser.add_argument("--engine", action="append")
    parser.add_argument("--model", action="append")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    source = options.folder / f"moments_{options.units}.parquet"
    if not source.exists():
        begun = time.perf_counter()
        moments_file.write(source, fleet(options.units))
        print(f"simulated in {time.perf_counter() - begun:.0f} s, {source.stat().st_size / 1e6:.0f} MB")
    print(f"{'model':<12} {'engine':<8} {'s':>7} {'units/s':>8} {'failed':>6}  digest            own peak MB")
    for model in options.model or ["spline 24"]:
        for name in options.engine or ["serial", "pool:2", "dask:1", "dask:2"]:
            target = options.folder / "records.parquet"
            begun = time.perf_counter()
            records = engine(name)(refits(MODELS[model]), moments_file.stored_groups(source))
            count, failed = write_records(target, MODELS[model], records)
            took = time.perf_counter() - begun
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            print(f"{model:<12} {name:<8} {took:7.1f} {count / took:8.0f} {failed:6d}  {digest(target)}  {peak:6.0f}")


if __name__ == "__main__":
    main()
