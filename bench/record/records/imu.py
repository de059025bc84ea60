"""imu.json: the calibration of a whole inertial unit: its parameters over temperature, their covariance, its noise."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from bench.base import InputError
from bench.record.records.calibration import StoredQuantity
from bench.record.records.judged import Judged, Verdict
from bench.record.records.stored import Record, Stored

Three = tuple[float, float, float]


class ImuSource(Stored):
    """A file that the calibration was made from."""

    file: str
    sha256: str


class ImuParameter(Stored):
    """One parameter of an axis over its range of temperature: a sum of Chebyshev polynomials, or of cubic B-splines."""

    name: str
    kind: str
    """bias, scale factor, misalignment, g-sensitivity, or second to fifth order."""
    unit: str
    factor: float
    """Its value in `unit` for a coefficient of one."""
    towards: int | None = None
    """Axis of the input that it multiplies, where there is one."""
    coefficients: tuple[float, ...]
    """Of T_0, T_1, … at (2 T - low - high) / (high - low); biases in the unit of the output, others plain factors."""
    intervals: int = 0
    """Above 0 they are those of cubic B-splines on so many equal intervals, with fourfold knots at the ends."""


def shapes(orders: Mapping[str, object]) -> str:
    """The `orders` of a plan for people."""
    told = {name: f"spline of {one['spline']} intervals" if isinstance(one, Mapping) else one
            for name, one in orders.items() if one is not None}  # fmt: skip
    return ", ".join(f"{name.replace('_', ' ')} {one}" for name, one in told.items())


class ImuAxis(Stored):
    """One axis of a triad; its output is what it should measure, and what each parameter adds."""

    axis: Literal["x", "y", "z"]
    output: str
    """Channel of its output."""
    thermometer: str
    """Channel of its temperature."""
    range_degc: tuple[float, float]
    parameters: tuple[ImuParameter, ...]
    covariance: tuple[tuple[float, ...], ...]
    """Of all coefficients, one parameter after the other."""
    variances: dict[str, float] = Field(default_factory=dict)
    """Of the rows, by component: white, flicker and walk of the output [unit^2], attitudes [rad^2]."""
    temperature_degc: tuple[float, ...] = ()
    """Of each fitted row."""
    residual: tuple[float, ...] = ()
    """Output less model of each fitted row, in the unit of the output."""
    noise_density: float | None = None
    """White noise of the samples at rest [unit / sqrt(Hz)]; null without samples."""


class ImuTriad(Stored):
    """Three gyros or three accelerometers."""

    kind: Literal["gyro", "accelerometer"]
    unit: str
    """Of the outputs."""
    axes: tuple[ImuAxis, ImuAxis, ImuAxis]


class ImuValue(Stored):
    """A parameter at one temperature; U with k = 2."""

    name: str
    kind: str
    unit: str
    temperature_degc: float
    value: float
    U: float


class ImuFinding(Stored):
    """Something that is wrong, and where."""

    cause: str
    where: str
    text: str
    look_alikes: tuple[str, ...] = ()


class ImuPosition(Stored):
    """An attitude and a rate of the table that rows of the fit had."""

    up: Three
    """Direction of the unit that pointed up."""
    rate_dps: float


class ImuRecord(Record):
    """What another program needs to compensate a unit, and to know how far to trust it."""

    FILE: ClassVar[str] = "imu.json"
    TITLE: ClassVar[str] = "imu"
    ADVICE: ClassVar[str] = "make it again with `bench imu … --out`"

    unit: str = ""
    """Serial number; empty where nobody gave one."""
    created: str
    software: dict[str, str] = Field(default_factory=dict)
    sources: tuple[ImuSource, ...]
    """Data and plan."""
    plan: dict[str, Any]
    """The plan as it was read."""
    latitude_deg: float
    gravity: float
    """At the place [m/s^2]."""
    interval_s: float
    """Length of a row."""
    left_out: int
    """Rows that lacked samples, or in which the table changed its rate."""
    time_s: tuple[float, ...] = ()
    """Middle of each fitted row."""
    sample_hz: float | None = None
    simulated: bool = False
    range_degc: tuple[float, float]
    """Range of temperature that all six axes had."""
    rate_ppm: float = 0.0
    """Standard uncertainty of the rate table's scale."""
    gravity_ppm: float = 0.0
    """The same of gravity."""
    gyro: ImuTriad
    accelerometer: ImuTriad
    parameters: tuple[ImuValue, ...]
    undetermined: tuple[str, ...] = ()
    findings: tuple[ImuFinding, ...] = ()
    positions: tuple[ImuPosition, ...] = ()
    """Every attitude and rate that was fitted, once."""

    @property
    def triads(self) -> tuple[ImuTriad, ImuTriad]:
        """Gyros and accelerometers."""
        return self.gyro, self.accelerometer

    @classmethod
    def at(cls, path: Path) -> ImuRecord | None:
        """The record of a folder, or the file itself; None where a path is neither. InputError where it is damaged."""
        if path.suffix == ".json" and path.is_file():
            return cls.read(path.parent, path.name)
        return cls.find(path) if path.is_dir() else None

    @classmethod
    def of(cls, path: Path) -> ImuRecord:
        """The same; InputError where there is none."""
        found = cls.at(path)
        if found is None:
            raise InputError("is no calibration of an inertial unit; make one with `bench imu … --out FOLDER`", path)
        return found


class ImuAxisError(Stored):
    """One axis over the rows of a verification, in the unit of its output."""

    name: str
    unit: str
    raw_rms: float
    """Output less input, before the correction."""
    rms: float
    """After it."""
    interval: tuple[float, float]
    """95 %, as if each stay were one value: the rows of a stay share its attitude's error."""
    mean: float
    scatter: float
    """RMS about the mean."""
    peak: float
    floor: float
    """What a perfect calibration would leave: noise of neighbouring rows of a stay, and attitudes that are as exact as
    the calibration found them."""
    over_floor: float
    """RMS over the floor."""
    stated: float
    """Standard deviation that the calibration states of such rows: the floor, the uncertainty of its parameters, and
    how it saw a bias wander."""


class ImuVerificationRecord(Record):
    """A calibration against attitudes and rates that it was not fitted to."""

    FILE: ClassVar[str] = "imu_verification.json"
    TITLE: ClassVar[str] = "imu_verification"
    MADE_FROM: ClassVar[tuple[str, ...]] = (ImuRecord.FILE,)
    ADVICE: ClassVar[str] = "make it again with `bench imu … --verify`"

    created: str
    sources: tuple[ImuSource, ...] = ()
    """Data and plan."""
    verdict: Verdict
    rows: int
    """Judged."""
    stays: int
    fitted_rows: int
    """Left out because attitude and rate were fitted."""
    rows_beyond: int
    """Left out because a temperature was beyond the calibrated range."""
    range_degc: tuple[float, float]
    axes: tuple[ImuAxisError, ...]
    quantities: tuple[StoredQuantity, ...] = ()
    rule: str | None = None
    """Without limits: the rule that took their place."""
    limits: Judged | None = None
