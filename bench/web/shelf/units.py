"""`/units`: every unit, the history of one, its trends and its certificates; from registry and run folders."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, HTTPException, Query, Request
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from bench.archive import (
    Order,
    Registry,
    Standing,
    figure,
    known_unit,
    listing,
    printed_certificate,
    thinned,
    trends,
    unit_history,
)
from bench.archive import runs as runs_of
from bench.web.people.access import Engineer
from bench.web.shelf.stock import Stock

router = APIRouter(tags=["units"])

Figure = dict[str, Any]
Serial = Annotated[str, Field(max_length=200)]


class UnitLine(BaseModel):
    """One unit in the list; moments are ISO 8601, null where there is nothing."""

    serial: str
    lot: str | None
    runs: int
    calibrations: int
    last: str | None
    last_run: str | None
    state: str | None
    station: str | None
    calibrated: str | None
    model: str | None
    judged: str | None
    certificate: str | None
    standing: Standing
    unjudged: str | None
    """The newest run where it is newer than the newest judged one and was not judged."""


class Units(BaseModel):
    """A page of the list; `registry` is false where nothing was registered yet."""

    registry: bool
    total: int
    matched: int
    standings: dict[str, int]
    """How many units stand how, of all that match the text."""
    units: list[UnitLine]


class PastRun(BaseModel):
    """One run of a unit; `here` says that its folder is in this archive and can be opened."""

    run: str
    here: bool
    kind: str
    created: str | None
    profile: str | None
    station: str | None
    operator: str | None
    state: str | None
    cause: str | None
    simulated: bool | None
    duration_s: float | None
    lost: int | None
    verdict: str | None
    judged: str | None
    model: str | None


class Paper(BaseModel):
    """A certificate; `pdf` says that it can be opened."""

    number: str | None
    verdict: str | None
    issued: str | None
    operator: str | None
    pdf: bool


class PastCalibration(BaseModel):
    """One calibration, how old it is [d], over what it holds, and whether it still counts."""

    run: str
    created: str | None
    age_days: float | None
    model: str | None
    verdict: str | None
    judged: str | None
    limits: str | None
    validity: dict[str, Any]
    status: str
    usable: bool
    certificate: Paper | None
    coefficients_sha256: str | None


class Write(BaseModel):
    """One attempt to write a calibration into the unit's memory."""

    utc: str
    state: str | None
    error: str | None
    operator: str | None
    protocol: str | None
    model: str | None
    form: str | None
    calibration_id: str | None
    before: str | None
    bank: int | None
    coefficient_set: int | None
    crc: str | None
    words: int | None
    run: str | None


class Point(BaseModel):
    """A value of a quantity and the run that it is of."""

    run: str
    created: str | None
    profile: str | None
    value: float


class Trend(BaseModel):
    """A quantity from run to run; `change` is that since the first run of the same profile."""

    name: str
    unit: str
    lower: float | None
    upper: float | None
    points: list[Point]
    of: int
    """How many points there are."""
    last: float
    change: float | None
    outside: bool


class History(BaseModel):
    """All about one unit, the newest first; `of`: how many runs and calibrations there are."""

    serial: str
    lot: str | None
    of: dict[str, int]
    runs: list[PastRun]
    calibrations: list[PastCalibration]
    counts: PastCalibration | None
    """The calibration that counts: the one in the unit, else the newest usable."""
    memory: Write | None
    writes: list[Write]
    trends: list[Trend]


class TrendFigure(BaseModel):
    """A trend as plotly draws it."""

    name: str
    figure: Figure


class Rebuilt(BaseModel):
    """What a registry that was made from the run folders holds."""

    units: int
    runs: int
    unreadable: list[str]


def _stock(request: Request) -> Stock:
    stock: Stock = request.app.state.stock
    return stock


Stocked = Annotated[Stock, Depends(_stock)]
"""A parameter of a route that asks the registry."""


@router.get("/units")
def units(
    stock: Stocked,
    q: Annotated[str, Query(max_length=200)] = "",
    standing: Standing | None = None,
    sort: Order = "newest",
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
    offset: Annotated[int, Query(ge=0, le=10**9)] = 0,
) -> Units:
    """Units whose serial number or lot holds every word of `q`."""
    if not stock.exists:
        return Units(registry=False, total=0, matched=0, standings={}, units=[])
    with stock.open() as registry:
        page = listing(registry, q, standing, sort, limit, offset)
    return Units(registry=True, **vars(page))


@router.get("/units/{serial}")
def unit(serial: Serial, stock: Stocked, most: Annotated[int | None, Query(ge=1, le=10**6)] = None) -> History:
    """All about one unit; at `most` so many runs, calibrations and points of a trend, the newest."""
    archive = stock.archive
    with _opened(stock, serial) as registry:
        found = unit_history(registry, archive, serial, datetime.now(UTC), most)
        course = trends(registry, archive, runs_of(registry, serial))
    if most is not None:
        course = [thinned(one, most, found["counts"] and found["counts"]["run"]) for one in course]
    return History(**found, trends=course)


@router.get("/units/{serial}/trends/{quantity}")
def trend(serial: Serial, quantity: Serial, stock: Stocked) -> TrendFigure:
    """One trend as a figure."""
    with _opened(stock, serial) as registry:
        found = trends(registry, stock.archive, runs_of(registry, serial))
    one = next((one for one in found if one["name"] == quantity), None)
    if one is None:
        known = ", ".join(one["name"] for one in found) or "none"
        raise HTTPException(404, f"unit '{serial}' has no quantity '{quantity}'; it has {known}")
    return TrendFigure(name=quantity, figure=figure(one))


@router.get("/units/{serial}/certificates/{number}", response_class=FileResponse,
            responses={200: {"content": {"application/pdf": {}}}})  # fmt: skip
def certificate(serial: Serial, number: Serial, stock: Stocked) -> FileResponse:
    """The PDF of a certificate; it is looked up by the number in its facts, never by a path."""
    _known(stock, serial)
    path = printed_certificate(stock.root, serial, number)
    if path is None:
        raise HTTPException(
            404, f"unit '{serial}' has no certificate '{number}' here; `bench certificate RUN` makes one"
        )
    policy = {"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; object-src 'self'"}
    return FileResponse(path, media_type="application/pdf", filename=f"{path.parent.parent.name}_certificate.pdf",
                        content_disposition_type="inline", headers=policy)  # fmt: skip


@router.post("/registry")
def rebuild(stock: Stocked, who: Engineer) -> Rebuilt:
    """Make the registry from the run folders, as `bench registry rebuild` does."""
    from bench.commands import registry_rebuild as build

    done = build(stock.root, stock.where, False).rebuilt
    return Rebuilt(units=done.counts["units"], runs=done.counts["runs"], unreadable=list(done.unreadable))


def _known(stock: Stock, serial: str) -> None:
    """HTTPException 404 for a unit that the registry does not have."""
    _opened(stock, serial).close()


def _opened(stock: Stock, serial: str) -> Registry:
    """The registry, which has the unit; HTTPException 404 where it does not."""
    registry = stock.open() if stock.exists else None
    if registry is not None and known_unit(registry, serial):
        return registry
    if registry is not None:
        registry.close()
    raise HTTPException(404, f"no unit '{serial}' in the registry; GET /api/v1/units lists them")
