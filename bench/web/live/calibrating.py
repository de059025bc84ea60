"""`/calibrations`: a unit from the shelf to its certificate, by the same jobs as `bench calibrate`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Request
from fastapi import Path as Part
from fastapi.responses import FileResponse
from pydantic import AwareDatetime, BaseModel, Field

from bench.base import InputError
from bench.commands import STEP_NAMES, JobFile, at_work, station_of
from bench.commands import Order as Calibration
from bench.record import JobRecord, StoredCase, StoredStep, slug
from bench.web.ground.problems import within
from bench.web.ground.settings import Here, Settings
from bench.web.jobs.jobs import Asked, submit
from bench.web.live.finding import folder_of, inside
from bench.web.live.live import watcher_of
from bench.web.live.starting import Start, begun, starts_of
from bench.web.live.starts import Order, jobs_of, serial_of
from bench.web.live.story import sound
from bench.web.people.access import Operator, Who, named_by
from bench.web.plans import catalog
from bench.web.plans.catalog import Catalog, named
from bench.web.plans.checking import Name

router = APIRouter(tags=["calibrating"])

Id = Annotated[str, Part(min_length=1, max_length=200)]

GOING = ("waiting", "starting", "running")
STOPPED = ("interrupted", "failed")
_MOST_ELSEWHERE = 40
"""Calibrations of the command line that are listed."""
_Known = Mapping[tuple[str, str], Sequence[dict[str, Any]]]
"""Starts of each calibration, as `Starts.by_job` tells them."""


class Intended(BaseModel):
    """The calibration: plan and station by name, and a unit of the station or a new one in a slot (`NEW@KNOWN`)."""

    plan: Name
    station: Name = "simulated"
    unit: Name
    others: list[Name] = Field(default=[], max_length=63)
    """Further units, each in its slot: what is run is run once for all of them."""


class Wanted(Intended):
    """A calibration to begin, or to go on with where this very plan was begun for this unit."""

    anew: bool = False
    """Begin again although there is one."""
    operator: str = Field(default="", max_length=80)
    """Who works at the bench, where nobody has to sign in."""
    queue: bool = False
    """Wait until the station is free."""
    not_before: AwareDatetime | None = None
    """Begin then, or as soon after it as the station is free."""


class Further(BaseModel):
    """How a calibration goes on; a held one needs a reason."""

    release: str = Field(default="", max_length=500)
    operator: str = Field(default="", max_length=80)
    queue: bool = False


class StepNow(BaseModel):
    """A step; `sentence` is what it found, or why it failed."""

    name: str
    state: Literal["open", "begun", "done", "failed", "void"]
    began: str = ""
    ended: str | None = None
    sentence: str = ""
    verdict: str | None = None
    cases: list[StoredCase] = []
    facts: dict[str, Any] = {}
    """What it found, in numbers."""
    run: str | None = None
    """Id of the run that it made."""


class Release(BaseModel):
    """A person let a held calibration go on: `reason` is theirs, `held` what it waited for."""

    reason: str
    held: str


class Short(BaseModel):
    """A step of another unit; `skipped` where the plan has no such one."""

    state: Literal["begun", "done", "failed", "void", "skipped"]
    verdict: str | None
    warnings: int
    """How many warnings and doubts it was done with."""


class Mate(BaseModel):
    """The calibration of another unit that was started together with this one, in short."""

    unit: str
    job: str
    state: str
    verdict: str | None
    sentence: str
    certificate: bool
    steps: dict[str, Short]
    """Each step that was begun."""


class Job(BaseModel):
    """A calibration as it stands."""

    job: str
    unit: str
    plan: str
    state: Literal["waiting", "running", "interrupted", "held", "failed", "ended"]
    """`interrupted`: its process is gone."""
    verdict: str | None
    sentence: str
    exit_code: int | None
    created: str
    steps: list[StepNow]
    live: str | None
    """Id of its run that is live now."""
    start: Start | None
    """The newest start; null where its record is gone."""
    certificate: str | None
    """Number of its certificate."""
    releases: list[Release]
    together: list[Mate]
    """All that were started together, this one as well; empty for one alone."""


class Calibrations(BaseModel):
    """Calibrations of the page and the newest of the command line, newest first; what waits, first what is next."""

    waiting: list[Start]
    jobs: list[Job]


@router.post("/calibrations", status_code=202)
def calibrate(wanted: Wanted, request: Request, here: Here, who: Operator) -> Start:
    """Begin a calibration, or go on with it; 400 where the plan is wrong, 409 where another run uses the station."""
    order = _order(wanted, here, named_by(who, wanted.operator, request))
    return begun(replace(order, anew=wanted.anew, queue=wanted.queue, not_before=wanted.not_before), request)


@router.post("/calibrations/checks", status_code=202)
def check(intended: Intended, request: Request, here: Here, who: Operator) -> Asked:
    """Request the check that every calibration begins with."""
    files = _files(intended, here)
    folders = {"out": str(here.out), "project": str(here.project)}
    wanted = {
        "plan": str(files[0]),
        "station": str(files[1]),
        "unit": intended.unit,
        "others": intended.others,
        **folders,
    }
    return submit(request, "check", "bench.web.plans.catalog:ordered", wanted)


@router.get("/calibrations")
def calibrations(request: Request, here: Here) -> Calibrations:
    """Calibrations that the page started, and the newest that `bench calibrate` made."""
    pairs = {pair for start in starts_of(request).listed() for pair in jobs_of(start)}
    own = {folder for pair in pairs if (folder := _newest(*pair, here)) is not None}
    jobs = [_told(folder, request) for folder in own | _made_elsewhere(here) if sound(JobRecord, folder) is not None]
    return Calibrations(
        waiting=[Start(**start) for start in starts_of(request).waiting()],
        jobs=sorted(jobs, key=lambda job: (job.created, job.job), reverse=True),
    )


def _made_elsewhere(here: Settings) -> set[Path]:
    """Folders of the newest jobs of the units whose folders changed last: they have to be found among many others."""
    units = sorted(inside(here.out), key=_changed_ns, reverse=True)[:_MOST_ELSEWHERE]
    jobs = [Path(one.path) for unit in units for one in inside(unit.path) if "_calibrate_" in one.name]
    return set(sorted(jobs, key=lambda folder: folder.name, reverse=True)[:_MOST_ELSEWHERE])


def _changed_ns(folder: os.DirEntry[str]) -> int:
    try:
        return folder.stat().st_mtime_ns
    except OSError:  # removed meanwhile
        return 0


@router.get("/starts/{start}/calibration")
def of_start(start: Id, request: Request, here: Here) -> Job | None:
    """The calibration that a start began or went on with; null while it has no folder, 400 where it was refused before
    that.
    """
    known = starts_of(request).find(start)
    if not known or not known["digest"]:
        raise HTTPException(404, f"no start of a calibration {start!r}; GET /api/v1/calibrations lists them")
    folder, going = _job_of(known, here), known["state"] in GOING
    if known["state"] == "refused" and not (folder and _stopped_since(folder, known["started"])):
        raise HTTPException(400, known["message"])
    if folder is None and not going:
        raise HTTPException(400, known["message"] or "the calibration ended before it began: start it again")
    if folder is None or (going and JobRecord.read(folder).state == "ended"):  # that was the one before
        return None
    return _told(folder, request)


@router.get("/calibrations/{unit}/{job}")
def one(unit: Id, job: Id, request: Request, here: Here) -> Job:
    """One calibration."""
    return _told(_folder(unit, job, here), request)


@router.post("/calibrations/{unit}/{job}/continue", status_code=202)
def go_on(unit: Id, job: Id, further: Further, request: Request, here: Here, who: Operator) -> Start:
    """Go on with a calibration that was interrupted, failed or is held; 409 where it cannot go on.

    One that is not held takes with it what began together with it and has stopped, too.
    """
    folder = _folder(unit, job, here)
    now = _told(folder, request)
    if now.state in {"waiting", "running", "ended"}:
        raise HTTPException(409, f"the calibration is {now.state}: there is nothing to go on with")
    if now.start is None:
        raise HTTPException(409, f"who started it is not known any more: `bench calibrate --unit {now.unit}` goes on")
    if (now.state == "held") != bool(further.release.strip()):
        raise HTTPException(400, "release: a held calibration, and no other, needs a reason to go on")
    who = named_by(who, further.operator, request, now.start.who)
    start = _widest(JobRecord.read(folder), starts_of(request).by_job())
    mates = [mate.unit for mate in now.together if mate.state in STOPPED and mate.job != now.job]
    going = [now.unit, *(mates if now.state in STOPPED else [])]
    digests, units = dict(jobs_of(start)), {serial_of(unit): unit for unit in start["units"]}
    first, *others = [units[serial] for serial in going]
    order = _order(Intended(plan=start["plan"], station=start["station"], unit=first, others=others), here, who)
    if order.digests != [digests[serial] for serial in going]:
        raise HTTPException(409, "plan, station or one of their files has changed since: begin a new calibration")
    reason = f"{who.name}: {' '.join(further.release.split())}" if further.release else ""
    return begun(replace(order, release=reason, queue=further.queue), request)


@router.get("/calibrations/{unit}/{job}/certificate", response_class=FileResponse,
            responses={200: {"content": {"application/pdf": {}}}})  # fmt: skip
def certificate(unit: Id, job: Id, here: Here) -> FileResponse:
    """The certificate of a calibration, to be shown and printed."""
    path = _folder(unit, job, here) / "certificate.pdf"
    if not path.is_file() or path.is_symlink():
        raise HTTPException(404, "this calibration has no certificate yet")
    policy = {"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; object-src 'self'"}
    return FileResponse(path, media_type="application/pdf", filename=f"{unit}_certificate.pdf",
                        content_disposition_type="inline", headers=policy)  # fmt: skip


def _files(intended: Intended, here: Settings) -> tuple[Path, Path]:
    known = Catalog(here.project, here.own)
    plan = named(known.calibrations(), intended.plan, "plan of a calibration")
    return plan, named(known.stations(), intended.station, "station")


def _order(intended: Intended, here: Settings, who: Who) -> Order:
    """What the process gets; InputError where a file is wrong, or a unit is not the station's."""
    plan, station = _files(intended, here)
    units = [intended.unit, *intended.others]
    orders = Calibration.load_all(plan, station, units, here.out)
    settings = station_of(orders[0].station_file())
    serials = [order.serial for order in orders]
    settings.chosen(serials)
    return Order(
        plan=intended.plan,
        station=intended.station,
        station_file=station,
        equipment=catalog.equipment(settings, serials),
        plan_file=plan,
        digests=[order.digest() for order in orders],
        behind=(*orders[0].files(), *settings.files()),
        units=units,
        who={"name": who.name, "role": who.role, "address": who.address},
    )


