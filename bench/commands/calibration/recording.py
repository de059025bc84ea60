"""A run of a job: found again by the file that it keeps in its folder, gone on with, or made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from bench.base import InputError, dump
from bench.commands.acquisition import Task, conduct
from bench.commands.analysis import recover
from bench.commands.calibration.job import JOB_MARK, JobFile
from bench.commands.calibration.order import Order
from bench.commands.resuming import continued
from bench.record import MANIFEST, RunFolder, slug

if TYPE_CHECKING:
    from bench.acquisition import Compensated, RunResult

_NOTHING_LEFT = "nothing to resume"


def recorded(
    order: Order, job: JobFile, step: str, profile: str, compensation: Compensated, texts: Mapping[str, str]
) -> tuple[RunFolder, bool]:
    """The whole run of a step, and whether it has several parts.

    One that was cut off goes on, or is repeated where the plan says so or nothing can be gone on with. Raises the error
    that ended the run: it is the next to be taken up.
    """
    found = find(order, _mark(job, step))
    if found is not None and (run := _taken_up(order, found)) is not None:
        return run, len(run.parts()) > 1
    if found is not None:
        job.renew(step)
    task = Task([order.serial], {**texts, JOB_MARK: _mark(job, step)}, order.out, compensation, order.operator)
    return _whole(conduct(order.document(profile), order.station_file(), task, order.quiet)), False


def _mark(job: JobFile, step: str) -> str:
    return dump({"job": job.folder.name, "step": step, "epoch": job.epoch(step)})


def find(order: Order, mark: str) -> Path | None:
    """The run folder that holds this mark."""
    unit = order.out / slug(order.serial)
    found = [path.parent for path in unit.glob(f"*/{JOB_MARK}") if path.read_text(encoding="utf-8") == mark]
    return max(found, key=lambda folder: folder.name, default=None)


def _taken_up(order: Order, folder: Path) -> RunFolder | None:
    """A run that was begun, brought to its end; None where it has to be repeated."""
    if (folder / MANIFEST).is_file() and RunFolder(folder).manifest().state == "done":
        return RunFolder(folder)
    if order.plan.interrupted == "repeat" or not any(RunFolder(folder).journal.glob("*.gtbj")):
        return None
    try:
        run = recover(folder)
        if run.manifest().state == "done":
            return run
        return _whole(continued(run, None if order.station is None else order.station_file(), order.quiet))
    except InputError as error:
        # Killed before anything was recorded, or after the last segment: there is nothing to go on with.
        if _NOTHING_LEFT in str(error) or "no readable journal" in str(error) or "start the run anew" in str(error):
            return None
        raise


def _whole(result: RunResult) -> RunFolder:
    if result.error is not None:
        raise result.error
    return result.run
