"""manifest.json: what was run, on what, when, how it ended, and the hash of every file that its numbers rest on."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from bench.record.records.stored import Record, Stored


class GyroKind(Stored):
    """How the unit's frames are decoded."""

    layout: str
    """Its DBC; empty where `signals` describe every signal."""
    number: int
    """Number of the unit on its bus."""
    bus: str
    signals: dict[str, Any] | None = None
    """Which signals are what, as in the station file; null: by the names that the bench knows."""
    thermometers: dict[str, str] = Field(default_factory=dict)
    """Thermometer that sits at each output, by output; an output that is not named has the first one."""


class Orientation(Stored):
    """Where the unit was and how its sensitive axis lay, as station and profile state it."""

    latitude_deg: float
    """North positive."""
    axis: Literal["level", "vertical", "vertical_down"]
    azimuth_deg: float | None = None
    """Of a level axis, clockwise from true north; on a rate table, at its start."""


class Companion(Stored):
    """A unit in the same chamber, and its run folder as seen from this one."""

    unit: str
    run: str


class ExecutedSegment(Stored):
    """One executed segment of the profile, or a stretch found in an imported table; bench time [s]."""

    index: int = 0
    name: str
    kind: str = ""
    from_s: float
    to_s: float
    target_degc: float | None = None
    rate_degc_per_min: float | None = None
    direction: str = ""
    """heating, cooling or constant."""
    outcome: str = "done"
    """done, timeout, held, interrupted; detected in an import."""
    reason: str = ""
    """Why it did not end as planned."""
    settled: bool = True
    attitude: str | None = None
    """Name of the attitude that the unit stood in; null: nobody said."""
    heading_deg: float = 0.0
    """By how much it was turned against the heading that belongs to the name, counter-clockwise from above [deg]."""
    turn_on: int = 1
    """Which turn-on of the run it belongs to; a power cycle belongs to the one that it ends with."""


class UnitClock(Stored):
    """The unit's clock against the host's, with standard uncertainties; null: the record is too short."""

    offset_s: float
    offset_u_s: float | None = None
    drift_ppm: float
    drift_u_ppm: float | None = None
    spread_s: float | None = None


class Capture(Stored):
    """How the capture kept up with its bus."""

    most_behind_s: float
    behind_spells: int = 0
    error_frames: int = 0
    unreadable: int = 0
    recoveries: int = 0


class UnitIdentity(Stored):
    """What the unit said about itself in its heartbeat."""

    serial: int
    firmware: int | None = None
    coefficient_set: int | None = None
    """Number of the coefficients in force; 0: the unit sends the raw rate."""
    state: int | None = None


class LeftOut(Stored):
    """Samples that are no measurements, and were left out of the tables for one reason."""

    why: str
    channel: str
    """rate, temperature (and with it the rate), or chamber_temperature."""
    from_s: float
    to_s: float
    """First and last of them; bench time."""
    samples: int
    """Rate samples, or readings of the chamber."""
    duration_s: float
    """Of them together."""
    spans: tuple[tuple[float, float], ...] = ()
    """The first of the stretches."""


class Gap(Stored):
    """What is known of the gap before a part of a run."""

    text: str
    from_s: float | None = None
    to_s: float | None = None
    duration_s: float
    duration_known: bool = True
    before: dict[str, Any] = Field(default_factory=dict)
    """Chamber and units at its beginning …"""
    after: dict[str, Any] = Field(default_factory=dict)
    """… and at its end."""
    unit_power: str = "unknown"
    """kept, lost or unknown."""
    counter_off_s: float | None = None
    """How far the unit's counter was from where it should be."""


class RunPart(Stored):
    """One start of the bench for this run."""

    part: int
    from_s: float | None = None
    to_s: float | None = None
    state: str
    cause: str = ""
    versions: dict[str, str] = Field(default_factory=dict)
    gap: Gap | None = None
    """Before it; of the parts after the first."""


class Begun(Stored):
    """What is known when a run begins: the head of its journal, and the beginning of its manifest."""

    run: str = ""
    """Name of the run folder."""
    unit: str = ""
    """Serial number."""
    created: str = ""
    """ISO 8601, UTC."""
    profile: str = ""
    station: str | None = None
    simulated: bool | None = None
    purpose: str | None = None
    """calibration (the unit sends the raw rate) or verification (it corrects itself)."""
    gyro: GyroKind | None = None
    operator: str | None = None
    """Who asked for it."""
    orientation: Orientation | None = None
    """The Earth rate along the axis is removed from the bias; null: not stated, and nothing is removed."""
    latitude_deg: float | None = None
    """Of the place, north positive; null: not stated."""
    unit_margin_degc: float | None = None
    """A unit further outside all that the air was than this is not believed …"""
    unit_lag_min: float | None = None
    """… within this lag."""
    seeds: dict[str, int] = Field(default_factory=dict)
    """Of a simulation."""
    power_on: int | None = None
    """Which power-on of the unit this run begins with, counted over its life; null where nobody counts."""
    versions: dict[str, str] = Field(default_factory=dict)
    companions: tuple[Companion, ...] = ()


class Manifest(Begun, Record):
    """A run, its outcome and its files."""

    FILE: ClassVar[str] = "manifest.json"
    TITLE: ClassVar[str] = "manifest"
    ROOT: ClassVar[bool] = True
    ADVICE: ClassVar[str] = "restore it or name another run"
    MISSING: ClassVar[str] = (
        "not a run folder: manifest.json is missing; name a folder made by `bench run` or `bench import`"
    )

    state: str = "unknown"
    """done, aborted or failed."""
    cause: str = ""
    """Why it ended so; `imported` for a table of somebody else."""
    source: dict[str, Any] | None = None
    """Of an import: the table, its columns and its SHA-256."""
    sample_rate_hz: int | float | None = None
    rate_step_dph: float | None = None
    """Resolution of the unit's output [deg/h]."""
    unit_clock: UnitClock | None = None
    capture: Capture | None = None
    unit_identity: UnitIdentity | None = None
    rows: int = 0
    """Of data.parquet."""
    duration_s: float = 0.0
    segments: tuple[ExecutedSegment, ...] = ()
    losses: dict[str, int] = Field(default_factory=dict)
    """Frames by what happened to them; empty where nobody counted."""
    left_out: tuple[LeftOut, ...] = ()
    """What was not valid, by reason; the rate samples among it are counted as `invalid` in `losses`."""
    parts: tuple[RunPart, ...] = ()
    """Of a run whose bench was started more than once for it."""
    files: dict[str, str] = Field(default_factory=dict)
    """SHA-256 by path inside the folder."""

    @property
    def imported(self) -> bool:
        """Whether it is a table of somebody else, which no station of this bench recorded."""
        return self.cause == "imported"

    @property
    def of_lot(self) -> bool:
        """Whether its rows were put together for a lot's calibration, so that it cannot be made again from them."""
        return self.profile == "lot"

    @property
    def output(self) -> str:
        """Which output of the unit the `rate` of this run is."""
        return str((self.source or {}).get("output", "rate"))

    @property
    def corrected(self) -> bool:
        """Whether the unit corrected its rate itself: nothing may be fitted to such a run."""
        return self.purpose == "verification" or bool(self.unit_identity and self.unit_identity.coefficient_set)
