"""How a run ended, in its own words: from its journals at once, from its analysis when that is done."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench import remote
from bench.remote import LiveRun
from bench.store import RunFolder

CALIBRATION, LIMITS_JSON = "calibration.json", "limits.json"
NO_VERDICT: dict[str, Any] = {"analysing": True, "units": [], "verdict": None, "sentence": ""}
EVENTS = ("request", "safe_state", "end")


def ending(run: LiveRun) -> dict[str, Any] | None:
    """The end of a run whose process has written it; None while it has not."""
    events = remote.ending(run, 0.0)
    return told(events) if events else None


def told(events: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """State, cause, what became of the equipment and who asked for what, from the events of a run."""
    end = next((event for event in reversed(events) if event["kind"] == "end"), None)
    # What is only on the way to the safe state (warming up, another try) has no `ok` yet.
    said = [event for event in events if event["kind"] == "safe_state" and "ok" in event]
    steps = [{"text": event["text"], "ok": bool(event["ok"])} for event in said]
    asked = [
        {"request": event.get("request"), "who": event.get("who"), "utc": event.get("utc")}
        for event in events
        if event["kind"] == "request"
    ]
    return {
        "state": end["state"] if end else "aborted",
        "cause": end["text"] if end else "the bench was killed",
        "safe": all(step["ok"] for step in steps) if end else None,
        "safe_state": steps,
        "requests": asked,
    }


def of_folders(folders: Sequence[Path]) -> dict[str, Any]:
    """The end of a run whose tables are made; its first folder speaks for all that they share."""
    run = RunFolder(folders[0])
    manifest = run.manifest()
    story = told([event for event in run.events() if event["kind"] in EVENTS])
    story |= {key: manifest[key] for key in ("state", "cause") if key in manifest}
    return {**story, **verdicts(folders)}


def verdicts(folders: Sequence[Path]) -> dict[str, Any]:
    """The verdict on each unit, and on all together the worst; `analysing` until the last report is written."""
    units = [_verdict(folder) for folder in folders]
    ready = all(RunFolder(folder).report.is_file() for folder in folders)
    known = [unit for unit in units if unit["verdict"] is not None] if ready else []
    worst = min(known, key=_rank, default={"verdict": None, "sentence": ""})
    return {
        "analysing": not ready,
        "units": units,
        "verdict": worst["verdict"],
        "sentence": worst["sentence"],
    }


def _rank(unit: Mapping[str, Any]) -> int:
    from bench.workflow.several import WORST_FIRST

    return WORST_FIRST.index(unit["verdict"]) if unit["verdict"] in WORST_FIRST else 0


def _verdict(folder: Path) -> dict[str, Any]:
    judged = _json(folder / CALIBRATION).get("verdict") or {}
    limits = _json(folder / LIMITS_JSON).get("verdict")
    return {
        "unit": folder.parent.name,
        "run": f"{folder.parent.name}/{folder.name}",
        "verdict": judged.get("verdict"),
        "sentence": judged.get("sentence", ""),
        "limits": limits,
    }


def state_of(content: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict on a unit out of the answer of `bench run --json`."""
    limits = content.get("limits")
    return {
        "unit": content.get("unit") or Path(str(content.get("run", ""))).parent.name,
        "verdict": content.get("verdict"),
        "sentence": content.get("sentence", ""),
        "limits": limits.get("verdict") if isinstance(limits, dict) else None,
    }


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a run folder, or nothing."""
    return _json(folder / "manifest.json")
