"""bench imu: the parameters of a whole inertial unit over temperature, and what is wrong with it."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.base import FloatArray, InputError
from bench.commands.files import write
from bench.commands.results.analyse import ImuCalibrated, ImuVerified
from bench.record import ImuRecord, ImuSource, prove, sha256

if TYPE_CHECKING:
    from bench.analysis import Estimate, ImuCalibration, ImuRows

TABLE = "parameters.csv"


def imu(table: Path, plan_file: Path, out: Path | None = None, unit: str = "") -> ImuCalibrated:
    """`bench imu`: calibrate a unit from a table of its outputs and the plan of its attitudes.

    `out`: a CSV for the parameters; or a JSON file for the record; or a folder for the record, the CSV and a report.
    """
    from bench.acquisition import read_confined
    from bench.analysis import ImuCalibration, after, diagnose_imu, load_imu_plan, refuse_undetermined, rows_of

    if out is not None and not out.parent.is_dir():
        raise InputError(f"folder {out.parent} does not exist; make it first", out)
    plan, document = load_imu_plan(plan_file)
    model, columns = plan.orders.model(), read_confined(table).columns
    rows: ImuRows = rows_of(columns, plan, document)
    for triad in (rows.gyro, rows.accelerometer):
        refuse_undetermined(triad, model)
    found = diagnose_imu(rows.gyro, rows.accelerometer, plan.latitude_deg, model, plan.reference)
    low, high = _range(rows)
    temperatures = tuple(np.unique(np.round(np.linspace(low, high, 6), 1)).tolist()) if high - low > 1.0 else (low,)
    estimates = tuple(e for triad in found.fit.triads for e in triad.estimates(temperatures))
    undetermined = tuple(str(one) for triad in found.fit.triads for one in after(triad, temperatures))
    files: Sequence[Path] = ()
    if out is not None and out.suffix == ".csv":
        write(out, parameters_csv(estimates))
        files = [out]
    elif out is not None:
        made = ImuCalibration(unit, plan, rows, found, (low, high), estimates, undetermined)
        files = _kept(made, columns, (table, plan_file), out)
    return ImuCalibrated(
        table,
        out,
        len(rows.gyro.time),
        rows.left_out,
        (low, high),
        estimates,
        undetermined,
        found.findings,
        tuple(files),
    )


def verify_imu(table: Path, plan_file: Path, calibration: Path, limits_path: Path | None = None) -> ImuVerified:
    """`bench imu --verify`: a calibration judged by the rows of another table that have other positions or rates.

    Where the calibration is a folder, the verdict is kept there, and stands in its report.
    """
    from bench.acquisition import read_confined
    from bench.analysis import load_imu_plan, load_limits, rows_of
    from bench.analysis import verify_imu as verify
    from bench.deliver import write_imu_report

    record = ImuRecord.of(calibration)
    prove(calibration if calibration.is_dir() else calibration.parent)
    if sha256(table) in {source.sha256 for source in record.sources}:
        raise InputError("is the table that this calibration was fitted to; verify with another one", table)
    limits = None if limits_path is None else load_limits(limits_path)
    plan, document = load_imu_plan(plan_file)
    rows = rows_of(read_confined(table).columns, plan, document)
    found = verify(record, rows, limits, _sources(table, plan_file))
    if not calibration.is_dir():
        return ImuVerified(table, calibration, found)
    return ImuVerified(table, calibration, found, (found.write(calibration), write_imu_report(calibration)))


def _sources(*files: Path) -> list[ImuSource]:
    return [ImuSource(file=path.name, sha256=sha256(path)) for path in files]


def _kept(made: ImuCalibration, columns: Mapping[str, FloatArray], files: Sequence[Path], out: Path) -> list[Path]:
    """Write the record and, into a folder, what people look at."""
    from bench.deliver import write_imu_report

    record = made.record(columns, _sources(*files))
    if out.suffix == ".json":
        return [record.write(out.parent, out.name)]
    out.mkdir(exist_ok=True)
    paths = [record.write(out), out / TABLE]
    write(out / TABLE, parameters_csv(made.estimates))
    return [*paths, write_imu_report(out)]


def parameters_csv(estimates: Iterable[Estimate]) -> str:
    """A line for each parameter and temperature."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(["parameter", "unit", "temperature_degc", "value", "U"])
    writer.writerows([e.name, e.unit, f"{e.temperature:g}", f"{e.value:.9g}", f"{e.U:.4g}"] for e in estimates)
    return text.getvalue()


def _range(rows: ImuRows) -> tuple[float, float]:
    """Temperatures that all six axes had [degC]."""
    both = np.hstack([rows.gyro.temperature, rows.accelerometer.temperature])
    return float(both.min(axis=0).max()), float(both.max(axis=0).min())
