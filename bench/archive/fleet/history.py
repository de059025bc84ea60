"""The history of one unit: its runs, its calibrations with their status, certificates, and writes into its memory.

A calibration is `in_unit` when the newest record of a write names its run, `newest` when it is the latest that passed,
`not_passed` when it must not be delivered, `superseded` otherwise.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.archive.registry.asking import known_unit, rows_of
from bench.archive.registry.asking import runs as runs_of
from bench.archive.registry.opening import Registry
from bench.archive.registry.rows import IMU
from bench.archive.registry.summaries import calibrates
from bench.base import InputError
from bench.record import (
    CertificateRecord,
    FlashRecord,
    ImuVerificationRecord,
    VerificationRecord,
    slug,
    whole_fitted_to,
    whole_verified,
)

DAY_S = 86400.0
_REFUSED = {"FAIL", "INVALID"}
_IN_UNIT = "in_unit"
_UNPROVEN = {"measured", "unproven", "partial", "no_data"}

Found = dict[str, Any]


@dataclass(frozen=True)
class Archive:
    """The folder of run folders that this bench reads, and its id in the registry."""

    root: Path
    id: str

    def folder(self, run: Mapping[str, Any]) -> Path | None:
        """Folder of a run of the registry; None where it belongs to another archive or no longer exists."""
        if run["archive"] != self.id:
            return None
        folder = self.root / str(run["path"])
        return folder if folder.is_dir() else None


def unit_history(registry: Registry, archive: Archive, serial: str, now: datetime, most: int | None = None) -> Found:
    """The history, newest first, with at most so many runs and calibrations; InputError for an unknown unit.

    `of` says how many there are, `counts` is the calibration that counts: the one in the unit, else the newest usable.
    """
    known = known_unit(registry, serial)
    if known is None:
        raise InputError(f"no unit '{serial}' in the registry; the list of units shows the known ones")
    found = runs_of(registry, serial)
    memory, wholes = writes(archive.root, serial), _wholes(archive.root / slug(serial))
    fitted = calibrations(registry, archive, found, memory, now)
    counting = (one for one in fitted if one["usable"] or one["status"] == _IN_UNIT)
    return {
        "serial": serial,
        "lot": known["lot"],
        "runs": [_run(run, archive, wholes) for run in found[:most]],
        "calibrations": fitted[:most],
        "counts": min(counting, key=lambda one: bool(one["status"] != _IN_UNIT), default=None),
        "of": {"runs": len(found), "calibrations": len(fitted)},
        "memory": next((one for one in memory if one["state"] == "done"), None),
        "writes": memory,
    }


def _wholes(unit: Path) -> Mapping[str, ImuVerificationRecord]:
    """Verifications of a whole inertial unit by their runs; none where one is damaged, which its own page says."""
    with contextlib.suppress(InputError):
        return whole_verified(unit)
    return {}


def _run(run: Mapping[str, Any], archive: Archive, wholes: Mapping[str, ImuVerificationRecord]) -> Found:
    keys = ("created", "profile", "station", "operator", "state", "cause", "simulated", "duration_s", "lost", "verdict",
            "judged", "model")  # fmt: skip
    folder = archive.folder(run)
    told = {key: run[key] for key in keys}
    try:
        verified = (VerificationRecord.find(folder) or wholes.get(folder.name)) if folder else None
    except InputError:
        verified = VerificationRecord(verdict="damaged")
    if verified:
        told["judged"] = verified.verdict
    kind = "verification" if verified or run["corrected"] else "calibration" if run["model"] else "run"
    if run["cause"] == "imported":
        kind = "import"
    return {"run": run["path"], "here": folder is not None, "kind": kind, **told}


def calibrations(
    registry: Registry, archive: Archive, runs: Sequence[Mapping[str, Any]], memory: Sequence[Found], now: datetime
) -> list[Found]:
    """Calibrations of one unit's runs, the newest first."""
    ids = [run["id"] for run in runs]
    tables = ("calibrations", "certificates")
    rows, issued = ({row["run"]: row for row in rows_of(registry, table, ids)} for table in tables)
    printed = dict(_printed(archive.root, slug(str(runs[0]["unit"])))) if runs else {}
    held = next((one["run"] for one in memory if one["state"] == "done"), None)
    out: list[Found] = []
    passed_before = False
    for run in runs:
        row = rows.get(run["id"])
        if row is None or row["model"] is None:
            continue
        held_here = held in _names(run, row, archive)
        if not held_here and not calibrates(run, row["judged"]):
            continue
        refused = row["judged"] in _REFUSED
        passed = not refused and row["verdict"] not in _UNPROVEN
        status = _IN_UNIT if held_here else "not_passed" if not passed else "superseded" if passed_before else "newest"
        usable = status != "not_passed" and not refused
        passed_before |= usable
        certificate = None
        if own := issued.get(run["id"]):
            certificate = {key: own[key] for key in ("number", "verdict", "issued", "operator")}
            certificate["pdf"] = own["number"] in printed
        out.append({
            "run": run["path"], "created": run["created"], "age_days": _age_days(run["created"], now),
            "model": row["model"], "verdict": row["verdict"], "judged": row["judged"], "limits": row["limits"],
            "validity": row["validity"] or {}, "status": status, "usable": usable,
            "certificate": certificate, "coefficients_sha256": row["coefficients_sha256"],
        })  # fmt: skip
    return out


