"""JSON Schemas of the files that users write, so that editors complete them, and of the bench's own records.

`python -m bench.commands.schemas` writes them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.acquisition import ColumnMap, NotifyFile, Profile, StationSettings
from bench.analysis import ImuPlan, Limits
from bench.base import export_schema
from bench.commands.calibration.plan import Plan
from bench.deliver import InstrumentsFile, Laboratory
from bench.record import RECORDS
from drivers.registers import RegisterMap

SCHEMAS: dict[str, type[Any]] = {
    "profile": Profile,
    "station": StationSettings,
    "columns": ColumnMap,
    "limits": Limits,
    "equipment": InstrumentsFile,
    "laboratory": Laboratory,
    "plan": Plan,
    "imu": ImuPlan,
    "chamber_map": RegisterMap,
    "notify": NotifyFile,
}
"""Kinds of files, by the name of their schema."""

RECORD_SCHEMAS: dict[str, type[Any]] = {f"records/{record.TITLE}": record for record in RECORDS}
"""Files that the bench writes and reads again."""


def export(folder: Path) -> tuple[Path, ...]:
    """Write `<kind>.json` for every kind of file; returns those that changed."""
    paths = {folder / f"{kind}.json": (kind, model) for kind, model in (SCHEMAS | RECORD_SCHEMAS).items()}
    return tuple(path for path, (kind, model) in paths.items() if export_schema(model, path, kind))


if __name__ == "__main__":
    for changed in export(Path("profiles/schemas")):
        print(changed)
