"""JUnit XML, as CI servers show it: suites of test cases, and what they count."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from bench.commands.calibration.job import Case

_COUNTED = {"failure": "failures", "error": "errors", "skipped": "skipped"}


def add_case(suite: Element, where: str, name: str, seconds: float = 0.0) -> Element:
    """A test case in a suite."""
    return SubElement(suite, "testcase", classname=where, name=name, time=f"{seconds:.3f}")


def add_outcome(case: Element, tag: str, text: str, kind: str = "") -> None:
    """What became of it: `failure`, `error`, `skipped`, or `system-out` for what is only said."""
    if tag == "system-out":
        SubElement(case, tag).text = _clean(text)
    else:
        SubElement(case, tag, {"message": _clean(text), **({"type": kind} if kind else {})})


def add_judged(suite: Element, where: str, case: Case) -> None:
    """A limit or a doubt as a test case."""
    added = add_case(suite, where, case.name)
    if case.skipped:
        add_outcome(added, "skipped", case.text)
    elif case.failure:
        add_outcome(added, "failure", case.text, case.failure)
    elif case.text:
        add_outcome(added, "system-out", case.text)


def document(name: str, suites: Sequence[Element]) -> bytes:
    """The file of these suites, all counted."""
    root = Element("testsuites", name=name)
    root.extend(suites)
    for element in (*suites, root):
        cases = element.findall(".//testcase")
        element.set("tests", str(len(cases)))
        for tag, key in _COUNTED.items():
            element.set(key, str(len(element.findall(f".//testcase/{tag}"))))
        element.set("time", f"{sum(float(case.get('time', '0')) for case in cases):.3f}")
    indent(root)
    content: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _clean(text: str) -> str:
    """Without the control characters that XML cannot hold."""
    return "".join(char for char in text if char in "\n\t" or char >= " ")
