"""`bench calibrate`: the job of a unit, done as far as it goes."""

from __future__ import annotations

from pathlib import Path

from bench.commands.calibration.calibrate import calibrate
from bench.commands.calibration.junit import write_junit
from bench.commands.calibration.order import Order
from bench.commands.calibration.steps import STEP_NAMES
from bench.commands.results.deliver import Calibrated


def calibrate_unit(order: Order, release: str | None, anew: bool, junit: Path | None) -> Calibrated:
    """Do what is left of the job, and write its JUnit XML; the exit code is the verdict."""
    job = calibrate(order, release=release, anew=anew)
    if junit is not None:
        write_junit(job, STEP_NAMES, junit)
    return Calibrated(job, STEP_NAMES)
