"""What commands do with an ended run, and with a station, from the page: each is a job of a computing process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Request
from fastapi import Path as Part
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from bench.commands import seated, station_file, station_of
from bench.deliver import FORMATS, IMU_FORMATS, MEASURED
from bench.record import RunFolder
from bench.web.ground.settings import Here
from bench.web.jobs.jobs import Asked, submit
from bench.web.jobs.lanes import Lane
from bench.web.live.live import watcher_of
from bench.web.live.starting import Start, begun, starts_of
from bench.web.live.starts import Order
from bench.web.people.access import Engineer, Operator, Who, named_by
from bench.web.plans import catalog
from bench.web.plans.catalog import Catalog, named
from bench.web.plans.checking import Name
from bench.web.shelf.indexing import index_of, resolved
from bench.web.shelf.steps import whole_of

router = APIRouter(tags=["acting"])
Id = Annotated[str, Part(min_length=1, max_length=200)]
_ACTING = "bench.web.shelf.acting:"


class Exports(BaseModel):
    """Formats in which a run can be exported, and the files that were."""

    formats: list[str]
    files: list[str]


class Analysis(BaseModel):
    """Models and limits by name, as the run was started with; those that the run keeps, and none, without them."""

    models: list[Name] = Field(default=[], max_length=8)
    limits: Name | None = None


class Export(BaseModel):
    """One format of `bench export`."""

    format: str = Field(min_length=1, max_length=20)


class Certificate(BaseModel):
    """A draft is printed although something is missing, which stands across each page."""

    draft: bool = False


class Writing(BaseModel):
    """Where the unit is."""

    station: Name
    slot: Annotated[str, Field(max_length=200)] = ""
    """`UNIT@KNOWN` where the station file does not name the unit."""
    operator: str = Field(default="", max_length=80)
    """Who works at the bench, where nobody has to sign in."""


class Verification(Writing):
    """Another profile than that of the calibration, and what judges it."""

    plan: Name
    limits: Name | None = None


@router.get("/runs/{unit}/{run}/exports")
def exports(request: Request, unit: Id, run: Id) -> Exports:
    """Formats of a run, or of the whole inertial unit that was calibrated by it, and the files that were exported."""
    folder = index_of(request).folder(unit, run)
    formats = FORMATS if whole_of(folder) == folder else IMU_FORMATS
    return Exports(formats=list(dict.fromkeys([*formats, *MEASURED])), files=sorted(_exported(folder)))


def _exported(folder: Path) -> dict[str, Path]:
    """Files of the `export` folders of a run and of its whole unit, by name."""
    made = [path / "export" for path in dict.fromkeys((folder, whole_of(folder)))]
    files = [path for place in made if place.is_dir() for path in place.iterdir()]
    return {path.name: path for path in files if path.is_file() and not path.is_symlink()}


@router.post("/runs/{unit}/{run}/exports", status_code=202)
def export(request: Request, unit: Id, run: Id, wanted: Export, who: Engineer) -> Asked:
    """Request `bench export`; its result names the files, which `GET …/exports/{name}` sends."""
    return _act(request, unit, run, "exported", format=wanted.format)


@router.get("/runs/{unit}/{run}/exports/{name}", response_class=FileResponse,
            responses={200: {"content": {"application/octet-stream": {}}}})  # fmt: skip
def exported(request: Request, unit: Id, run: Id, name: Id) -> FileResponse:
    """A file that was exported."""
    found = _exported(index_of(request).folder(unit, run)).get(name)
    if found is None:
        raise HTTPException(404, f"run {unit}/{run} has no exported file '{name}': export it first")
    return FileResponse(found, media_type="application/octet-stream", filename=f"{unit}-{name}")


@router.post("/runs/{unit}/{run}/report", status_code=202)
def analyse(request: Request, here: Here, unit: Id, run: Id, wanted: Analysis, who: Operator) -> Asked:
    """Request `bench report` of a run that was not analysed; 409 where it has a report already."""
    known = Catalog(here.project, here.own)
    if RunFolder(index_of(request).folder(unit, run)).report.is_file():
        raise HTTPException(409, f"run {unit}/{run} has a report")
    limits = str(named(known.limits(), wanted.limits, "limits")) if wanted.limits else None
    models = [known.model(model) for model in wanted.models]
    return _act(request, unit, run, "analysed", lane="slow", models=models, limits=limits)


@router.post("/runs/{unit}/{run}/replay", status_code=202)
def replay(request: Request, unit: Id, run: Id, who: Engineer) -> Asked:
    """Request `bench replay`: the numbers of the run made again from its raw frames, and what differs."""
    return _act(request, unit, run, "replayed", lane="slow")


@router.post("/runs/{unit}/{run}/certificate", status_code=202)
def certify(request: Request, here: Here, unit: Id, run: Id, wanted: Certificate, who: Engineer) -> Asked:
    """Request `bench certificate`; `GET …/certificate` sends it."""
    return _act(request, unit, run, "certified", draft=wanted.draft, profiles=str(here.project / "profiles"))


@router.post("/runs/{unit}/{run}/flash", status_code=202)
def flash(request: Request, here: Here, unit: Id, run: Id, wanted: Writing, who: Operator) -> Start:
    """Write the calibration of a run into its unit, as `bench flash` does; `GET /starts/…` tells its outcome."""
    (entry,) = resolved(request, [f"{unit}/{run}"])
    return begun(replace(_order(wanted, unit, "flash", request, here, who), flashes=Path(entry["path"])), request)


@router.post("/units/{unit}/verification", status_code=202)
def verify(request: Request, here: Here, unit: Id, wanted: Verification, who: Operator) -> Start:
    """Run another profile with the unit's own correction on, and judge what it leaves, as `bench verify` does."""
    known = Catalog(here.project, here.own)
    order = replace(
        _order(wanted, unit, wanted.plan, request, here, who),
        profile_file=named(known.plans(), wanted.plan, "plan"),
        limits=named(known.limits(), wanted.limits, "limits") if wanted.limits else None,
        verifies=True,
    )
    return begun(order, request)


