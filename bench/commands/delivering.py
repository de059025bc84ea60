"""`bench export`: the calibration of a run as files for the unit and its firmware."""

from __future__ import annotations

from pathlib import Path

from bench.commands.analysis import of_one
from bench.commands.files import write
from bench.commands.noise_reading import noise
from bench.commands.results.deliver import Exported, ImuExported, MeasuredExported
from bench.deliver import (
    MEASURED,
    ExportOptions,
    deliver_imu,
    files_of,
    kalibr_yaml,
    prepare,
    refuse_format,
    write_mf4,
)
from bench.record import ImuRecord, Manifest, prove


def export(
    folder: Path, format_: str, options: ExportOptions, out: Path | None, output: str | None = None
) -> Exported | ImuExported | MeasuredExported:
    """Write the files of one format into `out` (the run's own `export` folder) and say how exact each form is.

    A folder with the calibration of an inertial unit, or its imu.json, gives the files of all its axes.
    """
    record = ImuRecord.at(folder) if output is None else None
    if record is not None:
        delivery = deliver_imu(folder, record, format_, options)
        target = out or (folder if folder.is_dir() else folder.parent) / "export"
        for name, data in delivery.made.files.items():
            write(target / name, data)
        return ImuExported(folder, format_, tuple(target / name for name in delivery.made.files), delivery)
    refuse_format(format_)
    if format_ != "mf4" or output is not None:  # samples of a run are those of all outputs
        folder = of_one(folder, output)
    if format_ in MEASURED:
        return _measured(folder, format_, options, out or folder / "export")
    delivered = prepare(folder, options)
    target = out or folder / "export"
    made = files_of(delivered.package, format_)
    for name, data in made.items():
        write(target / name, data)
    return Exported(folder, format_, tuple(target / name for name in made), delivered)


def _measured(folder: Path, format_: str, options: ExportOptions, target: Path) -> MeasuredExported:
    """Samples or noise of a run; the name of the file is the run's, or `imu.yaml`."""
    manifest = Manifest.read(folder)
    if not options.force:
        prove(folder)
    if format_ == "mf4":
        path = target / f"{manifest.run or folder.name}.mf4"
        write_mf4(folder, path)
    else:
        path = target / "imu.yaml"
        source = f"{manifest.unit}, run {manifest.run or folder.name}"
        write(path, kalibr_yaml(noise([folder]).coefficients, manifest.sample_rate_hz, source))
    return MeasuredExported(folder, format_, (path,))
