"""`bench certificate`: a run, and its verification, as a certificate on paper and for programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base import InputError
from bench.commands.files import write
from bench.commands.issuing import NO_REASON, Issued, Shelf, keep_earlier, state_in
from bench.commands.papers import Papers
from bench.commands.registering import refuse_foreign
from bench.commands.results.deliver import CertificateChecked, Certified
from bench.record import MANIFEST, CertificateRecord

if TYPE_CHECKING:
    from bench.deliver import Lack


@dataclass(frozen=True)
class CertificateOptions:
    """What the caller chooses; None: what the run folder holds, or nothing."""

    verifications: tuple[Path, ...] = ()
    """The first one states the figures; all of them are turn-ons."""
    limits: Path | None = None
    equipment: Path | None = None
    laboratory: Path | None = None
    issued: str | None = None
    draft: bool = False
    """Print it even where laboratory, signatory, equipment or a due date is missing, with that across each page."""
    amends: str | None = None
    """Number of the certificate that this one replaces, and why."""
    reason: str | None = None
    sign_key: Path | None = None
    sign_certificate: Path | None = None
    """PEM files of the key that signs, and of its certificate; None: those in the folder of the keys."""


def certificate(folder: Path, options: CertificateOptions, out: Path | None) -> Certified:
    """Write the PDF (default: into the run folder), its facts as JSON beside it and in the run folder.

    A draft is written beside the run's certificate and never takes its place.
    """
    from bench.analysis import load_limits
    from bench.deliver import (
        Issue,
        budget,
        dcc_xml,
        facts,
        facts_text,
        figures,
        gather,
        lacking,
        load_instruments,
        load_laboratory,
        require_typst,
        signer_of,
        typeset_pdf,
    )

    require_typst()
    papers = Papers.of_files(options.laboratory, options.equipment).over(Papers.of_run(folder))
    laboratory = None if papers.laboratory is None else load_laboratory(papers.laboratory)
    equipment = () if papers.equipment is None else load_instruments(papers.equipment)
    limits_file = options.limits or _of_run(folder, "limits.yaml")
    limits = None if limits_file is None else load_limits(limits_file)
    for run in (folder, *options.verifications):
        if (run / MANIFEST).is_file():
            refuse_foreign(run)
    evidence = gather(folder, options.verifications, limits, equipment)
    lacks = lacking(papers.laboratory, papers.equipment, folder)
    if lacks and not options.draft:
        raise lacks[0].error()
    issued = issued_on(options.issued)
    total = budget(evidence)
    signer = None
    if not options.draft:
        signer = signer_of(options.sign_key, options.sign_certificate, bool(evidence.manifest.simulated))

    def content_of(amends: Mapping[str, Any] | None) -> dict[str, Any]:
        draft, signs = _across(lacks) if options.draft else None, None if signer is None else signer.to_json()
        return facts(evidence, laboratory, total, issued, Issue(draft, signs, amends))

    content, earlier = _amending(folder, options, content_of)
    pdf = out or folder / ("draft.pdf" if options.draft else "certificate.pdf")
    beside = pdf.with_suffix(".json")
    kept = folder / CertificateRecord.FILE
    if options.draft and beside.resolve() == kept.resolve():
        raise InputError("a draft must not take the place of the certificate; choose another file with --out", pdf)
    xml = dcc_xml(content) if signer is None else signer.sign_xml(dcc_xml(content))
    paper = typeset_pdf(content, figures(evidence, total.expanded_dph), xml, issued)
    if earlier is not None and earlier.record.number != content["number"]:
        keep_earlier(folder, earlier)
    write(pdf, paper if signer is None else signer.sign_pdf(paper, f"Certificate {content['number']}"))
    for path in dict.fromkeys((beside,) if options.draft else (beside, kept)):
        write(path.with_suffix(".xml"), xml)
        write(path, facts_text(content))
    return Certified(
        folder, pdf, beside, beside.with_suffix(".xml"), content, evidence.verdict is None or evidence.verdict.within
    )


def _amending(
    folder: Path, options: CertificateOptions, content_of: Callable[[Mapping[str, Any] | None], dict[str, Any]]
) -> tuple[dict[str, Any], Issued | None]:
    """What the certificate says, and the one of this run whose files it takes the place of.

    It amends the one that is named, or else, in an archive, the one of this run that is in force.
    """
    from bench.archive import is_archive

    if options.draft:
        return content_of(None), None
    shelf = Shelf.around(folder)
    newest = shelf.newest_of(folder)
    if options.amends is not None:
        named = shelf.in_force(options.amends, folder)
        return content_of(named.reference(str(options.reason))), newest
    if newest is None or not is_archive(folder.resolve().parent.parent):
        return content_of(None), None
    if shelf.over(newest.record.number):
        return content_of(None), newest
    again = content_of(newest.record.amends)
    if again["number"] == newest.record.number:
        return again, newest
    return content_of(newest.reference(options.reason or NO_REASON)), newest


def _across(lacks: Sequence[Lack]) -> tuple[str, ...]:
    return tuple(lack.what for lack in lacks) or ("not issued",)


def verify_certificate(file: Path, trust: Sequence[Path], root: Path) -> CertificateChecked:
    """`bench certificate --verify`: whether a PDF or an XML is as it was signed, by whom, and in force."""
    from bench.deliver import check_certificate, require_typst

    require_typst()
    checked = check_certificate(file, trust)
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
