"""A production line of run folders, as small as the registry allows: two stations, lots of 40, wished-for faults."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bench.record import Manifest
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
    """One run folder of a unit, `days` after the beginning."""
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
    content = {
        "verdict": {"verdict": "adequate"},
        "noise": {"floor_dph": floor, "coefficients": [{"name": "white", "value": walk, "determined": True}]},
        "residual": {"rms_dph": residual * 0.9, "held_out": [{"by": "blocks", "rms_dph": residual}]},
        "calibration": {"model": {"name": "spline"}, "coefficients": [], "parameters": [], "validity": {}},
    }
    keep(folder, "calibration.json", content)
    return folder
