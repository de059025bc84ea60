"""`/starts`: runs and calibrations that the page starts, each in a separate process, or waiting for its equipment."""

from __future__ import annotations

from pathlib import Path as File
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Request
from fastapi import Path as Part
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from bench.commands import seated, station_file, station_of
from bench.web.ground.settings import Here
from bench.web.live.finding import folder_of, ids
from bench.web.live.live import Acting, watcher_of
from bench.web.live.picture import UnitVerdict
from bench.web.live.starts import InUse, Order, Starts
from bench.web.live.story import serial_of
from bench.web.live.subject import job_of
from bench.web.people.access import Operator, named_by
from bench.web.plans import catalog
from bench.web.plans.catalog import Catalog, named
from bench.web.plans.checking import Intended

router = APIRouter(tags=["starting"])


class Wanted(Intended):
    """A run to start."""

    operator: str = Field(default="", max_length=80)
    """Who works at the bench, where nobody has to sign in."""
    queue: bool = False
    """Wait until the station is free."""
    not_before: AwareDatetime | None = None
    """Begin then, or as soon after it as the station is free."""


class Start(BaseModel):
    """A start: the request and its outcome."""

    model_config = ConfigDict(extra="ignore")

    start: str
    state: Literal["waiting", "starting", "running", "ended", "refused"]
    digest: str = ""
    """Of a calibration; empty for a run."""
    plan: str
    station: str
    units: list[str]
    """Requested units; empty: all of the station."""
    models: list[str] = []
    limits: str | None = None
    who: dict[str, str]
    started: str
    not_before: str | None = None
    """Time before which it does not begin."""
    runs: list[str]
    exit_code: int | None
    """Exit code of `bench run`: 0 good, 1 outside limits, 2 refused, 3 aborted, 4 equipment failed; None: none yet."""
    verdict: str | None
    sentence: str
    message: str
    """What went wrong, in one line."""
    verdicts: list[UnitVerdict] = []


class Starting(BaseModel):
    """The starts that are kept, newest first."""

    starts: list[Start]


def starts_of(request: Request) -> Starts:
    """Those of this server."""
    starts: Starts = request.app.state.starts
    return starts


@router.post("/starts", status_code=202)
def begin(wanted: Wanted, request: Request, here: Here, who: Operator) -> Start:
    """Start a run; 409 where another one uses the station. A run that the bench refuses has the state `refused`."""
    known = Catalog(here.project, here.own)
    profile = named(known.plans(), wanted.plan, "plan")
    station = named(known.stations(), wanted.station, "station")
    place, serials = seated(station_file(station), wanted.units)
    settings = station_of(place)
    units = settings.chosen(serials)
    who = named_by(who, wanted.operator, request)
    order = Order(
        plan=wanted.plan,
        station=wanted.station,
        profile_file=profile,
        behind=settings.files(),
        station_file=station,
        equipment=catalog.equipment(settings, (unit.serial for unit in units)),
        units=wanted.units,
        models={model: known.model(model) for model in wanted.models},
        limits=named(known.limits(), wanted.limits, "limits") if wanted.limits else None,
        who={"name": who.name, "role": who.role, "address": who.address},
        queue=wanted.queue,
        not_before=wanted.not_before,
    )
    return begun(order, request)


@router.post("/runs/{unit}/{run}/resume", status_code=202)
def resume(
    unit: Annotated[str, Part(min_length=1, max_length=200)],
    run: Annotated[str, Part(min_length=1, max_length=200)],
    asked: Acting,
    request: Request,
    here: Here,
    who: Operator,
) -> Start:
    """Go on with a run whose bench was killed, as `bench resume` does; 409 for a live one, or one of a calibration."""
    id_, watched = f"{unit}/{run}", watcher_of(request).find(f"{unit}/{run}")
    folder = folder_of(here.out, unit, run)
    if folder is None:
        raise HTTPException(404, f"no run {id_}; GET /api/v1/runs lists them")
    if watched is not None and watched.condition != "gone":
        raise HTTPException(409, f"{id_} is live: there is nothing to go on with")
    if job := job_of(folder):
        raise HTTPException(409, f"{id_} was made for the calibration {job}: go on with that")
    folders = [folder] if watched is None else list(watched.live.folders)
    known = starts_of(request).of_run(ids(folders)[0])
    settings, units = catalog.station(folder / "station.yaml"), [serial_of(one) for one in folders]
    person = named_by(who, asked.operator, request, known and known["who"])
    order = Order(
        plan=known["plan"] if known else catalog.plan(folder / "profile.yaml")["name"],
        station=known["station"] if known else settings.name,
        station_file=folder / "station.yaml",
        equipment=catalog.equipment(settings, units),
        units=known["units"] if known else units,
        models=dict.fromkeys(known["models"] if known else (), ""),
        limits=File(known["limits"]) if known and known["limits"] else None,
        resumes=folders[0],
        who={"name": person.name, "role": person.role, "address": person.address},
    )
    return begun(order, request)


def begun(order: Order, request: Request) -> Start:
    """Start it; HTTPException 409 where another run uses its equipment."""
    try:
        return Start(**starts_of(request).begin(order, watcher_of(request).in_use()))
    except InUse as error:
        raise HTTPException(409, str(error)) from None


@router.get("/starts")
def starts(request: Request) -> Starting:
    """All starts that are kept."""
    return Starting(starts=[Start(**told) for told in starts_of(request).listed()])


@router.get("/starts/{start}")
def start(start: Annotated[str, Part(min_length=1, max_length=100)], request: Request) -> Start:
    """A start with its outcome."""
    told: dict[str, Any] | None = starts_of(request).find(start)
    if not told:
        raise HTTPException(404, f"no start {start!r}, or not any more; GET /api/v1/starts lists them")
    return Start(**told)


class Move(BaseModel):
    """Where a start goes in the queue: -1 before the one in front of it, 1 behind the one after it."""

    by: int = Field(ge=-1000, le=1000)


@router.post("/starts/{start}/move", status_code=204)
def move(
    start: Annotated[str, Part(min_length=1, max_length=100)], moved: Move, request: Request, who: Operator
) -> None:
    """Change the order of what waits; 409 for a start that does not wait."""
    if not starts_of(request).move(start, moved.by):
        raise HTTPException(409, f"start {start[:100]!r} does not wait, or not any more; GET /api/v1/starts lists them")


@router.delete("/starts/{start}", status_code=204)
def give_up(start: Annotated[str, Part(min_length=1, max_length=100)], request: Request, who: Operator) -> None:
    """Take a start that waits out of the queue; 409 for one that does not wait."""
    starts = starts_of(request)
    if not starts.find(start):
        raise HTTPException(404, f"no start {start!r}, or not any more; GET /api/v1/starts lists them")
    if not starts.give_up(start):
        raise HTTPException(409, f"start {start} does not wait any more; abort its run instead")