@router.post("/stations/{station}/doctor", status_code=202)
def doctor(request: Request, here: Here, station: Id, who: Operator) -> Asked:
    """Request `bench doctor`, which writes nothing; 409 where a run uses the station."""
    file = named(Catalog(here.project, here.own).stations(), station, "station")
    in_use = {**watcher_of(request).in_use(), **starts_of(request).in_use()}
    if taken := sorted(catalog.equipment(catalog.station(file)) & in_use.keys()):
        raise HTTPException(409, f"{taken[0]} is in use: {in_use[taken[0]]}; wait for its end")
    return submit(request, "doctor", f"{_ACTING}examined", {"station": str(file)})


@router.post("/stations/{station}/notices", status_code=202)
def notices(request: Request, here: Here, station: Id, who: Engineer) -> Asked:
    """Request `bench doctor --notify`: a trial to all whom the station tells of its runs, by their names."""
    file = named(Catalog(here.project, here.own).stations(), station, "station")
    return submit(request, "notices", f"{_ACTING}noticed", {"station": str(file)})


def _order(wanted: Writing, unit: str, plan: str, request: Request, here: Here, who: Who) -> Order:
    station = named(Catalog(here.project, here.own).stations(), wanted.station, "station")
    place, serials = seated(station_file(station), [wanted.slot or unit])
    settings = station_of(place)
    settings.chosen(serials)
    if serials != [unit]:
        raise HTTPException(400, f"slot is {wanted.slot!r}, must be a slot of the station with this unit, {unit}@SLOT")
    person = named_by(who, wanted.operator, request)
    return Order(
        plan=plan,
        station=wanted.station,
        station_file=station,
        behind=settings.files(),
        equipment=catalog.equipment(settings, serials),
        units=[wanted.slot or unit],
        who={"name": person.name, "role": person.role, "address": person.address},
    )


def _act(request: Request, unit: str, run: str, act: str, lane: Lane = "quick", **more: Any) -> Asked:
    (entry,) = resolved(request, [f"{unit}/{run}"])
    return submit(request, act, f"{_ACTING}{act}", {**entry, **more}, lane=lane)
