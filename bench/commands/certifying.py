"""`bench certificate`: a run, and its verification, as a certificate on paper and for programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from bench import analysis, archive, deliver
from bench.base import InputError
from bench.commands.files import write
from bench.commands.issuing import NO_REASON, Issued, Shelf, keep_earlier, state_in
from bench.commands.papers import Papers
from bench.commands.registering import refuse_foreign
from bench.commands.results.deliver import CertificateChecked, Certified
from bench.record import MANIFEST, CertificateRecord


@dataclass(frozen=True)
class CertificateOptions:
    """What the caller chooses; None: what the run folder holds, or nothing."""

    verifications: tuple[Path, ...] = ()
    """The first one states the figures; all of them are turn-ons."""
    limits: Path | None = None
    equipment: Path | None = None
    laboratory: Path | None = None
    issued: str | None = None
    give: str = deliver.FILES
    """How papers that are missing are given (`deliver.lacking`)."""
    draft: bool = False
    """Print it even where laboratory, signatory, equipment or a due date is missing, with that across each page."""
    amends: str | None = None
    """Number of the certificate that this one replaces, and why."""
    reason: str | None = None
    sign_key: Path | None = None
    sign_certificate: Path | None = None
    """PEM files of the key that signs, and of its certificate; None: those in the folder of the keys."""


@dataclass(frozen=True)
class Desk:
    """What a certificate needs beside its evidence."""

    laboratory: deliver.Laboratory | None
    equipment: tuple[deliver.Instrument, ...]
    lacks: tuple[deliver.Lack, ...]
    issued: date

    @classmethod
    def of(cls, folder: Path, options: CertificateOptions) -> Desk:
        """The papers of the caller, else those in the folder."""
        deliver.require_typst()
        papers = Papers.of_files(options.laboratory, options.equipment).over(Papers.of_run(folder))
        laboratory = None if papers.laboratory is None else deliver.load_laboratory(papers.laboratory)
        equipment = () if papers.equipment is None else deliver.load_instruments(papers.equipment)
        lacks = tuple(deliver.lacking(papers.laboratory, papers.equipment, folder, options.give))
        return cls(laboratory, equipment, lacks, issued_on(options.issued))


@dataclass(frozen=True)
class Document:
    """How the facts of a certificate, its XML and its page are made."""

    simulated: bool
    facts: Callable[[deliver.Issue], dict[str, Any]]
    xml: Callable[[Mapping[str, Any]], bytes]
    page: Callable[[Mapping[str, Any], bytes], bytes]


def publish(
    folder: Path, options: CertificateOptions, desk: Desk, document: Document, out: Path | None
) -> tuple[Path, dict[str, Any]]:
    """Write PDF, XML and facts, signed unless it is a draft; the PDF and the facts.

    A draft is written beside the folder's certificate and never takes its place; a certificate that another one
    replaces is kept under its number. InputError where the desk lacks something and it is no draft.
    """
    if desk.lacks and not options.draft:
        raise desk.lacks[0].error()
    across = (tuple(lack.what for lack in desk.lacks) or ("not issued",)) if options.draft else None
    signer = (
        None if options.draft else deliver.signer_of(options.sign_key, options.sign_certificate, document.simulated)
    )
    signs = None if signer is None else signer.to_json()
    content, earlier = _amending(folder, options, lambda amends: document.facts(deliver.Issue(across, signs, amends)))
    pdf = out or folder / ("draft.pdf" if options.draft else "certificate.pdf")
    beside, kept = pdf.with_suffix(".json"), folder / CertificateRecord.FILE
    if options.draft and beside.resolve() == kept.resolve():
        raise InputError("a draft must not take the place of the certificate; choose another file with --out", pdf)
    xml = document.xml(content) if signer is None else signer.sign_xml(document.xml(content))
    paper = document.page(content, xml)
    if earlier is not None and earlier.record.number != content["number"]:
        keep_earlier(folder, earlier)
    write(pdf, paper if signer is None else signer.sign_pdf(paper, f"Certificate {content['number']}"))
    for path in dict.fromkeys((beside,) if options.draft else (beside, kept)):
        write(path.with_suffix(".xml"), xml)
        write(path, deliver.facts_text(content))
    return pdf, content


def certificate(folder: Path, options: CertificateOptions, out: Path | None) -> Certified:
    """Write the PDF (default: into the run folder), its facts as JSON beside it and in the run folder."""
    desk = Desk.of(folder, options)
    limits_file = options.limits or _of_run(folder, "limits.yaml")
    limits = None if limits_file is None else analysis.load_limits(limits_file)
    for run in (folder, *options.verifications):
        if (run / MANIFEST).is_file():
            refuse_foreign(run)
    evidence = deliver.gather(folder, options.verifications, limits, desk.equipment)
    total = deliver.budget(evidence)
    document = Document(
        bool(evidence.manifest.simulated),
        lambda issue: deliver.facts(evidence, desk.laboratory, total, desk.issued, issue),
        deliver.dcc_xml,
        lambda content, xml: deliver.typeset_pdf(
            content, deliver.figures(evidence, total.expanded_dph), xml, desk.issued
        ),
    )
    pdf, content = publish(folder, options, desk, document, out)
    return Certified(folder, pdf, pdf.with_suffix(".json"), pdf.with_suffix(".xml"), content)


def _amending(
    folder: Path, options: CertificateOptions, content_of: Callable[[Mapping[str, Any] | None], dict[str, Any]]
) -> tuple[dict[str, Any], Issued | None]:
    """What the certificate says, and the one of this run whose files it takes the place of.

    It amends the one that is named, or else, in an archive, the one of this run that is in force.
    """
    if options.draft:
        return content_of(None), None
    shelf = Shelf.around(folder)
    newest = shelf.newest_of(folder)
    if options.amends is not None:
        named = shelf.in_force(options.amends, folder)
        return content_of(named.reference(str(options.reason))), newest
    if newest is None or not archive.is_archive(folder.resolve().parent.parent):
        return content_of(None), None
    if shelf.over(newest.record.number):
        return content_of(None), newest
    again = content_of(newest.record.amends)
    if again["number"] == newest.record.number:
        return again, newest
    return content_of(newest.reference(options.reason or NO_REASON)), newest


def verify_certificate(file: Path, trust: Sequence[Path], root: Path) -> CertificateChecked:
    """`bench certificate --verify`: whether a PDF or an XML is as it was signed, by whom, and in force."""
    deliver.require_typst()
    checked = deliver.check_certificate(file, trust)
    return CertificateChecked(checked, None if checked.number is None else state_in(root, checked.number))


def _of_run(folder: Path, name: str) -> Path | None:
    path = folder / name
    return path if path.is_file() else None


def issued_on(text: str | None) -> date:
    """The day of issue; today (UTC) where none is given. InputError for what is no day."""
    if text is None:
        return datetime.now(UTC).date()
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise InputError(f"--issued is '{text}', must be a day such as 2026-11-21") from None
