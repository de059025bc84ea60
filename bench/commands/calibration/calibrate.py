"""`bench calibrate`: the steps of a plan one after the other, from wherever the job file says that they stand."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

from bench.acquisition import Mood, Notifier
from bench.base import BenchError, InputError
from bench.commands.acquisition import station_of
from bench.commands.calibration.imu_steps import CertifyImu, DiagnoseImu, FitImu, VerifyImu
from bench.commands.calibration.job import ENDED, HELD, JobFile
from bench.commands.calibration.order import Order
from bench.commands.calibration.steps import STEPS, AgainError, Step
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
    unit = order.out / slug(order.serial)
    job = None if anew else JobFile.newest(unit, order.digest())
    if job is None and release is not None:
        raise InputError("no job of this unit by this plan is held: nothing to release", unit)
    if job is None:
        job = JobFile.create(unit, order.serial, order.plan.name, order.digest())
    notifier = Notifier(station_of(order.station_file()).notify)
    with job.locked():
        if release is not None:
            job.release(release)
        if job.state not in {ENDED, HELD}:
            _go_on(order, job, steps_of(order) if steps is None else steps, boundary)
            _tell(order, job, notifier)
    return job


def _tell(order: Order, job: JobFile, notifier: Notifier) -> None:
    """Tell people who are not beside the bench how the calibration ended, or that it waits for one of them."""
    word = job.content["verdict"] or job.state
    mood: Mood = "success" if word == "PASS" else "warning" if word in {"MARGINAL", "HOLD"} else "failure"
    text = f"{job.content['sentence']}\njob {job.folder.parent.name}/{job.folder.name}"
    notifier.tell("calibration", f"{order.serial} {order.plan.name}: calibration {word}", text, mood)
    notifier.close()
    for trouble in notifier.troubles():
        print(f"bench: {trouble}", file=sys.stderr)


def steps_of(order: Order) -> Sequence[Step]:
    """The steps of the plan's kind of unit; their names are the same."""
    own: dict[str, Step] = {step.name: step for step in (FitImu(), DiagnoseImu(), VerifyImu(), CertifyImu())}
    return [own.get(step.name, step) for step in STEPS] if order.plan.imu else STEPS


def _go_on(order: Order, job: JobFile, steps: Sequence[Step], boundary: Boundary) -> None:
    repeats = 0
    # What a step found was written with it: a kill before the job was closed for it loses nothing.
    while not _stopped(job, steps):
        step = next((step for step in steps if not job.is_done(step.name)), None)
        if step is None:
            _end(job, steps)
            return
        try:
            _do(step, order, job, boundary)
        except AgainError as again:
            repeats += 1
            if repeats > MOST_REPEATS:
                job.fail(step.name, f"{again}, again: see to it, then start the same command once more", 4)
                return
            for later in _from(steps, again.name):
                job.forget(later, f"repeated: {again}")
        except (BenchError, DriverError) as error:
            job.fail(step.name, str(error), error.exit_code)
            return


def _do(step: Step, order: Order, job: JobFile, boundary: Boundary) -> None:
    begun = time.monotonic()
    job.begin(step.name)
    boundary(step.name, "begun")
    done = step.do(order, job)
    job.finish(step.name, done)
    if not order.quiet:
        print(f"{step.name:<12} {time.monotonic() - begun:7.1f} s  {done.sentence}", file=sys.stderr, flush=True)
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
