"""A run of a job: found again by the file that it keeps in its folder, gone on with, or made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from bench import acquisition
from bench.base import BenchError, InputError, LeftRunError, NotResumableError, dump, read_yaml
from bench.commands.acquisition import Task, conduct
from bench.commands.analysis import recover
from bench.commands.calibration.job import JOB_MARK, JobFile
from bench.commands.calibration.order import Order
from bench.commands.resuming import continued
from bench.record import MANIFEST, RunFolder, slug


class AgainError(Exception):
    """A step that was begun or done must be done again: `name`, and why."""

    def __init__(self, name: str, why: str) -> None:
        super().__init__(why)
        self.name = name


def recorded(
    order: Order, job: JobFile, step: str, profile: str, compensation: acquisition.Compensated, texts: Mapping[str, str]
) -> RunFolder:
    """The whole run of a step.

    One that was cut off goes on, or is repeated where the plan says so or nothing can be gone on with. Raises the error
    that ended the run: it is the next to be taken up. The run is made for all units that are at work on it together:
    the others find it, or the error that ended it; one that left the run leaves it alone.
    """
    together = order.together
    if order.serial in together.errors:
        raise together.errors[order.serial]
    try:
        while (found := find(order, _mark(job, step))) is not None:
            if (run := _taken_up(order, found, step)) is not None:
                return run
            job.renew(step)
        mark = _mark(job, step)
        units = together.serials or (order.serial,)
        task = Task(units, {**texts, JOB_MARK: mark}, order.out, compensation, order.operator)
        _whole(order, conduct(order.document(profile), order.station_file(), task, order.quiet))
    except BenchError as error:
        together.errors = together.errors or dict.fromkeys(together.serials, error)
        raise
    if (made := find(order, mark)) is None:
        raise InputError("the run has left no folder: see the output of the bench", order.out / slug(order.serial))
    return RunFolder(made)


def _mark(job: JobFile, step: str) -> str:
    return dump({"job": job.folder.name, "step": step, "epoch": job.epoch(step)})


def find(order: Order, mark: str) -> Path | None:
    """The run folder that holds this mark."""
    unit = order.out / slug(order.serial)
    found = [path.parent for path in unit.glob(f"*/{JOB_MARK}") if path.read_text(encoding="utf-8") == mark]
    return max(found, key=lambda folder: folder.name, default=None)


def _taken_up(order: Order, folder: Path, step: str) -> RunFolder | None:
    """A run that was begun, brought to its end; None where it has to be repeated.

    AgainError: the others' run went on without this unit, which needs one of its own.
    """
    if (folder / MANIFEST).is_file() and RunFolder(folder).manifest().state == "done":
        return RunFolder(folder)
    if order.plan.interrupted == "repeat" or not any(RunFolder(folder).journal.glob("*.gtbj")):
        return None
    try:
        run = recover(folder)
        if run.manifest().state == "done":
            return run
        # The station as the run had it, with all units in their slots; what it names beside itself is beside the file.
        own = read_yaml(folder / "station.yaml")
        return _whole(order, continued(run, replace(own, file=order.station_file().file), order.quiet))
    except LeftRunError as error:
        raise AgainError(step, str(error)) from error
    except NotResumableError:  # killed before anything was recorded, or after the last segment
        return None


def _whole(order: Order, result: acquisition.RunResult) -> RunFolder:
    """The run of the unit that is ordered; raises what ended it. What ended it for others is kept for them."""
    order.together.errors = {unit.serial: unit.error for unit in result.units if unit.error is not None}
    (own,) = (unit for unit in result.units if unit.serial == order.serial)
    if own.error is not None:
        raise own.error
    return own.run
