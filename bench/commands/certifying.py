"""`bench certificate`: a run, and its verification, as a certificate on paper and for programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from bench.analysis import Limits, load_limits
from bench.base import InputError
from bench.commands.answer import Answer
from bench.deliver import load_instruments, load_laboratory
from bench.record import write_atomically


@dataclass(frozen=True)
class CertificateOptions:
    """What the caller chooses; None: what the run folder holds, or nothing."""

    verification: Path | None = None
    limits: Path | None = None
    equipment: Path | None = None
    laboratory: Path | None = None
    issued: str | None = None


def certificate(folder: Path, wishes: CertificateOptions, out: Path | None) -> Answer:
    """Write the PDF (default: into the run folder), its facts as JSON beside it and in the run folder."""
    from bench.deliver import budget, facts, facts_text, figures, gather, require_typst, typeset_pdf

    require_typst()
    lab = None if wishes.laboratory is None else load_laboratory(wishes.laboratory)
    tools_file = wishes.equipment or _of_run(folder, "equipment.yaml")
    tools = () if tools_file is None else load_instruments(tools_file)
    evidence = gather(folder, wishes.verification, _limits(folder, wishes), tools)
    issued = _issued(wishes.issued)
    total = budget(evidence)
    content = facts(evidence, lab, total, issued)
    made = typeset_pdf(content, figures(evidence, total.expanded_dph), issued)
    target = out or folder / "certificate.pdf"
    text = facts_text(content).encode()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(target, made)
        for beside in dict.fromkeys((target.with_suffix(".json"), folder / "certificate.json")):
            write_atomically(beside, text)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", target) from None
    as_found, as_left = content["as_found"]["rms_dph"], content["as_left"]["rms_dph"]
    lines = [
        f"Certificate {content['number']}{' (simulated: certifies nothing)' if content['simulated'] else ''}",
        f"as found {as_found:.4g} deg/h RMS, as left {as_left:.4g} deg/h ({content['as_left']['what']})",
        f"U = {total.expanded_dph:.2g} deg/h (k = 2); conformity: {content['verdict'] or 'no limits given'}",
        *_told_verification(content["verification"]),
        *([] if tools else ["warning: no equipment was stated: the results are not metrologically traceable"]),
        *([] if lab else ["warning: no laboratory was stated"]),
        "",
        f"pdf   {target}",
        f"json  {target.with_suffix('.json')}",
    ]
    failed = evidence.verdict is not None and not evidence.verdict.within
    answer = {"run": str(folder), "pdf": str(target), "json": str(target.with_suffix(".json"))}
    keys = ("number", "verdict", "issued", "as_found", "as_left", "simulated")
    return Answer({**answer, **{key: content[key] for key in keys}}, "\n".join(lines), 1 if failed else 0)


def _told_verification(known: Mapping[str, Any] | None) -> list[str]:
    if known is None:
        return []
    (low, high), (first, last) = known["covered_degc"], known["validity_degc"]
    covers = f"{known['covered_percent']:.0f} % of {first:.1f} to {last:.1f} degC ({low:.1f} to {high:.1f} degC)"
    return [f"verification: {known['verdict'] or 'not judged by itself'}, covers {covers}"]


def _limits(folder: Path, wishes: CertificateOptions) -> Limits | None:
    path = wishes.limits or _of_run(folder, "limits.yaml")
    return None if path is None else load_limits(path)


def _of_run(folder: Path, name: str) -> Path | None:
    path = folder / name
    return path if path.is_file() else None


def _issued(text: str | None) -> date:
    if text is None:
        return datetime.now(UTC).date()
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise InputError(f"--issued is '{text}', a day such as 2026-11-21 is wanted") from None
