"""bench imu: the parameters of a whole inertial unit over temperature, and what is wrong with it."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from bench.base import InputError
from bench.commands.results.analyse import ImuCalibrated


def imu(table: Path, plan_file: Path, out: Path | None = None) -> ImuCalibrated:
    """`bench imu`: calibrate a unit from a table of its outputs and the plan of its attitudes; `out` gets a CSV."""
    from bench.acquisition import read_confined
    from bench.analysis import ImuRows, after, diagnose_imu, load_imu_plan, refuse_undetermined, rows_of

    if out is not None and not out.parent.is_dir():
        raise InputError(f"folder {out.parent} does not exist; make it first", out)
    plan, document = load_imu_plan(plan_file)
    model = plan.orders.model()
    rows: ImuRows = rows_of(read_confined(table).columns, plan, document)
    for triad in (rows.gyro, rows.accelerometer):
        refuse_undetermined(triad, model)
    found = diagnose_imu(rows.gyro, rows.accelerometer, plan.latitude_deg, model, plan.reference)
    both = np.hstack([rows.gyro.temperature, rows.accelerometer.temperature])
    low, high = float(both.min(axis=0).max()), float(both.max(axis=0).min())
    temperatures = tuple(np.unique(np.round(np.linspace(low, high, 6), 1)).tolist()) if high - low > 1.0 else (low,)
    estimates = tuple(e for triad in found.fit.triads for e in triad.estimates(temperatures))
    undetermined = tuple(str(one) for triad in found.fit.triads for one in after(triad, temperatures))
    if out is not None:
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(["parameter", "unit", "temperature_degc", "value", "U"])
        writer.writerows([e.name, e.unit, f"{e.temperature:g}", f"{e.value:.9g}", f"{e.U:.4g}"] for e in estimates)
        out.write_text(text.getvalue(), encoding="utf-8", newline="")
    return ImuCalibrated(
        table, out, len(rows.gyro.time), rows.left_out, (low, high), estimates, undetermined, found.findings
    )
