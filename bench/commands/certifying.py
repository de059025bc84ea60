"""`bench certificate`: a run, and its verification, as a certificate on paper and for programs."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from bench.base import InputError
from bench.commands.files import write
from bench.commands.registering import refuse_foreign
from bench.commands.results.deliver import Certified
from bench.record import MANIFEST


@dataclass(frozen=True)
class CertificateOptions:
    """What the caller chooses; None: what the run folder holds, or nothing."""

    verifications: tuple[Path, ...] = ()
    """The first one states the figures; all of them are turn-ons."""
    limits: Path | None = None
    equipment: Path | None = None
    laboratory: Path | None = None
    issued: str | None = None


def certificate(folder: Path, options: CertificateOptions, out: Path | None) -> Certified:
    """Write the PDF (default: into the run folder), its facts as JSON beside it and in the run folder."""
    from bench.analysis import load_limits
    from bench.deliver import (
        budget,
        facts,
        facts_text,
        figures,
        gather,
        load_instruments,
        load_laboratory,
        require_typst,
        typeset_pdf,
    )

    require_typst()
    laboratory = None if options.laboratory is None else load_laboratory(options.laboratory)
    equipment_file = options.equipment or _of_run(folder, "equipment.yaml")
    equipment = () if equipment_file is None else load_instruments(equipment_file)
    limits_file = options.limits or _of_run(folder, "limits.yaml")
    limits = None if limits_file is None else load_limits(limits_file)
    for run in (folder, *options.verifications):
        if (run / MANIFEST).is_file():
            refuse_foreign(run)
    evidence = gather(folder, options.verifications, limits, equipment)
    issued = _issued(options.issued)
    total = budget(evidence)
    content = facts(evidence, laboratory, total, issued)
    pdf = out or folder / "certificate.pdf"
    beside = pdf.with_suffix(".json")
    write(pdf, typeset_pdf(content, figures(evidence, total.expanded_dph), issued))
    for path in dict.fromkeys((beside, folder / "certificate.json")):
        write(path, facts_text(content))
    return Certified(folder, pdf, beside, content, evidence.verdict is None or evidence.verdict.within)


def _of_run(folder: Path, name: str) -> Path | None:
    path = folder / name
    return path if path.is_file() else None


def _issued(text: str | None) -> date:
    if text is None:
        return datetime.now(UTC).date()
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise InputError(f"--issued is '{text}', must be a day such as 2026-11-21") from None
