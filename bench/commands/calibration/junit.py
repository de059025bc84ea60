"""JUnit XML of a job: each step, each limit and each doubt is a test case, as CI servers show them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from bench.commands.calibration.job import Case, JobFile
from bench.commands.files import write
from bench.commands.junit import add_case, add_judged, add_outcome, document


def write_junit(jobs: Sequence[JobFile], steps: tuple[str, ...], path: Path) -> None:
    """Write it; InputError where that cannot be."""
    write(path, junit(jobs, steps))


def junit(jobs: Sequence[JobFile], steps: tuple[str, ...]) -> bytes:
    """The XML: one suite for each job; a step that was not reached is skipped."""
    return document("bench calibrate", [_suite(job, steps) for job in jobs])


def _suite(job: JobFile, steps: tuple[str, ...]) -> Element:
    unit = job.content["unit"]
    suite = Element("testsuite", name=f"calibrate {unit}", timestamp=job.content["created"].partition("+")[0])
    for name in steps:
        known = job.step(name)
        _outcome(add_case(suite, f"{unit}.steps", name, _seconds(known)), known)
        for entry in known.get("cases", ()):
            add_judged(suite, f"{unit}.{name}", Case(**entry))
    return suite


def _outcome(case: Element, known: dict[str, Any]) -> None:
    state, sentence = known.get("state"), known.get("sentence") or ""
    if state == "done":
        if stopped := known.get("stop") or known.get("hold"):
            add_outcome(case, "failure", stopped, "stop" if known.get("stop") else "hold")
        add_outcome(case, "system-out", sentence)
    elif state is None:
        add_outcome(case, "skipped", "not reached")
    else:
        add_outcome(case, "error", sentence or "not finished", state)


def _seconds(known: dict[str, Any]) -> float:
    if "began" not in known or "ended" not in known:
        return 0.0
    begun, ended = (datetime.fromisoformat(known[key]) for key in ("began", "ended"))
    return max((ended - begun).total_seconds(), 0.0)
