"""bench imu: the parameters of a whole inertial unit over temperature, and what is wrong with it."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from bench import analysis, deliver
from bench.base import InputError
from bench.commands.files import write
from bench.commands.imu_rows import Measured, measured
from bench.commands.results.analyse import ImuCalibrated, ImuVerified
from bench.record import ImuRecord, prove

TABLE = "parameters.csv"


def imu(
    sources: Sequence[Path], plan_file: Path | None = None, out: Path | None = None, unit: str = ""
) -> ImuCalibrated:
    """`bench imu`: calibrate a unit from its runs, or from a table of its outputs and the plan of its attitudes.

    `out`: a CSV for the parameters; or a JSON file for the record; or a folder for the record, the CSV and a report.
    """
    if out is not None and not out.parent.is_dir():
        raise InputError(f"folder {out.parent} does not exist; make it first", out)
    given = measured(sources, plan_file)
    rows, plan = given.rows, given.plan
    model = plan.orders.model()
    for triad in (rows.gyro, rows.accelerometer):
        analysis.refuse_undetermined(triad, model)
    found = analysis.diagnose_imu(rows.gyro, rows.accelerometer, plan.latitude_deg, model, plan.reference)
    low, high = _range(rows)
    temperatures = tuple(np.unique(np.round(np.linspace(low, high, 6), 1)).tolist()) if high - low > 1.0 else (low,)
    estimates = tuple(e for triad in found.fit.triads for e in triad.estimates(temperatures))
    undetermined = tuple(str(one) for triad in found.fit.triads for one in analysis.after(triad, temperatures))
    files: Sequence[Path] = ()
    if out is not None and out.suffix == ".csv":
        write(out, parameters_csv(estimates))
        files = [out]
    elif out is not None:
        own = unit or given.unit
        made = analysis.ImuCalibration(
            own, plan, rows, found, (low, high), estimates, undetermined, given.simulated, given.sample_hz
        )
        files = _kept(made, given, out)
    return ImuCalibrated(
        sources[0],
        out,
        len(rows.gyro.time),
        rows.left_out,
        (low, high),
        estimates,
        undetermined,
        found.findings,
        tuple(files),
    )


def verify_imu(
    sources: Sequence[Path], plan_file: Path | None, calibration: Path, limits_path: Path | None = None
) -> ImuVerified:
    """`bench imu --verify`: a calibration judged by rows of other runs or another table at other positions or rates.

    Where the calibration is a folder, the verdict is kept there, and stands in its report.
    """
    record = ImuRecord.of(calibration)
    prove(calibration if calibration.is_dir() else calibration.parent)
    given, known = measured(sources, plan_file), {source.sha256 for source in record.sources}
    for source, own in zip(sources, given.files, strict=False):
        if own.sha256 in known:
            raise InputError("is what this calibration was fitted to; verify with another run or table", source)
    limits = None if limits_path is None else analysis.load_limits(limits_path)
    found = analysis.verify_imu(record, given.rows, limits, given.files)
    if not calibration.is_dir():
        return ImuVerified(sources[0], calibration, found)
    return ImuVerified(
        sources[0], calibration, found, (found.write(calibration), deliver.write_imu_report(calibration))
    )


def _kept(made: analysis.ImuCalibration, given: Measured, out: Path) -> list[Path]:
    """Write the record and, into a folder, what people look at."""
    record = made.record(given.columns, given.files)
    if out.suffix == ".json":
        return [record.write(out.parent, out.name)]
    out.mkdir(exist_ok=True)
    paths = [record.write(out), out / TABLE]
    write(out / TABLE, parameters_csv(made.estimates))
    return [*paths, deliver.write_imu_report(out)]


def parameters_csv(estimates: Iterable[analysis.Estimate]) -> str:
    """A line for each parameter and temperature."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(["parameter", "unit", "temperature_degc", "value", "U"])
    writer.writerows([e.name, e.unit, f"{e.temperature:g}", f"{e.value:.9g}", f"{e.U:.4g}"] for e in estimates)
    return text.getvalue()


def _range(rows: analysis.ImuRows) -> tuple[float, float]:
    """Temperatures that all six axes had [degC]."""
    both = np.hstack([rows.gyro.temperature, rows.accelerometer.temperature])
    return float(both.min(axis=0).max()), float(both.max(axis=0).min())
