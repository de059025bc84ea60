"""JUnit XML of a job: each step, each limit and each doubt is a test case, as CI servers show them."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from bench.commands.calibration.job import JobFile
from bench.commands.files import write


def write_junit(job: JobFile, steps: tuple[str, ...], path: Path) -> None:
    """Write it; InputError where that cannot be."""
    write(path, junit(job, steps))


def junit(job: JobFile, steps: tuple[str, ...]) -> bytes:
    """The XML: one suite for the job; a step that was not reached is skipped."""
    unit = job.content["unit"]
    suite = Element("testsuite", name=f"calibrate {unit}", timestamp=job.content["created"].partition("+")[0])
    for name in steps:
        known = job.step(name)
        case = SubElement(suite, "testcase", classname=f"{unit}.steps", name=name, time=f"{_seconds(known):.3f}")
        _outcome(case, known)
        for entry in known.get("cases", ()):
            _judged(SubElement(suite, "testcase", classname=f"{unit}.{name}", name=entry["name"], time="0"), entry)
    count = {tag: str(len(suite.findall(f"testcase/{tag}"))) for tag in ("failure", "error", "skipped")}
    total = {"tests": str(len(suite)), "failures": count["failure"], "errors": count["error"],
             "skipped": count["skipped"], "time": f"{sum(_times(suite)):.3f}"}  # fmt: skip
    suite.attrib |= total
    root = Element("testsuites", {"name": "bench calibrate", **total})
    root.append(suite)
    indent(root)
    content: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _outcome(case: Element, known: dict[str, Any]) -> None:
    state, sentence = known.get("state"), _clean(known.get("sentence") or "")
    if state == "done":
        stopped = known.get("stop") or known.get("hold")
        if stopped:
            SubElement(case, "failure", message=_clean(stopped), type="stop" if known.get("stop") else "hold")
        SubElement(case, "system-out").text = sentence
    elif state is None:
        SubElement(case, "skipped", message="not reached")
    else:
        SubElement(case, "error", message=sentence or "not finished", type=state)


def _judged(case: Element, entry: dict[str, Any]) -> None:
    if entry["skipped"]:
        SubElement(case, "skipped", message=_clean(entry["text"]))
    elif entry["failure"]:
        SubElement(case, "failure", message=_clean(entry["text"]), type=entry["failure"])
    elif entry["text"]:
        SubElement(case, "system-out").text = _clean(entry["text"])


def _seconds(known: dict[str, Any]) -> float:
    if "began" not in known or "ended" not in known:
        return 0.0
    begun, ended = (datetime.fromisoformat(known[key]) for key in ("began", "ended"))
    return max((ended - begun).total_seconds(), 0.0)


def _times(suite: Element) -> Iterator[float]:
    return (float(case.get("time", "0")) for case in suite)


def _clean(text: str) -> str:
    """Without the control characters that XML cannot hold."""
    return "".join(char for char in text if char in "\n\t" or char >= " ")
