"""`bench export`: the calibration of a run as files for the unit and its firmware."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from bench.commands.answer import Answer
from bench.deliver import ExportOptions, best_form, error_table, files_of, prepare
from bench.record import write_atomically


def export(folder: Path, format_: str, wishes: ExportOptions, out: Path | None) -> Answer:
    """Write the files of one format into `out` (the run's own `export` folder) and say how exact each form is."""
    delivered = prepare(folder, wishes)
    package = delivered.package
    made = files_of(package, format_)
    target = out or folder / "export"
    target.mkdir(parents=True, exist_ok=True)
    for name, data in made.items():
        write_atomically(target / name, data)
    paths = [str(target / name) for name in made]
    image, chosen = package.image, next(row for row in package.worst if row.form == package.image.form)
    content = {
        "run": str(folder),
        "format": format_,
        "files": paths,
        "model": delivered.source.fit.model.name,
        "form": image.form,
        "unit": package.unit,
        "serial": image.serial,
        "calibration_id": image.calibration_id,
        "crc": package.words[-1],
        "words": len(package.words),
        "worst_error_dph": chosen.worst,
        "model_apart_dph": delivered.apart_dph,
        "forms": [asdict(row) for row in package.worst],
        "objections": list(delivered.source.objections),
    }
    why = " (least error)" if best_form(package.worst).form == image.form else ""
    lines = [
        f"{delivered.source.fit.model.name}, unit {package.unit}: worst errors against double precision",
        error_table(package.worst),
        "",
        f"form {image.form}{why}, {4 * len(package.words)} bytes, serial {image.serial}, calibration "
        f"0x{image.calibration_id:08X}, CRC 0x{package.words[-1]:08X}",
        f"delivered and fitted model are {delivered.apart_dph:.2g} deg/h apart on the run's rows",
        *(f"forced: {text}" for text in delivered.source.objections),
        *paths,
    ]
    return Answer(content, "\n".join(lines))
