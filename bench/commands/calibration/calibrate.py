"""`bench calibrate`: the steps of a plan one after the other, from wherever the job file says that they stand."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from bench.acquisition import Mood, Notifier
from bench.base import BenchError, InputError
from bench.commands.acquisition import station_of
from bench.commands.calibration.imu_steps import CertifyImu, DiagnoseImu, FitImu, VerifyImu
from bench.commands.calibration.job import ENDED, HELD, JobFile
from bench.commands.calibration.order import Order, Together
from bench.commands.calibration.recording import AgainError
from bench.commands.calibration.steps import STEPS, Step
from bench.record import slug
from drivers.errors import DriverError

MOST_REPEATS = 1
"""How often a step that was done may turn out to have to be repeated in one go."""

Boundary = Callable[[str, str], None]
"""Called with the name of a step and `begun` or `done`, when the job file says so."""


def calibrate(
    order: Order,
    *,
    release: str | None = None,
    anew: bool = False,
    steps: Sequence[Step] | None = None,
    boundary: Boundary = lambda step, state: None,
) -> JobFile:
    """Begin a job, or go on with the one that this very plan began for this unit; the job as it stands then.

    A job that ended is answered, not done again, unless `anew`; one that is held goes on with a `release` reason.
    InputError: the plan is wrong, the job is not held, or another bench is at work on it.
    """
    return calibrate_all([order], release=release, anew=anew, steps=steps, boundary=boundary)[0]


def calibrate_all(
    orders: Sequence[Order],
    *,
    release: str | None = None,
    anew: bool = False,
    steps: Sequence[Step] | None = None,
    boundary: Boundary = lambda step, state: None,
) -> list[JobFile]:
    """The same for several units of one station by one plan: what is run is run once, for all that stand there."""
    notifier = Notifier(station_of(orders[0].station_file()).notify)
    jobs = _jobs(orders, release, anew)
    with ExitStack() as stack:
        for job in jobs:
            stack.enter_context(job.locked())
        if release is not None:
            jobs[0].release(release)
        pairs = zip(orders, jobs, strict=True)
        going = [_Going(order, job) for order, job in pairs if job.state not in {ENDED, HELD}]
        _go_on(going, steps_of(orders[0]) if steps is None else steps, boundary)
        for one in going:
            _tell(one.order, one.job, notifier)
    notifier.close()
    for trouble in notifier.troubles():
        print(f"bench: {trouble}", file=sys.stderr)
    return jobs


def _jobs(orders: Sequence[Order], release: str | None, anew: bool) -> list[JobFile]:
    if release is not None and len(orders) > 1:
        raise InputError("a held job is released alone: name its unit only")
    created = datetime.now(UTC)
    jobs = []
    for order in orders:
        unit = order.out / slug(order.serial)
        job = None if anew else JobFile.newest(unit, order.digest())
        if job is None and release is not None:
            raise InputError("no job of this unit by this plan is held: nothing to release", unit)
        if job is None:
            job = JobFile.create(unit, order.serial, order.plan.name, order.digest(), created)
        jobs.append(job)
    return jobs


def _tell(order: Order, job: JobFile, notifier: Notifier) -> None:
    """Tell people who are not beside the bench how the calibration ended, or that it waits for one of them."""
    word = job.content["verdict"] or job.state
    mood: Mood = "success" if word == "PASS" else "warning" if word in {"MARGINAL", "HOLD"} else "failure"
    text = f"{job.content['sentence']}\njob {job.folder.parent.name}/{job.folder.name}"
    notifier.tell("calibration", f"{order.serial} {order.plan.name}: calibration {word}", text, mood)


def steps_of(order: Order) -> Sequence[Step]:
    """The steps of the plan's kind of unit; their names are the same."""
    own: dict[str, Step] = {step.name: step for step in (FitImu(), DiagnoseImu(), VerifyImu(), CertifyImu())}
    return [own.get(step.name, step) for step in STEPS] if order.plan.imu else STEPS


@dataclass
class _Going:
    """A job at work; `over` when it has ended, failed or is held."""

    order: Order
    job: JobFile
    repeats: int = 0
    over: bool = False


def _go_on(going: Sequence[_Going], steps: Sequence[Step], boundary: Boundary) -> None:
    """Do the earliest step that is left, for all jobs that stand there, until every job is over."""
    # What a step found was written with it: a kill before the job was closed for it loses nothing.
    while left := [one for one in going if not _over(one, steps)]:
        at = [next(i for i, step in enumerate(steps) if not one.job.is_done(step.name)) for one in left]
        step = steps[min(at)]
        there = [one for one, index in zip(left, at, strict=True) if index == min(at)]
        # Units of one run find it by the name of their job: those that began together have the same.
        name = there[0].job.folder.name, there[0].job.epoch(step.name)
        there = [one for one in there if (one.job.folder.name, one.job.epoch(step.name)) == name]
        together = Together(tuple(one.order.serial for one in there))
        for one in there:
            _attempt(one, replace(one.order, together=together), step, steps, boundary)


def _over(one: _Going, steps: Sequence[Step]) -> bool:
    if one.over:
        return True
    one.over = _stopped(one.job, steps)
    if not one.over and all(one.job.is_done(step.name) for step in steps):
        _end(one.job, steps)
        one.over = True
    return one.over


def _attempt(one: _Going, order: Order, step: Step, steps: Sequence[Step], boundary: Boundary) -> None:
    try:
        _do(step, order, one.job, boundary)
    except AgainError as again:
        one.repeats += 1
        if one.repeats > MOST_REPEATS:
            one.job.fail(step.name, f"{again}, again: see to it, then start the same command once more", 4)
            one.over = True
            return
        for later in _from(steps, again.name):
            one.job.forget(later, f"repeated: {again}")
    except (BenchError, DriverError) as error:
        one.job.fail(step.name, str(error), error.exit_code)
        one.over = True


def _do(step: Step, order: Order, job: JobFile, boundary: Boundary) -> None:
    begun = time.monotonic()
    job.begin(step.name)
    boundary(step.name, "begun")
    done = step.do(order, job)
    job.finish(step.name, done)
    if not order.quiet:
        unit = f"{order.serial} " if len(order.together.serials) > 1 else ""
        text = f"{unit}{step.name:<12} {time.monotonic() - begun:7.1f} s  {done.sentence}"
        print(text, file=sys.stderr, flush=True)
    boundary(step.name, "done")


def _stopped(job: JobFile, steps: Sequence[Step]) -> bool:
    """Whether what a step found ends or holds the job."""
    for known in (job.step(step.name) | {"name": step.name} for step in steps if job.is_done(step.name)):
        if why := known["stop"]:
            word = known["verdict"] if known["verdict"] in {"FAIL", "INVALID"} else "FAIL"
            job.end(word, f"{known['name']}: {why}", 1)
            return True
        if why := known["hold"]:
            job.hold(f"{known['name']}: {why}")
            return True
    return False


def _from(steps: Sequence[Step], name: str) -> list[str]:
    names = [step.name for step in steps]
    return names[names.index(name) :]


def _end(job: JobFile, steps: Sequence[Step]) -> None:
    words = [word for step in steps if (word := job.step(step.name).get("verdict"))]
    word = "MARGINAL" if "MARGINAL" in words else "PASS"
    released = "; ".join(entry["reason"] for entry in job.content["releases"])
    job.end(word, f"calibrated and verified{f' (released: {released})' if released else ''}", 0)