def _folder(unit: str, job: str, here: Settings) -> Path:
    folder = folder_of(here.out, unit, job)
    if folder is None or not (folder / JobRecord.FILE).is_file():
        raise HTTPException(404, f"no calibration {unit}/{job}; GET /api/v1/calibrations lists them")
    return folder


def _stopped_since(folder: Path, started: str) -> bool:
    """Whether a job has stopped after a start: not one that had stopped before it, of which it knows nothing."""
    ended = JobRecord.read(folder).ended
    return ended is not None and datetime.fromisoformat(ended) >= datetime.fromisoformat(started)


def _job_of(start: Mapping[str, Any], here: Settings) -> Path | None:
    """Folder of the newest job of a start's first unit; None while there is none."""
    return _newest(*jobs_of(start)[0], here)


def _newest(serial: str, digest: str, here: Settings) -> Path | None:
    """Folder of the newest job of a unit by this very plan; None while there is none."""
    try:
        found = JobFile.newest(here.out / slug(serial), digest)
    except InputError:  # the job file is damaged: the process says so
        return None
    return None if found is None else found.folder


def _told(folder: Path, request: Request) -> Job:
    record, id_ = JobRecord.read(folder), _id(folder)
    known = starts_of(request).by_job()
    start = next(iter(known.get((record.unit, record.digest), ())), None)
    live = watcher_of(request).of_job(id_)
    facts = record.steps["certificate"].facts if "certificate" in record.steps else {}
    printed, here = (folder / "certificate.pdf").is_file(), request.app.state.settings
    return Job(
        job=id_,
        unit=record.unit,
        plan=record.plan,
        state=_state(folder, record, start),
        verdict=record.verdict,
        sentence=within(here.project, record.sentence, here.out),
        exit_code=record.exit_code,
        created=record.created,
        steps=[_step(name, record, folder, here) for name in STEP_NAMES],
        live=None if live is None else live.runs[0],
        start=Start(**start) if start else None,
        certificate=str(facts["number"]) if printed and facts.get("number") else None,
        releases=[Release(reason=entry.reason, held=entry.held) for entry in record.releases],
        together=_together(record, known, here) if start else [],
    )


