"""JUnit XML of `bench run`: a suite for each unit; its segments, record, verdict and limits are test cases."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree.ElementTree import Element

from bench.base import BenchError
from bench.commands.calibration.doubts import judged
from bench.commands.files import write
from bench.commands.junit import add_case, add_judged, add_outcome, document
from bench.commands.results.analyse import NotAnalysed, Reported, UnitsReported
from bench.record import ExecutedSegment
from drivers.errors import DriverError

NAME = "bench run"


def with_junit(work: Callable[[], Reported | UnitsReported], profile: str, path: Path) -> Reported | UnitsReported:
    """Do the work, and write its JUnit XML; a run that was refused is an error in it, and raised again.

    It is written at the beginning, too: one of an earlier run would be taken for this one's if this process was killed.
    InputError, before anything moves, where it cannot be written.
    """
    write(path, _not_run(profile, "not finished", "unfinished"))
    try:
        done = work()
    except (BenchError, DriverError) as error:
        write(path, _not_run(profile, str(error), type(error).__name__))
        raise
    write(path, junit(done))
    return done


def _not_run(profile: str, text: str, kind: str) -> bytes:
    suite = Element("testsuite", name=profile)
    add_outcome(add_case(suite, profile, "run"), "error", text, kind)
    return document(NAME, [suite])


def junit(result: Reported | UnitsReported) -> bytes:
    """The XML; it has a failure or an error if and only if the exit code is not 0. Times are bench time."""
    if isinstance(result, UnitsReported):
        return document(NAME, [_suite(unit.name, unit.result) for unit in result.units])
    return document(NAME, [_suite(result.analysis.manifest.unit, result)])


def _suite(unit: str, result: Reported | NotAnalysed) -> Element:
    if isinstance(result, NotAnalysed):
        suite = Element("testsuite", name=unit)
        add_outcome(add_case(suite, unit, "run"), "error", result.error, "not analysed")
        return suite
    analysis, error = result.analysis, result.error
    manifest, done = analysis.manifest, analysis.done
    suite = Element("testsuite", name=f"{manifest.profile} {unit}", timestamp=manifest.created.partition("+")[0])
    run = add_case(suite, unit, "run", manifest.duration_s - sum(s.to_s - s.from_s for s in done.segments))
    if error is not None:
        add_outcome(run, "error", str(error), done.state)
    for segment in done.segments:
        case = add_case(suite, f"{unit}.segments", segment.name, segment.to_s - segment.from_s)
        _segment(case, segment, bool(result.exit_code) and segment in done.failed)
    lacks = [f"{done.lost} frames lost or damaged"] if done.lost else []
    lacks += [f"{entry.why}: {entry.samples} samples left out" for entry in done.left_out]
    record, judgement = add_case(suite, unit, "record"), analysis.judgement
    if lacks:
        add_outcome(record, "system-out", "; ".join(lacks))
    verdict = add_case(suite, unit, "verdict")
    word = analysis.verdict.word if judgement is None else judgement.verdict.value
    if error is None and not analysis.within_limits:
        add_outcome(verdict, "failure", "; ".join((analysis.verdict.sentence, *lacks)), word)
    else:
        add_outcome(verdict, "system-out", f"{word}: {analysis.verdict.sentence}")
    for limit in () if judgement is None else judged(judgement.to_json()):
        add_judged(suite, f"{unit}.limits", limit)
    return suite


def _segment(case: Element, segment: ExecutedSegment, failed: bool) -> None:
    text = ", ".join(filter(None, (segment.outcome, segment.reason, "" if segment.settled else "not settled")))
    add_outcome(case, "failure" if failed else "system-out", text, segment.outcome if failed else "")
