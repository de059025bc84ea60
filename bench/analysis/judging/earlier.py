"""The diagnosis that a run folder holds already: a new one made from fewer runs does not overwrite it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.analysis.diagnosis.answer import Diagnosis

SAVED, BEFORE = "diagnosis.json", "diagnosis-before.json"


def set_aside(folder: Path, answer: Diagnosis | None) -> str:
    """Keep the diagnosis of before under another name if it knew a run that `answer` does not; then say so, else ''."""
    known = _runs(_read(folder / SAVED))
    lost = known - (set() if answer is None else _runs(answer.to_json()))
    if not lost:
        return ""
    (folder / SAVED).replace(folder / BEFORE)
    if answer is None:
        return f"the earlier diagnosis is kept as {BEFORE}"
    return (
        f"the earlier diagnosis was also made with {' and '.join(sorted(lost))}, the new one was not; the former is "
        f"kept as {BEFORE}; give the run again with --static or --check"
    )


def _runs(content: Mapping[str, Any]) -> set[str]:
    """Names of all runs behind a diagnosis, as its JSON has them."""
    return {*content.get("runs", ()), *content.get("check", ()), *filter(None, [content.get("static")])}


def _read(path: Path) -> dict[str, Any]:
    """The JSON object; empty where there is none that can be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
