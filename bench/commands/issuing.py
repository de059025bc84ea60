"""Certificates that were issued: which is in force, what a new one amends, and their withdrawal (ISO/IEC 17025, 7.8.8).

A run folder holds its newest certificate as `certificate.*` and earlier ones as `certificate-<number>.*`. A certificate
that amends another one replaces it. Withdrawals stand in the ledger of the archive.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from bench import archive, deliver
from bench.base import InputError
from bench.commands.files import write
from bench.commands.papers import EQUIPMENT
from bench.commands.registering import existing, registry_tell
from bench.commands.results.stock import CertificatesListed, Noted, Recalled
from bench.record import MANIFEST, CertificateRecord, ImuRecord, sha256

NO_REASON = "issued again from the same run; no reason was given"
_KEPT = ("json", "xml", "pdf")


@dataclass(frozen=True)
class Issued:
    """A certificate as it was issued."""

    record: CertificateRecord
    file: Path

    @property
    def is_newest(self) -> bool:
        """Whether it is the one of its run that was issued last."""
        return self.file.name == CertificateRecord.FILE

    def reference(self, reason: str) -> dict[str, str | None]:
        """How the certificate that replaces it refers to it."""
        known = {"number": self.record.number, "issued": self.record.issued, "sha256": sha256(self.file)}
        return {**known, "reason": reason}


@dataclass(frozen=True)
class Shelf:
    """All certificates that a new one could concern, by number, and what became of them."""

    issued: Mapping[str, Issued]
    withdrawn: Mapping[str, Mapping[str, Any]]

    @classmethod
    def around(cls, run: Path) -> Shelf:
        """Those of the run's unit in its archive; only those of the run where it is in none."""
        folder = run.resolve()
        root = folder.parent.parent
        folders = sorted(folder.parent.glob("*/")) if archive.is_archive(root) else [folder]
        return cls({one.record.number: one for one in _found(folders)}, _withdrawn(root))

    @classmethod
    def of_archive(cls, root: Path) -> Shelf:
        """Those of an archive."""
        folders = sorted(path.parent for path in root.glob(f"*/*/{CertificateRecord.FILE}"))
        return cls({one.record.number: one for one in _found(folders)}, _withdrawn(root))

    def over(self, number: str) -> str:
        """Why a certificate is not in force; empty where it is."""
        for other in self.issued.values():
            if (other.record.amends or {}).get("number") == number:
                return f"was replaced by {other.record.number} on {other.record.issued}"
        if (entry := self.withdrawn.get(number)) is not None:
            return f"was withdrawn on {str(entry['utc'])[:10]} ({entry['reason']})"
        return ""

    def in_force(self, number: str, where: Path) -> Issued:
        """A certificate that may be amended or withdrawn; InputError where there is none, or it is not in force."""
        if number not in self.issued:
            raise InputError(f"no certificate {number} here; `bench registry certificates` lists them", where)
        if why := self.over(number):
            raise InputError(f"certificate {number} {why}; only one that is in force is amended or withdrawn", where)
        return self.issued[number]

    def newest_of(self, run: Path) -> Issued | None:
        """The certificate of a run that was issued last."""
        own = (one for one in self.issued.values() if one.file.parent == run.resolve() and one.is_newest)
        return next(own, None)


def _found(folders: list[Path]) -> Iterator[Issued]:
    for folder in folders:
        if (folder / MANIFEST).is_file() or (folder / ImuRecord.FILE).is_file():
            for file in sorted(folder.glob("certificate*.json")):
                with suppress(InputError):  # a damaged one is told by whoever uses its run
                    record = CertificateRecord.read(folder, file.name)
                    if record.number and record.draft is None:
                        yield Issued(record, file)


def _withdrawn(root: Path) -> dict[str, Mapping[str, Any]]:
    entries = archive.archive(root).entries() if archive.is_archive(root) else []
    return {str(entry["number"]): entry for entry in entries if entry.get("kind") == "withdrawal"}


def state_in(root: Path, number: str) -> str | None:
    """Whether a certificate of an archive is in force, in words; None where the archive does not know it."""
    shelf = Shelf.of_archive(root) if archive.is_archive(root) else Shelf({}, {})
    return (shelf.over(number) or "is in force") if number in shelf.issued else None


def keep_earlier(run: Path, earlier: Issued) -> None:
    """Keep the certificate of a run under its number before another one takes its place."""
    for suffix in _KEPT:
        file = run / f"certificate.{suffix}"
        if file.is_file():
            write(run / f"certificate-{earlier.record.number}.{suffix}", file.read_bytes())


def withdraw_certificate(number: str, reason: str, root: Path, where: str | None) -> Noted:
    """`bench certificate --withdraw`: a certificate of an archive is no longer in force; the ledger says why."""
    Shelf.of_archive(root).in_force(number, root)
    utc = datetime.now(UTC).isoformat(timespec="seconds")
    return registry_tell(root, where, {"kind": "withdrawal", "number": number, "reason": reason, "utc": utc})


def registry_recall(root: Path, where: str | None, equipment: str, since: date | None) -> Recalled:
    """`bench registry recall`: the runs, units and certificates that rest on equipment of this name or serial number.

    What a run was made with stands in its folder; the certificate's own equipment counts as well.
    """
    with existing(root, where) as registry:
        ledger, every = archive.archive(root), archive.runs(registry)
        numbers: dict[str, list[str]] = {}
        for row in archive.certificates(registry):
            numbers.setdefault(row["path"], []).append(str(row["number"]))
    recalled, unknown, elsewhere = [], 0, 0
    for row in sorted(every, key=lambda row: str(row["created"])):
        if since is not None and str(row["created"] or "9999")[:10] < since.isoformat():
            continue
        folder = root / row["path"]
        if row["archive"] != ledger.id or not folder.is_dir():
            elsewhere += 1
            continue
        used = _equipment_of(folder)
        unknown += not used
        if equipment.casefold() in used:
            found = numbers.get(row["path"], [])
            recalled.append({"run": row["path"], "unit": row["unit"], "created": row["created"], "certificates": found})
    return Recalled(equipment, since, recalled, unknown, elsewhere)


def _equipment_of(folder: Path) -> set[str]:
    """Names and serial numbers of what a run and its certificate rest on."""
    tools = [] if not (folder / EQUIPMENT).is_file() else list(deliver.load_instruments(folder / EQUIPMENT))
    names = {text.casefold() for tool in tools for text in (tool.name, tool.serial)}
    record = CertificateRecord.find(folder)
    extra = {} if record is None else record.content()
    for tool in extra.get("equipment") or ():
        names |= {str(tool.get(key, "")).casefold() for key in ("name", "serial")}
    return names - {""}


def registry_certificates(root: Path, where: str | None, unit: str | None) -> CertificatesListed:
    """`bench registry certificates`: every certificate, and whether it is in force."""
    with existing(root, where) as registry:
        return CertificatesListed(registry.url, archive.certificates(registry, unit))
