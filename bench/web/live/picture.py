"""The answers of `/live` in the description of the API."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

Number = float | None
"""None: not known."""


class StepTaken(BaseModel):
    """A step on the way to the safe state; `ok`: read back."""

    text: str
    ok: bool


class RequestMade(BaseModel):
    """A request of an operator, with its time (UTC)."""

    request: str | None
    who: str | None
    utc: str | None


class UnitVerdict(BaseModel):
    """The verdict on a unit; `limits`: the verdict against limits, if there are any.

    For a unit that was not `analysed` and will not be, `sentence` says why.
    """

    unit: str
    run: str = ""
    analysed: bool = False
    verified: bool = False
    """Whether it is the verdict of a verification, which has no report."""
    verdict: str | None
    sentence: str = ""
    limits: str | None = None


class End(BaseModel):
    """The end of a run; `verdict` follows after the analysis."""

    model_config = ConfigDict(extra="ignore")

    run: str
    runs: list[str]
    job: str | None = None
    """The calibration that it was made for."""
    state: str
    """done, aborted or failed."""
    cause: str
    safe: bool | None
    """Whether the safe state was read back, or nothing had moved; None: not known."""
    safe_state: list[StepTaken]
    requests: list[RequestMade]
    analysing: bool
    units: list[UnitVerdict]
    verdict: str | None
    sentence: str


class SegmentNow(BaseModel):
    """The present segment."""

    index: int
    of: int
    name: str
    kind: str
    target_degc: float
    rate_degc_per_min: Number
    from_s: float
    left_s: float
    anew: bool = False
    """Whether it begins anew after a hold; a ramp goes on from where the chamber is."""


class ChamberNow(BaseModel):
    """The last reading of the chamber."""

    temperature_degc: Number
    setpoint_degc: Number
    working_setpoint_degc: Number
    on: bool | None
    alarm: list[str]


class UnitNow(BaseModel):
    """A unit, its frames by their fate, and the reason if it was dropped."""

    serial: str
    temperature_degc: Number
    losses: dict[str, int]
    dropped: str | None


class BusNow(BaseModel):
    """A bus: state of its capture, and the present and longest wait of its frames [s]."""

    bus: str
    state: Literal["ok", "degraded", "lost"]
    frames: int
    behind_s: float
    most_behind_s: float


class GuardLight(BaseModel):
    """A guard as a traffic light."""

    name: str
    state: Literal["ok", "waiting", "tripped"]
    text: str
    action: str
    signal: str
    value: Number
    per_min: Number = None


class Again(BaseModel):
    """What a run was started with, so that it can be started again."""

    plan: str
    station: str | None
    units: list[str]
    limits: str | None = None
    models: list[str] = []


class Run(BaseModel):
    """A live run or an ended one; unknown values are missing or null."""

    run: str
    runs: list[str]
    unit: str
    profile: str
    shipped: bool = True
    """Whether the profile is as the bench ships it, by this name."""
    station: str
    simulated: bool
    started: str
    start: str | None
    """The start that made it, if the page started it."""
    who: dict[str, str] | None
    job: str | None = None
    """The calibration that it is made for."""
    again: Again | None = None
    """What was started, if the page started it."""
    nominal_s: float
    segments_s: list[float] = []
    """Nominal duration of each segment [s]."""
    curve: list[tuple[float, float]]
    condition: Literal["live", "silent", "gone", "ended"]
    detail: str = ""
    error: str = ""
    """The reason why the state is old: the same as `detail`."""
    state: str
    ending: str | None = None
    """The user who aborted it, or another reason of its end."""
    t_s: Number = None
    left_s: Number = None
    late_s: Number = None
    segment: SegmentNow | None = None
    chamber: ChamberNow | None = None
    units: list[UnitNow] = []
    buses: list[BusNow] = []
    holding: list[str] = []
    guards: list[GuardLight] = []
    fits: dict[str, Any] = {}
    """Errors of models on the run so far, by unit, as `bench status` prints them."""
    age_s: Number = None
    ended: End | None = None


class Pictures(BaseModel):
    """All live runs."""

    runs: list[Run]


class TraceAnswer(BaseModel):
    """A trace from point `first` on.

    A point is [t_s, set point, chamber, [unit…], [[rate_min, rate_max, rate_mean]…]].
    """

    generation: int
    first: int
    next: int
    count: int
    every_s: float
    serials: list[str]
    points: list[list[Any]]
    open: list[Any] | None
    """The newest point, which is not complete."""


class Happened(BaseModel):
    """An event of a run: time of the bench, kind, what happened, and what it was about."""

    t_s: Number
    utc: str | None
    kind: str
    text: str
    phase: str = ""
    """Of a segment or a hold: start or end."""
    segment: dict[str, Any] | None = None
    units: dict[str, dict[str, float]] | None = None
    """Of a decision: its figures by serial number; errors in deg/h RMS."""
    limit_dph: Number | None = None


class Log(BaseModel):
    """The newest events of a live run, newest first."""

    events: list[Happened]


class Asked(BaseModel):
    """Outcome of a request: `done`, or the state that the run is in."""

    run: str
    asked: str
    done: bool
    state: str
    holding: list[str] = []
    cause: str | None = None
    safe: bool | None = None
    safe_state: list[StepTaken] = []
    """Of an abort, when the end is known."""
    ended: End | None = None
