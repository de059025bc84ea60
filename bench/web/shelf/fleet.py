"""`/fleet`: statistics of all units, a figure at a time, and the table for a spreadsheet."""

from __future__ import annotations

import re
from dataclasses import asdict
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field
from pydantic_core import to_jsonable_python

from bench.analysis import load_limits
from bench.archive import (
    NoUnitError,
    Registry,
    Selection,
    Statistics,
    by_lot,
    choices,
    drawn,
    in_common,
    known_lacks,
    overview,
    safe_csv,
    statistics,
)
from bench.archive import fleet_of as read
from bench.base import InputError
from bench.web.ground.problems import COUNTING, NotFoundError
from bench.web.ground.settings import Here, Settings
from bench.web.jobs.jobs import Asked, submit
from bench.web.people.access import Engineer
from bench.web.plans.catalog import Catalog, named
from bench.web.plans.checking import Name
from bench.web.shelf.stock import Answer, Stock
from bench.web.shelf.units import Stocked

router = APIRouter(tags=["fleet"])

OVERVIEW = "overview"
"""Part of an answer: no quantity is called so."""
Text = Annotated[str, Field(max_length=200)]
"""Part of the serial numbers that count."""
LimitsName = Annotated[str | None, Field(max_length=100)]
"""Name of a limits file of the project or of the library."""


Moment = Annotated[AwareDatetime | date, Field(union_mode="left_to_right")]


class Chosen(BaseModel):
    """Which runs count: those of a station, a lot, a plan, a time; all where nothing is said.

    `since` and `until` are days (UTC), both of them included, or moments with their zone, of which the last is not.
    """

    model_config = ConfigDict(frozen=True)

    q: Text = ""
    limits: LimitsName = None
    station: Annotated[str | None, Field(max_length=200)] = None
    lot: Annotated[str | None, Field(max_length=200)] = None
    plan: Annotated[str | None, Field(max_length=200)] = None
    since: Moment | None = None
    until: Moment | None = None
    simulated: bool | None = None
    """Simulated runs alone, or none of them; else they count only where there are no others."""

    def selection(self) -> Selection:
        """The same in the words of the archive."""
        since, until = _moment(self.since), _moment(self.until, 1)
        return Selection(self.plan, self.station, self.lot, since, until, self.simulated)


def _moment(given: datetime | date | None, later: int = 0) -> datetime | None:
    """A moment; of a day its begin (UTC), or that of a `later` one."""
    if given is None or isinstance(given, datetime):
        return given
    day = date.fromordinal(min(given.toordinal() + later, date.max.toordinal()))
    return datetime.combine(day, time.min, UTC)


Choice = Annotated[Chosen, Query()]


class Fleet(BaseModel):
    """The numbers of `bench fleet`; `registry` is false, or `units` 0, where there is nothing to tell."""

    registry: bool
    units: int = 0
    limits: str | None = None
    missing: list[str] = []
    """Quantities that the limits require and no unit has."""
    known_limits: list[str] = []
    choices: dict[str, list[str]] = {}
    """Stations, lots and plans of all calibrated runs; `cut`: lots that are the beginnings of serial numbers."""
    left_out: list[str] = []
    """Runs that do not stand beside these, in words."""
    plan: str | None = None
    """The one that these units ran."""
    simulated: bool | None = None
    """Whether these units are simulated."""
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
    current: bool = True
    """False while newer runs are being counted: the numbers are those before them."""


class FleetSignal(BaseModel):
    """A rule of Nelson (1984) that is broken `at` a unit, counted from 1."""

    rule: int
    text: str
    unit: str
    at: int


class FleetFigure(BaseModel):
    """A figure, unit and run of each place on its x axis, the signals, and a histogram of the same values."""

    name: str
    figure: dict[str, Any]
    histogram: dict[str, Any] | None
    units: list[str]
    runs: list[str]
    signals: list[FleetSignal]
    all: int
    """Units with the quantity; the figure has the newest of them."""


@router.get("/fleet", responses=COUNTING)
def fleet(stock: Stocked, here: Here, chosen: Choice) -> Fleet:
    """Yield, capability, signals, drifts, odd units; figures are asked for one by one."""
    known = sorted(Catalog(here.project, here.own).limits())
    if not stock.exists:
        return Fleet(registry=False, known_limits=known)
    shared: dict[str, Any] = {
        "registry": True, "known_limits": known, "limits": chosen.limits,
        "choices": stock.answer("choices", choices).content(),
    }  # fmt: skip
    try:
        found = _counted(stock, here, chosen)
    except NoUnitError:
        return Fleet(**shared)
    content = found.part(OVERVIEW)
    return Fleet(**{**content, **shared, "first": content["from"], "last": content["to"], "current": found.current})


