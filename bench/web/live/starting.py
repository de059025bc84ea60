"""`/starts`: runs that the page starts, each in a separate process."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Request
from fastapi import Path as Part
from pydantic import BaseModel, ConfigDict, Field

from bench.web.ground.settings import Here
from bench.web.live.live import watcher_of
from bench.web.live.picture import UnitVerdict
from bench.web.live.starts import InUse, Order, Starts
from bench.web.live.subject import in_use
from bench.web.people.access import Operator
from bench.web.plans import catalog
from bench.web.plans.catalog import Catalog, named
from bench.web.plans.checking import Intended, Name

router = APIRouter(tags=["starting"])


class Wanted(Intended):
    """A run to start; models and limits by name, in place of the defaults."""

    models: list[Name] = Field(default=[], max_length=8)
    limits: Name | None = None


class Start(BaseModel):
    """A start: the request and its outcome."""

    model_config = ConfigDict(extra="ignore")

    start: str
    state: Literal["starting", "running", "ended", "refused"]
    plan: str
    station: str
    units: list[str]
    """Requested units; empty: all of the station."""
    models: list[str] = []
    limits: str | None = None
    who: dict[str, str]
    started: str
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


def _starts(request: Request) -> Starts:
    starts: Starts = request.app.state.starts
    return starts


@router.post("/starts", status_code=202)
def begin(wanted: Wanted, request: Request, here: Here, who: Operator) -> Start:
    """Start a run; 409 where another one uses the station. A run that the bench refuses has the state `refused`."""
    known = Catalog(here.project, here.own)
    profile = named(known.plans(), wanted.plan, "plan")
    station = named(known.stations(), wanted.station, "station")
    settings = catalog.station(station)
    settings.chosen(wanted.units)
    order = Order(
        plan=wanted.plan,
        station=wanted.station,
        profile_file=profile,
        station_file=station,
        equipment=catalog.equipment(settings),
        units=wanted.units,
        models=[known.model(model) for model in wanted.models],
        limits=named(known.limits(), wanted.limits, "limits") if wanted.limits else None,
        who={"name": who.name, "role": who.role, "address": who.address},
        operator=str(who),
    )
    used: dict[str, str] = {}
    for watched in watcher_of(request).runs:
        if watched.condition != "gone":
            used |= in_use(watched.live)
    try:
        return Start(**_starts(request).begin(order, used))
    except InUse as error:
        raise HTTPException(409, str(error)) from None


@router.get("/starts")
def starts(request: Request) -> Starting:
    """All starts that are kept."""
    return Starting(starts=[Start(**told) for told in _starts(request).listed()])


@router.get("/starts/{start}")
def start(start: Annotated[str, Part(min_length=1, max_length=100)], request: Request) -> Start:
    """A start with its outcome."""
    told: dict[str, Any] | None = _starts(request).find(start)
    if not told:
        raise HTTPException(404, f"no start {start!r}, or not any more; GET /api/v1/starts lists them")
    return Start(**told)
