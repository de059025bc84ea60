"""Commands about the registry, and what `bench run` does with it: a registry that fails never loses a run."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from bench.base import InputError
from bench.commands.results.stock import EquipmentListed, Noted, RegisteredRuns, RegistryEntry, RegistryRebuilt
from bench.record import RunFolder

if TYPE_CHECKING:
    from bench.archive import Entry, Registry


def register_runs(runs: Sequence[Path], where: str | None, begin: bool) -> str | None:
    """Register runs that were made or analysed. None: there was nothing to register; text: what went wrong, else empty.

    Without `begin` a run is registered only where its folder is in an archive already, or a registry was named.
    """
    from bench.archive import is_archive

    chosen = [run for run in runs if begin or where or is_archive(_root(run))]
    if not chosen:
        return None
    try:
        register(chosen, where)
    except Exception as error:
        root = _root(chosen[0])
        return f"not registered: {error}; the run is safe on disk, later: bench registry rebuild --out {root}"
    return ""


def register(runs: Sequence[Path], where: str | None = None) -> None:
    """Register run folders; each is <archive>/<unit>/<run>. Errors are those of the registry."""
    from bench.archive import archive
    from bench.archive import register as write

    for root in dict.fromkeys(_root(run) for run in runs):
        ledger = archive(root)
        with open_in(root, where) as registry:
            for run in runs:
                if _root(run) == root:
                    write(registry, RunFolder(run), ledger)


def open_in(root: Path, where: str | None) -> Registry:
    """The registry at `where`, by default the file in the archive."""
    from bench.archive import FILE, open_registry

    return open_registry(where or root / FILE)


def _root(run: Path) -> Path:
    return run.resolve().parent.parent


def registry_list(root: Path, where: str | None, unit: str | None, most: int) -> RegisteredRuns:
    """`bench registry list`: runs, the newest first."""
    from bench.archive import runs

    with existing(root, where) as registry:
        return RegisteredRuns(registry.url, runs(registry, unit, most))


def registry_show(root: Path, where: str | None, name: str) -> RegistryEntry:
    """`bench registry show`: all about a unit or a run."""
    from bench.archive import show

    with existing(root, where) as registry:
        return RegistryEntry(show(registry, name))


def registry_rebuild(root: Path, where: str | None, only_compare: bool) -> RegistryRebuilt:
    """`bench registry rebuild`: the rows of the run folders, made again or only compared."""
    from bench.archive import archive, rebuild

    if not root.is_dir():
        raise InputError("no such folder; name the folder of the run folders with --out", root)
    with open_in(root, where) as registry:
        done = rebuild(registry, archive(root), only_compare=only_compare)
        return RegistryRebuilt(registry.url, done, only_compare)


def registry_tell(root: Path, where: str | None, entry: Entry) -> Noted:
    """Write what a person said into ledger and registry."""
    from bench.archive import archive, tell

    ledger = archive(root)
    with open_in(root, where) as registry:
        tell(registry, ledger, entry)
    return Noted(ledger.path, entry)


def add_equipment(root: Path, where: str | None, name: str, serial: str, kind: str, **days: datetime | None) -> Noted:
    """`bench registry equipment add`: a piece of equipment and its calibration; InputError where due before it."""
    calibrated, due = (None if (day := days.get(key)) is None else day.date() for key in ("calibrated", "due"))
    if calibrated and due and due < calibrated:
        raise InputError(f"{name} {serial}: due {due} is before calibrated {calibrated}")
    entry = {
        "kind": "equipment",
        "name": name,
        "serial": serial,
        "type": kind,
        "calibrated_on": None if calibrated is None else calibrated.isoformat(),
        "due_on": None if due is None else due.isoformat(),
    }
    return registry_tell(root, where, entry)


def registry_equipment(root: Path, where: str | None, on: date) -> EquipmentListed:
    """`bench registry equipment list`: what is due first on top."""
    from bench.archive import equipment, plain

    with existing(root, where) as registry:
        found = [plain(row) for row in equipment(registry)]
    for row in found:
        row["state"] = (
            "no due date" if row["due_on"] is None else "overdue" if row["due_on"] < on.isoformat() else "valid"
        )
    return EquipmentListed(on, found)


def existing(root: Path, where: str | None) -> Registry:
    """The registry that is there; InputError, with the way to one, where the archive has none."""
    from bench.archive import FILE

    if where is None and not (root / FILE).is_file():
        raise InputError("no registry here yet; make it with `bench registry rebuild --out FOLDER`", root / FILE)
    return open_in(root, where)
