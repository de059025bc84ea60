"""The diagnosis that a run folder holds already: a new one made from fewer runs does not overwrite it."""

from __future__ import annotations

from pathlib import Path

from bench.base import InputError
from bench.record import DiagnosisRecord, drop

SAVED, BEFORE = DiagnosisRecord.FILE, DiagnosisRecord.BEFORE


def set_aside(folder: Path, answer: DiagnosisRecord | None) -> str:
    """Keep the diagnosis of before under another name if it knew a run that `answer` does not; then say so, else ''."""
    try:
        saved = DiagnosisRecord.find(folder)
    except InputError as error:
        return f"the earlier diagnosis is replaced: {error}"
    known = set() if saved is None else saved.everything()
    lost = known - (set() if answer is None else answer.everything())
    if not lost:
        return ""
    if saved is not None:
        saved.write(folder, BEFORE)
    drop(folder, SAVED)
    if answer is None:
        return f"the earlier diagnosis is kept as {BEFORE}"
    return (
        f"the earlier diagnosis was also made with {' and '.join(sorted(lost))}, the new one was not; the former is "
        f"kept as {BEFORE}; give the run again with --static or --check"
    )
