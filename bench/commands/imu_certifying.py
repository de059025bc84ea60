"""`bench certificate` of a whole inertial unit: its record, and its verification, on paper and for programs."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from bench.base import InputError
from bench.commands.certifying import CertificateOptions, issued_on
from bench.commands.files import write
from bench.commands.papers import Papers
from bench.commands.results.deliver import ImuCertified
from bench.record import MANIFEST, CertificateRecord, ImuRecord, ImuVerificationRecord, prove


def is_imu(folder: Path) -> bool:
    """Whether a folder (or imu.json) holds the calibration of an inertial unit, and no run."""
    return not (folder / MANIFEST).is_file() and ImuRecord.at(folder) is not None


def imu_certificate(folder: Path, options: CertificateOptions, out: Path | None) -> ImuCertified:
    """Write PDF, XML and facts of a record's certificate, as those of a run.

    InputError where the record is not proven, has findings or undetermined parameters, or where laboratory, signatory
    or equipment is missing and it is no draft.
    """
    from bench.deliver import (
        Issue,
        facts_text,
        imu_dcc,
        imu_facts,
        lacking,
        load_instruments,
        load_laboratory,
        refuse_overdue,
        require_typst,
        signer_of,
        typeset_pdf,
    )

    require_typst()
    record, issued = ImuRecord.of(folder), issued_on(options.issued)
    _refuse(folder, record, options)
    verified = ImuVerificationRecord.find(folder)
    papers = Papers.of_files(options.laboratory, options.equipment).over(Papers.of_run(folder))
    laboratory = None if papers.laboratory is None else load_laboratory(papers.laboratory)
    equipment = () if papers.equipment is None else load_instruments(papers.equipment)
    lacks = lacking(papers.laboratory, papers.equipment, folder)
    if lacks and not options.draft:
        raise lacks[0].error()
    refuse_overdue(equipment, datetime.fromisoformat(record.created).date())
    signer = None if options.draft else signer_of(options.sign_key, options.sign_certificate, record.simulated)
    across = (tuple(lack.what for lack in lacks) or ("not issued",)) if options.draft else None
    issue = Issue(across, None if signer is None else signer.to_json())
    content = imu_facts(record, verified, laboratory, equipment, issued, issue)
    pdf = out or folder / ("draft.pdf" if options.draft else "certificate.pdf")
    xml = imu_dcc(content) if signer is None else signer.sign_xml(imu_dcc(content))
    paper = typeset_pdf(content, {}, xml, issued, "imu")
    write(pdf, paper if signer is None else signer.sign_pdf(paper, f"Certificate {content['number']}"))
    beside, kept = pdf.with_suffix(".json"), folder / CertificateRecord.FILE
    for path in dict.fromkeys((beside,) if options.draft else (beside, kept)):
        write(path.with_suffix(".xml"), xml)
        write(path, facts_text(content))
    return ImuCertified(folder, pdf, beside, beside.with_suffix(".xml"), content)


def _refuse(folder: Path, record: ImuRecord, options: CertificateOptions) -> None:
    if not folder.is_dir():
        raise InputError("name the folder with imu.json: verification and certificate stand there", folder)
    if options.verifications or options.limits:
        raise InputError(
            "an inertial unit is verified, and judged by limits, with `bench imu TABLE --verify`: leave out "
            "--verification and --limits", folder,
        )  # fmt: skip
    if options.amends is not None:
        raise InputError("certificates of inertial units are not amended; issue a new one", folder)
    wrong = [f"{finding.where}: {finding.text}" for finding in record.findings]
    wrong += [f"not determined: {text}" for text in record.undetermined]
    if wrong:
        raise InputError(f"no certificate: {wrong[0]}; correct it and calibrate again", folder)
    if not record.unit:
        raise InputError("no certificate: the unit has no serial number; calibrate with --unit", folder)
    prove(folder)
