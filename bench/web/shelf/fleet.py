"""`/fleet`: statistics of all units, a figure at a time, and the table for a spreadsheet."""

from __future__ import annotations

import re
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from bench.analysis import load_limits
from bench.archive import NoUnitError, Registry, Statistics, drawn, overview, safe_csv, statistics
from bench.archive import fleet_of as read
from bench.base import InputError
from bench.web.ground.problems import NotFoundError
from bench.web.ground.settings import Here, Settings
from bench.web.plans.catalog import Catalog, named
from bench.web.shelf.stock import Stock
from bench.web.shelf.units import Stocked

router = APIRouter(tags=["fleet"])

Text = Annotated[str, Query(max_length=200)]
"""Part of the serial numbers that count."""
LimitsName = Annotated[str | None, Query(max_length=100)]
"""Name of a limits file of the project or of the library."""


class Fleet(BaseModel):
    """The numbers of `bench fleet`; `registry` is false, or `units` 0, where there is nothing to tell."""

    registry: bool
    units: int = 0
    limits: str | None = None
    missing: list[str] = []
    """Quantities that the limits require and no unit has."""
    known_limits: list[str] = []
    lots: int = 0
    stations: int = 0
    first: str | None = None
    last: str | None = None
    passes: dict[str, Any] = Field(default={}, alias="yield")
    quantities: list[dict[str, Any]] = []
    drifts: list[dict[str, Any]] = []
    tested: int = 0
    """Changes that were tested; those shown are significant after Holm's correction."""
    shifts: list[dict[str, Any]] = []
    """First alarm of each station's CUSUM and EWMA, with the unit and the time since which the station is off."""
    station_charts: dict[str, Any] = {}
    """Their limits, run lengths, and the share of fleets without a change that have an alarm."""
    unlike: list[dict[str, Any]] = []
    attention: dict[str, Any] = {}
    distances: bool = False


class FleetSignal(BaseModel):
    """A rule of Nelson (1984) that is broken `at` a unit, counted from 1."""

    rule: int
    text: str
    unit: str
    at: int


class FleetFigure(BaseModel):
    """A figure, the unit of each place on its x axis, and the signals."""

    name: str
    figure: dict[str, Any]
    units: list[str]
    signals: list[FleetSignal]


@router.get("/fleet")
def fleet(stock: Stocked, here: Here, q: Text = "", limits: LimitsName = None) -> Fleet:
    """Yield, capability, signals, drifts, odd units; figures are asked for one by one."""
    known = sorted(Catalog(here.project, here.own).limits())
    if not stock.exists:
        return Fleet(registry=False, known_limits=known)
    try:
        found = _statistics(stock, here, q, limits)
    except NoUnitError:
        return Fleet(registry=True, known_limits=known, limits=limits)
    content = overview(found)
    return Fleet(
        registry=True,
        known_limits=known,
        **{**content, "limits": limits, "first": content["from"], "last": content["to"]},
    )


@router.get("/fleet/charts/{name}")
def chart(name: Annotated[str, Field(max_length=100)], stock: Stocked, here: Here, q: Text = "",
          limits: LimitsName = None) -> FleetFigure:  # fmt: skip
    """The control chart of a quantity, or `distances` of all units from their lots."""
    found = _existing(stock, here, q, limits)
    try:
        return FleetFigure(**drawn(found, name))
    except InputError as error:
        raise NotFoundError(str(error)) from None


@router.get("/fleet.csv", response_class=Response, responses={200: {"content": {"text/csv": {}}}})
def table(stock: Stocked, here: Here, q: Text = "", limits: LimitsName = None) -> Response:
    """A line a unit and quantity; no cell begins like a formula."""
    text = safe_csv(_existing(stock, here, q, limits))
    return Response(text, media_type="text/csv", headers={"Content-Disposition": 'attachment; filename="fleet.csv"'})


def _existing(stock: Stock, here: Settings, q: str, limits: str | None) -> Statistics:
    if not stock.exists:
        raise NotFoundError("no registry here yet: POST /api/v1/registry makes it from the run folders")
    return _statistics(stock, here, q, limits)


def _statistics(stock: Stock, here: Settings, q: str, limits: str | None) -> Statistics:
    path = None
    if limits is not None:
        try:
            path = named(Catalog(here.project, here.own).limits(), limits, "limits")
        except InputError as error:
            raise NotFoundError(str(error)) from None
    changed = path.stat().st_mtime_ns if path else 0

    def ask(registry: Registry) -> Statistics:
        bounds = load_limits(path) if path else None
        # A pattern of somebody else can be made to take for ever: only plain text is looked for.
        return statistics(read(registry, f".*{re.escape(q)}.*" if q else None), bounds)

    return stock.answer(("fleet", q, limits, changed), ask)
