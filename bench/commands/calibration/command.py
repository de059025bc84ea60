"""`bench calibrate`: the job of a unit, done as far as it goes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.commands.calibration.calibrate import calibrate_all
from bench.commands.calibration.junit import write_junit
from bench.commands.calibration.order import Order
from bench.commands.calibration.steps import STEP_NAMES
from bench.commands.results.deliver import Calibrated, CalibratedAll


def calibrate_units(
    orders: Sequence[Order], release: str | None, anew: bool, junit: Path | None
) -> Calibrated | CalibratedAll:
    """Do what is left of the jobs, and write their JUnit XML; the exit code is the worst verdict."""
    jobs = calibrate_all(orders, release=release, anew=anew)
    if junit is not None:
        write_junit(jobs, STEP_NAMES, junit)
    results = tuple(Calibrated(job, STEP_NAMES) for job in jobs)
    return results[0] if len(results) == 1 else CalibratedAll(results)
