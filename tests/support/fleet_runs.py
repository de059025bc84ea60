"""A production line of run folders, as small as the registry allows: two stations, lots of 40, wished-for faults.

And a fleet of which only the moments are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis.fit.moments import Moments
from bench.archive.fleet.moments_file import Stored
from bench.record import Dataset, Manifest
from tests.support.run_folders import keep

BEGIN = datetime(2026, 3, 1, tzinfo=UTC)
LIMITS = """
name: line
limits:
  - {quantity: residual_rms_dph, unit: deg/h, upper: 0.2, reason: budget}
  - {quantity: angle_random_walk_dprh, unit: deg/sqrt(h), upper: 0.02, reason: data sheet}
"""


def line(
    root: Path, units: int = 200, *, drift_dph_per_day: float = 0.0, odd: int | None = None, lot: str = ""
) -> None:
    """Runs of `units`: station B drifts by `drift_dph_per_day` in noise floor; unit `odd` and the lot `lot` differ."""
    random = np.random.default_rng(3)
    for number in range(units):
        name, days = f"L{number // 40}-{number:04d}", number / 5.0
        floor, rms, walk = random.normal((0.1, 0.12, 0.01), (0.003, 0.004, 0.0003))
        floor += drift_dph_per_day * days * (number % 2) + 0.02 * (name.startswith(f"{lot}-") if lot else 0)
        if number == odd:
            walk *= 1.5
        station(root, name, f"station-{'AB'[number % 2]}", days, residual=rms, floor=floor, walk=walk)


def station(
    root: Path,
    unit: str,
    where: str,
    days: float,
    *,
    residual: float,
    floor: float = 0.1,
    walk: float = 0.01,
    **manifest: Any,
) -> Path:
    """One run folder of a unit with a calibration, `days` after the beginning."""
    folder = uncalibrated(root, unit, where, days, **manifest)
    content = {
        "verdict": {"verdict": "adequate"},
        "noise": {"floor_dph": floor, "coefficients": [{"name": "white", "value": walk, "determined": True}]},
        "residual": {"rms_dph": residual * 0.9, "held_out": [{"by": "blocks", "rms_dph": residual}]},
        "calibration": {"model": {"name": "spline"}, "coefficients": [], "parameters": [], "validity": {}},
    }
    keep(folder, "calibration.json", content)
    return folder


def uncalibrated(root: Path, unit: str, where: str, days: float, **manifest: Any) -> Path:
    """One run folder of a unit that nobody analysed, `days` after the beginning."""
    created = BEGIN + timedelta(days=days)
    folder = root / unit / f"{created:%Y%m%dT%H%M%SZ}_ramp"
    folder.mkdir(parents=True)
    Manifest.model_validate(
        {
            "unit": unit,
            "run": folder.name,
            "profile": "ramp",
            "station": where,
            "created": created.isoformat(),
            "state": "done",
            **manifest,
        }
    ).write(folder)
    return folder


def fleet(units: int, rows: int = 1006, interval_s: float = 30.0) -> Iterator[Stored]:
    """Moments of units 0, 1, 2 …: two cycles of -40 to 85 degC, each unit with a curve, noise and gaps of its own."""
    time_s = (np.arange(rows) + 0.5) * interval_s
    for number in range(units):
        random = np.random.default_rng(number)
        temperature = 22.5 - 62.5 * np.cos(4 * np.pi * time_s / time_s[-1]) + random.normal(0.0, 0.01, rows)
        x = temperature / 60.0
        a = random.normal([12.0, 3.0, -2.0, 1.5, 0.4], [5.0, 1.0, 1.0, 0.5, 0.2])
        bias = a[0] + a[1] * x + a[2] * x**2 + a[3] * x**3 + a[4] * np.sin(4 * x) + random.normal(0.0, 0.1, rows)
        channels = {
            "rate": np.where(random.random(rows) < 0.001, np.nan, bias),
            "temperature": temperature,
            "frequency": 14000.0 * (1 - 25e-6 * temperature) + random.normal(0.0, 0.05, rows),
            "drive": 2.5 + 2e-4 * temperature + random.normal(0.0, 1e-4, rows),
            "quadrature": 0.05 + 3e-4 * temperature + random.normal(0.0, 1e-4, rows),
        }
        run = Dataset(f"run-{number}", time_s, channels, np.zeros(rows, np.int64), (), interval_s)
        yield Stored(f"U-{number:06d}", f"run-{number}", "", Moments.of([run]).pack())
