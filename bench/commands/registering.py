"""Commands about the registry, and what `bench run` does with it: a registry that fails never loses a run."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from datetime import date, datetime
from pathlib import Path
from typing import Any

from bench import archive
from bench.base import InputError
from bench.commands.clocks import tell_ahead
from bench.commands.files import tell_unproven
from bench.commands.results.stock import EquipmentListed, Noted, RegisteredRuns, RegistryEntry, RegistryRebuilt
from bench.record import MANIFEST, RunFolder, chain_of, prove, sha256, slug, verified_by

_REBUILD = "make the registry again with `bench registry rebuild`"


def register_runs(runs: Sequence[Path], where: str | None, begin: bool) -> str | None:
    """Register runs that were made or analysed. None: there was nothing to register; text: what went wrong, else empty.

    Without `begin` a run is registered only where its folder is in an archive already, where a bench recorded it there,
    or where a registry was named.
    """
    chosen = [run for run in runs if begin or where or _belongs(run.resolve())]
    if not chosen:
        return None
    try:
        register(chosen, where)
    except Exception as error:
        root = _root(chosen[0])
        return f"not registered: {error}; the run is safe on disk, later: bench registry rebuild --out {root}"
    return ""


def _belongs(run: Path) -> bool:
    """Whether a run is one of an archive, perhaps of one whose first run was killed before the archive was begun."""
    root, made = _root(run), chain_of(run)
    recorded_here = made is not None and (slug(made.unit), made.run) == (run.parent.name, run.name)
    begun = archive.is_archive(root) or (root / archive.FILE).is_file() or chain_of(root) is not None
    return begun or (recorded_here and RunFolder(run).journal.is_dir())


def register(runs: Sequence[Path], where: str | None = None) -> None:
    """Register run folders; each is <archive>/<unit>/<run>. Errors are those of the registry."""
    from bench.archive import register as write

    # What a verification says is said of the calibration that it verifies.
    runs = list(dict.fromkeys([*runs, *filter(None, map(verified_by, runs))]))
    for root in dict.fromkeys(_root(run) for run in runs):
        _refuse_lost(root)
        ledger = archive.archive(root)
        with open_in(root, where) as registry:
            for run in runs:
                if _root(run) == root:
                    write(registry, RunFolder(run), ledger)


def open_in(root: Path, where: str | None) -> archive.Registry:
    """The registry at `where`, by default the file in the archive."""
    return archive.open_registry(where or root / archive.FILE, checked=True)


def _root(run: Path) -> Path:
    return run.resolve().parent.parent


def _place(run: Path) -> str:
    """Path of a resolved run folder in its archive."""
    return f"{run.parent.name}/{run.name}"


def registry_list(root: Path, where: str | None, unit: str | None, most: int) -> RegisteredRuns:
    """`bench registry list`: runs, the newest first."""
    with existing(root, where) as registry:
        found = archive.runs(registry, unit, most)
        _tell_unlike(root, registry.url, found)
        tell_ahead((row["path"], row["created"] or "") for row in found)
        return RegisteredRuns(registry.url, found)


def registry_show(root: Path, where: str | None, name: str) -> RegistryEntry:
    """`bench registry show`: all about a unit or a run."""
    with existing(root, where) as registry:
        found = archive.show(registry, name)
        _tell_unlike(root, registry.url, found.get("runs") or [found["run"]])
        return RegistryEntry(found)


def registry_rebuild(
    root: Path, where: str | None, only_compare: bool, moved: bool = False, copied: bool = False
) -> RegistryRebuilt:
    """`bench registry rebuild`: the rows of the run folders, made again or only compared.

    The archive may have been `moved` since the registry saw it, or be `copied` from another one.
    """
    if not root.is_dir():
        raise InputError("no such folder; name the folder of the run folders with --out", root)
    _refuse_lost(root)
    tell_unproven(*(path.parent for path in sorted(root.glob(f"*/*/{MANIFEST}"))))
    with existing(root, where) if only_compare else open_in(root, where) as registry:
        ledger = archive.archive(root).renewed() if copied else archive.archive(root)
        done = archive.rebuild(registry, ledger, only_compare=only_compare, moved=moved)
        return RegistryRebuilt(registry.url, done, only_compare)


def registry_tell(root: Path, where: str | None, entry: archive.Entry) -> Noted:
    """Write what a person said into ledger and registry."""
    ledger = archive.archive(root)
    with open_in(root, where) as registry:
        archive.tell(registry, ledger, entry)
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
    with existing(root, where) as registry:
        found = [archive.plain(row) for row in archive.equipment(registry)]
        entered = archive.of_ledger(archive.archive(root))["equipment"] if archive.is_archive(root) else {}
        for row in found:
            known = entered.get((row["name"], row["serial"]))
            if known is not None and archive.plain(known) != row:
                raise InputError(f"{row['name']} {row['serial']} is not what the ledger says; {_REBUILD}", registry.url)
    for row in found:
        row["state"] = (
            "no due date" if row["due_on"] is None else "overdue" if row["due_on"] < on.isoformat() else "valid"
        )
    return EquipmentListed(on, found)


def refuse_foreign(folder: Path) -> None:
    """InputError where the ledger of the archive knows the run with another manifest."""
    run = folder.resolve()
    root = _root(run)
    _refuse_lost(root)
    if chain_of(root) is not None:
        prove(root)
    known, digest = seen_in(root).get(_place(run)), sha256(run / MANIFEST)
    if known is not None and known[1] != digest:
        raise InputError(
            f"has a manifest.json with the SHA-256 {digest}, the ledger of the archive saw {known[1]}; restore it, or "
            f"register the run as it is now with `bench report {folder}`",
            folder,
        )


def see_again(folder: Path) -> None:
    """Tell the ledger of the archive the manifest of a run that went on since it was registered: it is another one."""
    run = folder.resolve()
    if _place(run) in seen_in(_root(run)):
        archive.archive(_root(run)).saw(_place(run), sha256(run / MANIFEST))


def seen_in(root: Path) -> dict[str, tuple[int | None, str]]:
    """The runs that the ledger of an archive saw, by path: line, and hash of the manifest; none without a ledger."""
    return archive.archive(root).seen() if archive.is_archive(root) else {}


def existing(root: Path, where: str | None) -> archive.Registry:
    """The registry that is there; InputError, with the way to one, where the archive has none."""
    if where is None and not (root / archive.FILE).is_file():
        raise InputError(
            "no registry here yet; make it with `bench registry rebuild --out FOLDER`", root / archive.FILE
        )
    if where is None:
        _refuse_lost(root)
    registry = open_in(root, where)
    if archive.is_archive(root):
        ledger = archive.archive(root)
        here, mine = archive.known_runs(registry, ledger.id)
        lacking = len(ledger.seen().keys() - mine)
        if where is None and not here and (lacking or any(root.glob(f"*/*/{MANIFEST}"))):
            registry.close()
            raise InputError(
                "knows nothing of this archive; make it again with `bench registry rebuild`", root / archive.FILE
            )
        if lacking:
            text = f"{lacking} runs of the ledger are not in the registry; `bench registry rebuild` adds them"
            print(f"bench: {registry.url}: {text}", file=sys.stderr)
    return registry


def _tell_unlike(root: Path, url: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """InputError where a row is not what the folder of its run says, as far as that is here."""
    if not archive.is_archive(root):
        return
    ledger = archive.archive(root)
    seen = ledger.seen()
    tell_unproven(*(root / row["path"] for row in rows if row["archive"] == ledger.id))
    for row in rows:
        folder = root / row["path"]
        if row["archive"] != ledger.id:
            continue
        if not (folder / MANIFEST).is_file():
            print(f"bench: {folder / MANIFEST}: is not here, the registry knows it", file=sys.stderr)
            continue
        known = next(iter(archive.of_run(RunFolder(folder), ledger, seen)["runs"].values()), {})
        unlike = [key for key, value in known.items() if row.get(key) != value]
        if unlike:
            raise InputError(f"run {row['path']}: {unlike[0]} is not what its folder says; {_REBUILD}", url)


def _refuse_lost(root: Path) -> None:
    """InputError where the ledger of an archive is lost: a new one would be of another archive."""
    if (root / archive.FILE).is_file() and not archive.is_archive(root):
        raise InputError(
            "ledger.jsonl, which belongs to this registry, is missing; restore it from a backup", root / archive.FILE
        )
