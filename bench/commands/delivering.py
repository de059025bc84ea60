"""`bench export`: the calibration of a run as files for the unit and its firmware."""

from __future__ import annotations

from pathlib import Path

from bench.commands.files import write
from bench.commands.results.deliver import Exported
from bench.deliver import ExportOptions, files_of, prepare


def export(folder: Path, format_: str, options: ExportOptions, out: Path | None) -> Exported:
    """Write the files of one format into `out` (the run's own `export` folder) and say how exact each form is."""
    delivered = prepare(folder, options)
    target = out or folder / "export"
    made = files_of(delivered.package, format_)
    for name, data in made.items():
        write(target / name, data)
    return Exported(folder, format_, tuple(target / name for name in made), delivered)
