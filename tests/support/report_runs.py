"""Analysed runs that the tests of the report share: reading the noise and diagnosing take seconds each."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np

from bench.analysis.effects.model import load_model
from bench.analysis.judging.analysis import Analysis
from bench.analysis.judging.judge import analyse
from bench.analysis.noise.floor import Floor
from tests.support.run_folders import ARW, make_run, ramp_run

FLOOR = Floor(ARW / np.sqrt(30.0 / 3600.0))
"""Of 30 s means of the synthetic unit, whose noise is white."""


@cache
def looped(folder: Path) -> Analysis:
    """The whole analysis of a run with hidden hysteresis."""
    return analyse(make_run(folder / "report-whole", **ramp_run()))


@cache
def clean(folder: Path) -> Analysis:
    """A run of a unit that is a smooth curve and white noise."""
    return quick(make_run(folder / "report-clean", **ramp_run(loop_dph=0.0)), "spline", diagnose=True)


@cache
def disturbed(folder: Path) -> Analysis:
    """A run with a periodic disturbance that the library has no effect for."""
    made = ramp_run(loop_dph=0.0)
    made["columns"]["rate"] = made["columns"]["rate"] + 0.25 * np.sin(2 * np.pi * made["columns"]["time"] / 1100.0)
    return quick(make_run(folder / "report-disturbed", **made), "spline", diagnose=True)


def quick(folder: Path, model: str = "polynomial", *, diagnose: bool = False) -> Analysis:
    """The analysis of one model, the noise floor not read from the run but known."""
    with patch("bench.analysis.judging.judge.noise_floor", return_value=FLOOR):
        return analyse(folder, [load_model(model)], diagnose=diagnose)
