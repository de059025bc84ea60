"""Rows of the registry as run folders and ledger define them. Nothing here touches a database."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import date
from functools import cache
from pathlib import Path
from typing import Any

from sqlalchemy import inspect

from bench.archive.registry.ledger import Ledger
from bench.archive.registry.tables import IN_ORDER, OF_A_RUN
from bench.base import InputError
from bench.record import (
    MANIFEST,
    CalibrationRecord,
    CertificateRecord,
    DiagnosisRecord,
    ImuRecord,
    ImuVerificationRecord,
    Judged,
    LimitsRecord,
    LotRecord,
    RunFolder,
    StoredResidual,
    Verdict,
    VerificationRecord,
    Verified,
    sha256,
    verified_in,
    whole_fitted_to,
)

IMU = "imu"
"""What stands for the model of a whole inertial unit."""
Key = tuple[str, ...]
Row = dict[str, Any]
Rows = dict[str, dict[Key, Row]]
"""Table name to primary key to row."""

PRIMARY: dict[str, tuple[str, ...]] = {
    table.__tablename__: tuple(column.name for column in inspect(table).primary_key) for table in IN_ORDER
}

OF_RUNS = tuple(table.__tablename__ for table in OF_A_RUN)
"""Tables whose rows belong to one run."""


def empty() -> Rows:
    """No rows of any table."""
    return {name: {} for name in PRIMARY}


def put(rows: Rows, table: str, row: Row) -> None:
    """Add a row or replace the one with the same key."""
    rows[table][tuple(row[name] for name in PRIMARY[table])] = row


def update(rows: Rows, more: Rows) -> None:
    """Add the rows of `more`; known units and operators stay as they are."""
    for table, found in more.items():
        for key, row in found.items():
            if table in {"units", "operators"} and key in rows[table]:
                continue
            rows[table][key] = row


def of_archive(ledger: Ledger) -> tuple[Rows, list[str]]:
    """Rows of every run folder and of the ledger, and an error line for each folder that cannot be read."""
    rows, unreadable, seen, verified_of = of_ledger(ledger), [], ledger.seen(), cache(verified_in)
    for manifest in sorted(ledger.root.glob(f"*/*/{MANIFEST}")):
        try:
            update(rows, of_run(RunFolder(manifest.parent), ledger, seen, verified_of))
        except (InputError, OSError) as error:
            unreadable.append(str(error))
    return rows, unreadable


def of_ledger(ledger: Ledger) -> Rows:
    """The archive itself, and the last entry about every instrument, operator and lot."""
    rows = empty()
    put(rows, "archives", {"id": ledger.id, "path": ledger.place})
    for entry in ledger.entries():
        update_by(rows, entry, ledger)
    return rows


def update_by(rows: Rows, entry: Mapping[str, Any], ledger: Ledger) -> None:
    """Add the rows of a line of the ledger; unknown kinds, which a newer bench may have written, are ignored."""
    try:
        if entry.get("kind") == "equipment":
            put(rows, "equipment", {
                "name": str(entry["name"]), "serial": str(entry["serial"]), "kind": str(entry["type"]),
                "calibrated_on": _date(entry.get("calibrated_on")), "due_on": _date(entry.get("due_on")),
                "archive": ledger.id,
            })  # fmt: skip
        elif entry.get("kind") == "withdrawal":
            put(rows, "withdrawals", {
                "number": str(entry["number"]), "reason": str(entry["reason"]), "utc": str(entry["utc"]),
                "archive": ledger.id,
            })  # fmt: skip
        elif entry.get("kind") == "operator":
            put(rows, "operators", {"name": str(entry["name"]), "archive": ledger.id})
        elif entry.get("kind") == "lot":
            for serial in entry["units"]:
                put(rows, "units", {"serial": str(serial), "lot": str(entry["lot"]), "archive": ledger.id})
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"a line of kind '{entry.get('kind')}' is wrong ({error!r}); restore it", ledger.path
        ) from None


def _date(text: str | None) -> date | None:
    return None if text is None else date.fromisoformat(text)


def place_of(folder: RunFolder, ledger: Ledger) -> str:
    """Path of a run folder in its archive."""
    return folder.path.resolve().relative_to(ledger.root.resolve()).as_posix()


def of_run(
    folder: RunFolder,
    ledger: Ledger,
    seen: Mapping[str, tuple[int | None, str]],
    verified_of: Callable[[Path], Verified] = verified_in,
) -> Rows:
    """The rows of one run folder, `seen` by its ledger; InputError where its manifest cannot be read.

    A lot's calibration, which is made from runs of units, is no run of a unit: it has no row.
    """
    rows = empty()
    if (folder.path / LotRecord.FILE).is_file():
        return rows
    manifest = folder.manifest()
    path = place_of(folder, ledger)
    unit, run = manifest.unit or "unknown", f"{ledger.id}/{path}"
    whole = whole_fitted_to(folder.path)
    delivered = whole or folder.path
    certificate = CertificateRecord.find(delivered)
    operator = manifest.operator
    # What compares runs compares those of one profile: outputs of a unit are never mixed.
    profile = manifest.profile if manifest.output == "rate" else f"{manifest.profile} {manifest.output}"
    put(rows, "archives", {"id": ledger.id, "path": ledger.place})
    put(rows, "units", {"serial": unit, "lot": None, "archive": ledger.id})
    if operator is not None:
        put(rows, "operators", {"name": operator, "archive": ledger.id})
    put(rows, "runs", {
        "id": run, "archive": ledger.id, "path": path, "unit": unit, "operator": operator,
        "profile": profile or None, "profile_sha256": manifest.files.get("profile.yaml"),
        "station": manifest.station, "created": manifest.created or None, "state": manifest.state,
        "cause": manifest.cause, "simulated": manifest.simulated, "corrected": manifest.corrected,
        "samples": manifest.rows, "lost": manifest.losses.get("lost"), "duration_s": manifest.duration_s,
        "software": manifest.versions.get("bench"),
        "manifest_sha256": sha256(folder.path / MANIFEST), "seen": seen.get(path, (None, ""))[0],
    })  # fmt: skip
    calibration = CalibrationRecord.find(folder.path)
    judged: Judged = LimitsRecord.find(folder.path) or LimitsRecord()
    if whole is not None:
        verified = ImuVerificationRecord.find(whole)
        put(rows, "calibrations", _whole(run, whole, verified))
        judged = verified.limits if verified and verified.limits else judged
    elif calibration is not None:
        row = _calibration(run, calibration, sha256(folder.path / CalibrationRecord.FILE))
        word = _as_verified(verified_of(folder.path.parent).get(folder.path.name, ()), judged.verdict)
        put(rows, "calibrations", {**row, "judged": word, "limits": judged.name})
    if (diagnosis := DiagnosisRecord.find(folder.path)) is not None:
        file_sha256 = sha256(folder.path / DiagnosisRecord.FILE)
        put(rows, "diagnoses", {"run": run, "model": diagnosis.model, "verdict": diagnosis.verdict,
                                "lacks": ",".join(diagnosis.lacks), "file_sha256": file_sha256})  # fmt: skip
    if certificate is not None:
        put(rows, "certificates", _certificate(run, certificate, sha256(delivered / CertificateRecord.FILE)))
    for file in sorted(delivered.glob("certificate*.json")):
        one = CertificateRecord.read(delivered, file.name)
        if one.draft is None:
            put(rows, "issues", _issue(run, one, sha256(file)))
    for name, unit_of, value in _quantities(calibration or CalibrationRecord(), certificate, judged):
        put(rows, "quantities", {"run": run, "name": name, "unit": unit_of, "value": value})
    return rows


def _as_verified(found: Iterable[tuple[Path, VerificationRecord]], judged: str | None) -> str | None:
    """The word of a calibration: FAIL where the newest verification with a verdict on the unit is FAIL."""
    words = [record.verdict for _, record in found if record.verdict.judged]
    return Verdict.FAIL.value if words and words[-1] is Verdict.FAIL else judged


def _calibration(run: str, record: CalibrationRecord, file_sha256: str) -> Row:
    fit = record.calibration.content() if record.calibration else {}
    delivered = {key: fit.get(key) for key in ("model", "coefficients", "parameters", "validity")}
    canonical = json.dumps(delivered, sort_keys=True, separators=(",", ":"))
    return {
        "run": run,
        "verdict": record.verdict.verdict,
        "model": record.calibration.model.name if record.calibration else None,
        "coefficients_sha256": hashlib.sha256(canonical.encode()).hexdigest() if fit else None,
        "validity": fit.get("validity"),
        "file_sha256": file_sha256,
    }


def _whole(run: str, folder: Path, verified: ImuVerificationRecord | None) -> Row:
    """The calibration of a whole inertial unit; nothing proves one that was not verified."""
    low, high = ImuRecord.read(folder).range_degc
    file_sha256 = sha256(folder / ImuRecord.FILE)
    return {
        "run": run,
        "verdict": "unproven" if verified is None else None,
        "judged": verified.verdict if verified else None,
        "limits": verified.limits.name if verified and verified.limits else None,
        "model": IMU,
        "coefficients_sha256": file_sha256,
        "validity": {"temperature": {"from": low, "to": high}},
        "file_sha256": file_sha256,
    }


def _certificate(run: str, record: CertificateRecord, file_sha256: str) -> Row:
    return {
        "run": run,
        "number": record.number,
        "verdict": record.verdict,
        "issued": record.issued,
        "operator": record.operator,
        "file_sha256": file_sha256,
    }


def _issue(run: str, record: CertificateRecord, file_sha256: str) -> Row:
    amends = record.amends or {}
    return {
        "run": run,
        "number": record.number,
        "verdict": record.verdict,
        "issued": record.issued,
        "amends": amends.get("number"),
        "reason": amends.get("reason"),
        "file_sha256": file_sha256,
    }


_NOISE = {
    "white": ("angle_random_walk_dprh", "deg/sqrt(h)"),
    "flicker": ("bias_instability_dph", "deg/h"),
    "walk": ("rate_random_walk_dphrh", "deg/h/sqrt(h)"),
}


def _quantities(
    calibration: CalibrationRecord, certificate: CertificateRecord | None, judged: Judged
) -> Iterator[tuple[str, str | None, float]]:
    """Name, unit and value of the numbers that describe the unit; a later one of the same name replaces an earlier."""
    noise, residual = calibration.noise, calibration.residual or StoredResidual()
    found: list[tuple[str, str | None, float | None]] = [
        ("noise_floor_dph", "deg/h", noise.floor_dph),
        ("fit_rms_dph", "deg/h", residual.rms_dph),
        ("residual_rms_dph", "deg/h", next((part.rms_dph for part in residual.held_out), None)),
    ]
    found += [(*_NOISE[c.name], c.value) for c in noise.coefficients if c.name in _NOISE and c.determined]
    printed = certificate.results if certificate else ()
    found += [(entry.name, entry.unit, entry.value) for entry in (*printed, *judged.results)]
    for name, unit, value in found:
        if value is not None:
            yield name, unit, value
