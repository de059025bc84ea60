"""What a run tells at each tick, and of each executed segment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from bench.acquisition.profile.legs import Leg
from drivers.chamber import ChamberReading

Outcome = Literal["done", "timeout", "held", "interrupted", "ended"]
"""`ended`: whoever was asked whether the run goes on said that it need not."""


@dataclass(frozen=True)
class SegmentResult:
    """One executed segment: when, how it ended, and why if not as planned."""

    index: int
    name: str
    kind: str
    from_s: float
    to_s: float
    target_degc: float
    rate_degc_per_min: float | None
    direction: str
    outcome: Outcome = "interrupted"
    reason: str = ""
    attitude: str | None = None
    heading_deg: float = 0.0


@dataclass(frozen=True)
class Status:
    """What an onlooker may want to know, once a tick."""

    t_s: float
    leg: Leg
    leg_from_s: float
    legs: int
    reading: ChamberReading
    unit_degc: float
    holding: tuple[str, ...]
    """The guards and operators that hold the run."""
    state: Literal["running", "holding", "pausing"] = "running"
    """`pausing`: will hold after the present segment."""
    anew: bool = False
    """Whether the segment begins anew after a hold; a ramp goes on from where the chamber is."""