class FleetLot(BaseModel):
    """Of a lot: its units, how many have which word of the diagnosis, and how many lack which effect."""

    lot: str
    units: int
    verdicts: dict[str, int]
    lacks: dict[str, int]


class FleetLacks(BaseModel):
    """What `bench fleet diagnose` and reports have found: of the newest run of each unit, by lot."""

    model: str = ""
    models: dict[str, int] = {}
    """Models that units were diagnosed with, and how many."""
    units: int = 0
    lots: list[FleetLot] = []
    """Those that lack most first."""
    in_common: list[dict[str, Any]] = []
    current: bool = True
    """False while newer runs are being counted."""


class FleetDiagnosis(BaseModel):
    """The model whose lacks are asked for."""

    model: Name


@router.get("/fleet/lacks", responses=COUNTING)
def lacks(stock: Stocked, chosen: Choice, model: Annotated[str | None, Query(max_length=200)] = None) -> FleetLacks:
    """How many units of each lot lack which effect, as far as the runs that the other figures show were diagnosed."""
    if not stock.exists:
        return FleetLacks()

    def ask(registry: Registry) -> dict[str, Any]:
        found = known_lacks(registry, chosen.selection(), model, part=chosen.q)
        lots = [FleetLot(lot=name, **vars(lot)) for name, lot in by_lot(found.told).items()]
        lots.sort(key=lambda lot: (-sum(lot.lacks.values()), lot.lot))
        return {OVERVIEW: FleetLacks(model=found.model, models=found.models, units=len(found.told), lots=lots,
                                     in_common=[asdict(one) for one in in_common(found.told)])}  # fmt: skip

    found = stock.answer(f"lacks {chosen!r} {model!r}", ask)
    return FleetLacks(**{**found.part(OVERVIEW), "current": found.current})


@router.post("/fleet/lacks", status_code=202)
def diagnose(
    request: Request, stock: Stocked, here: Here, chosen: Choice, wanted: FleetDiagnosis, who: Engineer
) -> Asked:
    """Request `bench fleet diagnose` of the units that the other figures show."""
    _require(stock)
    inputs = {
        "model": Catalog(here.project, here.own).model(wanted.model), "out": str(stock.root), "where": stock.where,
        "selection": to_jsonable_python(chosen.selection()), "part": chosen.q,
    }  # fmt: skip
    return submit(request, "fleet", "bench.web.shelf.acting:fleet_diagnosed", inputs, lane="slow")


@router.get("/fleet/charts/{name}", responses=COUNTING)
def chart(name: Annotated[str, Field(max_length=100)], stock: Stocked, here: Here, chosen: Choice) -> FleetFigure:
    """The control chart of a quantity, `distances` of all units from their lots, or `yield` over time."""
    _require(stock)
    found = _counted(stock, here, chosen)
    if name == OVERVIEW or name not in found.parts:
        known = ", ".join(sorted(found.parts.keys() - {OVERVIEW}))
        raise NotFoundError(f"no chart of '{name}'; the charts are {known or 'none'}")
    return FleetFigure(**found.part(name))


@router.get("/fleet.csv", response_class=Response, responses={200: {"content": {"text/csv": {}}}})
def table(stock: Stocked, here: Here, chosen: Choice) -> Response:
    """A line a unit and quantity; no cell begins like a formula."""
    _require(stock)
    with stock.open() as registry:
        text = safe_csv(_statistics(registry, chosen, _limits(here, chosen)))
    return Response(text, media_type="text/csv", headers={"Content-Disposition": 'attachment; filename="fleet.csv"'})


def _require(stock: Stock) -> None:
    if not stock.exists:
        raise NotFoundError("no registry here yet: POST /api/v1/registry makes it from the run folders")


def _limits(here: Settings, chosen: Chosen) -> Path | None:
    if chosen.limits is None:
        return None
    try:
        return named(Catalog(here.project, here.own).limits(), chosen.limits, "limits")
    except InputError as error:
        raise NotFoundError(str(error)) from None


def _statistics(registry: Registry, chosen: Chosen, path: Path | None) -> Statistics:
    # A pattern of somebody else can be made to take for ever: only plain text is looked for.
    pattern = f".*{re.escape(chosen.q)}.*" if chosen.q else None
    return statistics(read(registry, pattern, chosen.selection(), load_limits(path) if path else None))


def _counted(stock: Stock, here: Settings, chosen: Chosen) -> Answer:
    """The overview, and every figure by its name."""
    path = _limits(here, chosen)
    changed = path.stat().st_mtime_ns if path else 0

    def ask(registry: Registry) -> dict[str, Any]:
        found = _statistics(registry, chosen, path)
        return {OVERVIEW: overview(found), **drawn(found)}

    return stock.answer(f"fleet {chosen!r} {changed}", ask)
