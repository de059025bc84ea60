"""`/checks`: a rehearsal of a run, computed while the page waits, without equipment."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, Field

from bench.commands import seated, station_file, station_of
from bench.web.ground.settings import Here
from bench.web.jobs.jobs import Asked, submit
from bench.web.people.access import Operator
from bench.web.plans.catalog import Catalog, named

router = APIRouter(tags=["starting"])

FILE_NAME = r"^[\p{L}\p{N}][\p{L}\p{N}._+-]*$"
"""What a file of a person may be called, without its ending, in any script."""
Name = Annotated[str, Field(min_length=1, max_length=100)]


class Intended(BaseModel):
    """The run: names from `/plans` and `/stations`; without units it takes all of the station."""

    plan: Name
    station: Name = "simulated"
    units: Annotated[list[Name], Field(max_length=64)] = []
    limits: Name | None = None
    """Limits that it is judged by."""
    models: list[Name] = Field(default=[], max_length=8)
    """Models by name, in place of the defaults."""


@router.post("/checks", status_code=202)
def check(intended: Intended, request: Request, here: Here, who: Operator) -> Asked:
    """Request the content of `bench check`, with `ok` and the nominal `curve`."""
    known = Catalog(here.project, here.own)
    plan = named(known.plans(), intended.plan, "plan")
    station = named(known.stations(), intended.station, "station")
    place, serials = seated(station_file(station), intended.units)
    station_of(place).chosen(serials)
    limits = named(known.limits(), intended.limits, "limits") if intended.limits else None
    files = {"plan": str(plan), "station": str(station), "limits": limits and str(limits), "project": str(here.project)}
    wanted = {**files, "units": intended.units, "models": {name: known.model(name) for name in intended.models}}
    return submit(request, "check", "bench.web.plans.catalog:rehearsed", wanted)
