"""`/plans`, `/stations` and `/limits`: the profiles, stations and limits that the page offers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter
from pydantic import BaseModel

from bench.web.ground.problems import row
from bench.web.ground.settings import Here, Settings
from bench.web.plans import catalog
from bench.web.plans.catalog import Catalog, Read

router = APIRouter(tags=["plans"])
_read = Read()


class Plan(BaseModel):
    """A profile; `problem` says why it cannot be run."""

    id: str
    name: str
    title: str
    shipped: bool = True
    """Whether it is as the bench ships it, by this id."""
    summary: str = ""
    nominal_s: float = 0.0
    curve: list[tuple[float, float]] = []
    """Nominal set point: [s], [degC]."""
    kind: str = "temperature"
    """`rate`: needs a station with a rate table."""
    segments: int = 0
    limits: str = ""
    """Limits of the calibration plan that uses this profile; empty without one."""
    models: list[str] = []
    """Models of that plan."""
    verification: str = ""
    """Profile that verifies the calibrations by this one in that plan; empty for another use."""
    proposed: bool = False
    """Whether a diagnosis proposed it."""
    problem: str = ""


class CalibrationPlan(BaseModel):
    """The plan of a calibration, from the shelf to the certificate; `problem` says what is wrong with it."""

    id: str
    title: str
    shipped: bool = True
    """Whether it is as the bench ships it, by this id."""
    summary: str = ""
    nominal_s: float = 0.0
    """Of all its runs."""
    curve: list[tuple[float, float]] = []
    """Nominal set point of the calibration run: [s], [degC]."""
    kind: str = "temperature"
    """`rate`: needs a station with a rate table; `imu`: is for inertial units."""
    attitudes: int = 0
    """Number of attitudes that the fixture is turned to."""
    certificate: bool = True
    problem: str = ""


class CalibrationPlans(BaseModel):
    """All plans of calibrations of the library and of the project."""

    plans: list[CalibrationPlan]


class Plans(BaseModel):
    """All profiles of the library and of the project."""

    plans: list[Plan]


class StationInShort(BaseModel):
    """A station, and the units that may be tested there."""

    id: str
    title: str
    simulated: bool = False
    rate_table: bool = False
    fixture: Literal["asked", "simulated"] | None = None
    """Who turns its fixture: people, or nobody on a simulated station; null without one."""
    units: list[str] = []
    wires: list[str] = []
    """Bus and number of each of the units, as `can0 0`."""
    problem: str = ""


class Stations(BaseModel):
    """All stations of the library and of the project."""

    stations: list[StationInShort]


class LimitsInShort(BaseModel):
    """A limits file, by which a unit passes or fails."""

    id: str
    title: str
    summary: str = ""
    problem: str = ""


class LimitsListed(BaseModel):
    """All limits of the library and of the project."""

    limits: list[LimitsInShort]


@router.get("/limits")
def limits(here: Here) -> LimitsListed:
    """All limits."""
    found = Catalog(here.project, here.own).limits()
    return LimitsListed(limits=[_limits(id_, path, here) for id_, path in found.items()])


@router.get("/plans")
def plans(here: Here) -> Plans:
    """All profiles."""
    known = Catalog(here.project, here.own)
    belonging = known.belonging()
    more = {id_: {"proposed": known.is_proposed(path), **belonging.get(id_, {})} for id_, path in known.plans().items()}
    return Plans(plans=[_plan(id_, path, more[id_], here) for id_, path in known.plans().items()])


@router.get("/calibration-plans")
def calibration_plans(here: Here) -> CalibrationPlans:
    """All plans of calibrations."""
    found = Catalog(here.project, here.own).calibrations()
    return CalibrationPlans(plans=[_calibration(id_, path, here) for id_, path in found.items()])


@router.get("/stations")
def stations(here: Here) -> Stations:
    """All stations."""
    found = Catalog(here.project, here.own).stations()
    return Stations(stations=[_station(id_, path, here) for id_, path in found.items()])


def _limits(id_: str, path: Path, here: Settings) -> LimitsInShort:
    return row(
        here.project,
        lambda: LimitsInShort(id=id_, **_read(path, catalog.limits)),
        lambda problem: LimitsInShort(id=id_, title=id_, problem=problem),
    )


def _plan(id_: str, path: Path, belonging: Mapping[str, Any], here: Settings) -> Plan:
    return row(
        here.project,
        lambda: Plan(id=id_, **_read(path, catalog.plan), **belonging),
        lambda problem: Plan(id=id_, name=id_, title=id_, problem=problem),
    )


def _calibration(id_: str, path: Path, here: Settings) -> CalibrationPlan:
    return row(
        here.project,
        lambda: CalibrationPlan(id=id_, **catalog.calibration(path, _read)),
        lambda problem: CalibrationPlan(id=id_, title=id_, problem=problem),
    )


def _station(id_: str, path: Path, here: Settings) -> StationInShort:
    def made() -> StationInShort:
        settings = _read(path, catalog.station)
        return StationInShort(
            id=id_,
            title=settings.name,
            simulated=settings.simulated,
            rate_table=settings.rate_table is not None,
            fixture=settings.fixture and settings.fixture.operator,
            units=[unit.serial for unit in settings.units],
            wires=[f"{unit.bus} {unit.number}" for unit in settings.units],
        )

    return row(here.project, made, lambda problem: StationInShort(id=id_, title=id_, problem=problem))
