"""JSON Schemas of the files that users write, so that editors complete and check them: `python -m bench.schemas`."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel

from bench import config
from bench.importer.columns import ColumnMap
from bench.laboratory import EquipmentFile, Laboratory
from bench.limits import Limits
from bench.plan import Plan
from bench.profile import Profile
from bench.station import StationSettings

SCHEMAS: dict[str, type[BaseModel]] = {
    "profile": Profile,
    "station": StationSettings,
    "columns": ColumnMap,
    "limits": Limits,
    "equipment": EquipmentFile,
    "laboratory": Laboratory,
    "plan": Plan,
}
"""Kinds of files, by the name of their schema."""


def export(folder: Path) -> tuple[Path, ...]:
    """Write `<kind>.json` for every kind of file; returns those that changed."""
    paths = {folder / f"{kind}.json": (kind, model) for kind, model in SCHEMAS.items()}
    return tuple(path for path, (kind, model) in paths.items() if config.export_schema(model, path, kind))


if __name__ == "__main__":
    for changed in export(Path("profiles/schemas")):
        print(changed)