def _names(run: Mapping[str, Any], row: Mapping[str, Any], archive: Archive) -> set[str]:
    """Folders of a calibration: that of its run, or that of a whole inertial unit beside it."""
    folder = archive.folder(run) if row["model"] == IMU else None
    whole = None
    with contextlib.suppress(InputError):  # a damaged record is told where it is opened
        whole = None if folder is None else whole_fitted_to(folder)
    return {str(run["path"]).rpartition("/")[2]} if whole is None else {whole.name}


def printed_certificate(root: Path, serial: str, number: str) -> Path | None:
    """The PDF of the certificate with this number; it lies beside its facts, in the folder of the run or of the job."""
    return dict(_printed(root, slug(serial))).get(number)


def _printed(root: Path, unit: str) -> Iterator[tuple[str, Path]]:
    for pdf in sorted((root / unit).glob("*/certificate*.pdf")):
        with contextlib.suppress(InputError):  # a certificate whose number cannot be read is not the one asked for
            if facts := CertificateRecord.find(pdf.parent, pdf.with_suffix(".json").name):
                yield facts.number, pdf


def writes(root: Path, serial: str) -> list[Found]:
    """Writes of this bench into the unit's memory, newest first, with failed attempts."""
    keys = ("utc", "operator", "protocol", "model", "form", "calibration_id", "bank", "coefficient_set", "crc",
            "state", "error")  # fmt: skip
    records = [_written(path) for path in sorted((root / slug(serial) / "flash").glob("*T*Z*.json"), reverse=True)]
    return [
        {**{key: getattr(record, key) for key in keys}, "run": Path(record.run).name if record.run else None,
         "before": record.old.calibration_id if record.old else None, "words": record.new.words if record.new else None}
        for record in records
    ]  # fmt: skip


def _written(path: Path) -> FlashRecord:
    """A record of the unit's memory; one that is damaged still says when, by its name, and what is wrong with it."""
    try:
        return FlashRecord.read(path.parent, path.name)
    except InputError as error:
        when = ""
        with contextlib.suppress(ValueError):
            when = datetime.strptime(path.name[:16], "%Y%m%dT%H%M%S%z").isoformat()
        return FlashRecord(utc=when, state="damaged", error=str(error))


def _age_days(created: object, now: datetime) -> float | None:
    try:
        return (now - datetime.fromisoformat(str(created))).total_seconds() / DAY_S
    except (ValueError, TypeError):
        return None
