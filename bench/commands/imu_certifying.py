"""`bench certificate` of a whole inertial unit: its record, and its verification, on paper and for programs."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from bench import deliver
from bench.base import InputError
from bench.commands.certifying import CertificateOptions, Desk, Document, publish
from bench.commands.results.deliver import ImuCertified
from bench.record import MANIFEST, ImuRecord, ImuVerificationRecord, prove


def is_imu(folder: Path) -> bool:
    """Whether a folder (or imu.json) holds the calibration of an inertial unit, and no run."""
    return not (folder / MANIFEST).is_file() and ImuRecord.at(folder) is not None


def imu_certificate(folder: Path, options: CertificateOptions, out: Path | None) -> ImuCertified:
    """Write PDF, XML and facts of a record's certificate, as those of a run.

    InputError where the record is not proven, has findings or undetermined parameters, or where laboratory, signatory
    or equipment is missing and it is no draft.
    """
    record = ImuRecord.of(folder)
    _refuse(folder, record, options)
    verified = ImuVerificationRecord.find(folder)
    desk = Desk.of(folder, options)
    deliver.refuse_overdue(desk.equipment, datetime.fromisoformat(record.created).date())
    document = Document(
        record.simulated,
        lambda issue: deliver.imu_facts(record, verified, desk.laboratory, desk.equipment, desk.issued, issue),
        deliver.imu_dcc,
        lambda content, xml: deliver.typeset_pdf(content, {}, xml, desk.issued, "imu"),
    )
    pdf, content = publish(folder, options, desk, document, out)
    return ImuCertified(folder, pdf, pdf.with_suffix(".json"), pdf.with_suffix(".xml"), content)


def _refuse(folder: Path, record: ImuRecord, options: CertificateOptions) -> None:
    if not folder.is_dir():
        raise InputError("name the folder with imu.json: verification and certificate stand there", folder)
    if options.verifications or options.limits:
        raise InputError(
            "an inertial unit is verified, and judged by limits, with `bench imu TABLE --verify`: leave out "
            "--verification and --limits", folder,
        )  # fmt: skip
    wrong = [f"{finding.where}: {finding.text}" for finding in record.findings]
    wrong += [f"not determined: {text}" for text in record.undetermined]
    if wrong:
        raise InputError(f"no certificate: {wrong[0]}; correct it and calibrate again", folder)
    if not record.unit:
        raise InputError("no certificate: the unit has no serial number; calibrate with --unit", folder)
    prove(folder)
