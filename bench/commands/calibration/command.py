"""`bench calibrate`: the job's answer, for people, programs and CI."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.commands.answer import Answer
from bench.commands.calibration.calibrate import calibrate
from bench.commands.calibration.job import ENDED, FAILED, HELD, JobFile
from bench.commands.calibration.junit import write_junit
from bench.commands.calibration.order import Order
from bench.commands.calibration.steps import NAMES


def calibrate_unit(order: Order, release: str | None, anew: bool, junit: Path | None) -> Answer:
    """Do what is left of the job, write its JUnit XML, and say how it stands; the exit code is the verdict."""
    job = calibrate(order, release=release, anew=anew)
    if junit is not None:
        write_junit(job, NAMES, junit)
    return Answer(_content(job), _text(job), int(job.content["exit_code"]))


def _content(job: JobFile) -> dict[str, Any]:
    known = {key: job.content[key] for key in ("unit", "plan", "state", "verdict", "sentence", "releases")}
    runs = {
        step: str(job.folder.parent / facts["run"]) for step in ("run", "verify") if "run" in (facts := job.facts(step))
    }
    pdf = job.facts("certificate").get("pdf")
    steps = [{"name": name, **job.step(name)} for name in NAMES if job.step(name)]
    return {
        **known,
        "job": str(job.folder),
        "run": runs.get("run"),
        "verification": {**job.facts("verify"), "run": runs["verify"]} if "verify" in runs else None,
        "certificate": None if pdf is None else str(job.folder / pdf),
        "steps": steps,
        **({"error": job.content["sentence"]} if job.state == FAILED else {}),
    }


def _text(job: JobFile) -> str:
    content = job.content
    lines = [
        f"{content['verdict'] or 'NOT DONE'}: unit {content['unit']}, plan {content['plan']}: {content['sentence']}",
        "",
    ]
    for name in NAMES:
        known = job.step(name)
        lines.append(f"{name:<12} {known.get('state', 'not reached'):<12} {known.get('sentence', '')}".rstrip())
    lines.append("")
    if job.state == HELD:
        lines.append('a person decides: the same command with --release "name: reason" goes on, --new begins anew')
    elif job.state == FAILED:
        lines.append("the same command takes it up again at this step")
    elif job.state == ENDED:
        lines.append("this job has ended; the same command with --new calibrates the unit again")
    return "\n".join([*lines, f"job     {job.folder}"])