def _id(folder: Path) -> str:
    return f"{folder.parent.name}/{folder.name}"


def _together(record: JobRecord, known: _Known, here: Settings) -> list[Mate]:
    """The jobs of a start of several units."""
    pairs = jobs_of(_widest(record, known))
    folders = {pair: _newest(*pair, here) for pair in pairs} if len(pairs) > 1 else {}
    return [
        Mate(
            unit=pair[0],
            job=_id(folder),
            state=_state(folder, record, known[pair][0]),
            verdict=record.verdict,
            sentence=within(here.project, record.sentence, here.out),
            certificate=(folder / "certificate.pdf").is_file(),
            steps={name: _short(name, step) for name, step in record.steps.items()},
        )
        for pair, folder in folders.items()
        if folder is not None
        for record in [JobRecord.read(folder)]
    ]


def _widest(record: JobRecord, known: _Known) -> dict[str, Any]:
    """Of the starts that began a job or went on with it the one with the most units: some may go on alone."""
    starts = known[record.unit, record.digest]
    later = [start for start in starts if start["started"][:19] > record.created[:19]]
    return max(starts[: len(later) + 1], key=lambda start: len(start["units"]))


def _state(folder: Path, record: JobRecord, start: dict[str, Any] | None) -> Any:
    # Where several units are at work, some are over before the others; one alone is over when its process has ended.
    several = start is not None and len(jobs_of(start)) > 1
    over = several and record.state != "running" and start is not None and (record.ended or "") >= start["started"]
    if at_work(folder) and not over:
        return "running"
    if start and start["state"] in GOING and not over:
        return "waiting" if start["state"] == "waiting" else "running"
    return "interrupted" if record.state == "running" else record.state


def _short(name: str, step: StoredStep) -> Short:
    skipped = any(case.skipped and case.name == name for case in step.cases)
    warnings = sum(len(step.facts.get(kind) or ()) for kind in ("warnings", "doubts"))
    return Short.model_validate(
        {"state": "skipped" if skipped else step.state, "verdict": step.verdict, "warnings": warnings}
    )


def _step(name: str, record: JobRecord, folder: Path, here: Settings) -> StepNow:
    known = record.steps.get(name)
    if known is None:
        return StepNow(name=name, state="open")
    run = known.facts.get("run")
    return StepNow(
        name=name,
        state=known.state,
        began=known.began,
        ended=known.ended,
        sentence=within(here.project, known.sentence, here.out),
        verdict=known.verdict,
        cases=list(known.cases),
        facts=known.facts,
        run=f"{folder.parent.name}/{run}" if run else None,
    )
