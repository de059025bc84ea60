"""The plan of a calibration of an inertial unit: where it was, and which attitude it had when; a YAML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from bench.analysis.imu.curves import Reference
from bench.analysis.imu.triad import Curve, TriadModel
from bench.base import STRICT, Document, PlacedError, load_config, nearest_or_all, read_yaml
from bench.record import ATTITUDES, AXES, Attitude

Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Seconds = Annotated[float, Field(ge=0.0)]
Order = Annotated[int, Field(ge=0, le=6)]
_THERMOMETERS = ("temperature", "temperature", "temperature")


class StaySettings(BaseModel):
    """One stay in an attitude, and in one only."""

    model_config = STRICT

    from_s: Seconds
    """Time of the table of data at which the unit stands so; the way there is left out."""
    to_s: Annotated[float, Field(gt=0.0)]
    """Time at which it is moved again."""
    attitude: str | None = None
    """Name of an attitude: x_up … z_down, or an edge or corner such as +x-y_up."""
    up: tuple[float, float, float] | None = None
    """Direction of the unit that points up, instead of a name."""
    heading_deg: Degrees = 0.0
    """Turn about the vertical that follows, counter-clockwise from above; at 0 the most level axis points east."""

    @model_validator(mode="after")
    def _one_attitude(self) -> StaySettings:
        if (self.attitude is None) == (self.up is None):
            raise ValueError("a stay needs either attitude or up")
        if self.attitude is not None and self.attitude not in ATTITUDES:
            raise PlacedError(f"attitude {self.attitude!r} is not known{nearest_or_all(self.attitude, ATTITUDES)}",
                              ("attitude",))  # fmt: skip
        if not self.to_s > self.from_s:
            raise PlacedError(f"to_s is {self.to_s:g}, allowed is more than from_s, {self.from_s:g}", ("to_s",))
        return self

    @property
    def placed(self) -> Attitude:
        """The attitude, with its heading."""
        if self.up is not None:
            return Attitude.of(f"up {list(self.up)}, heading {self.heading_deg:g}", self.up, self.heading_deg)
        own = ATTITUDES[str(self.attitude)]
        if self.heading_deg == 0.0:
            return own
        turned = Attitude.of("", (0.0, 0.0, 1.0), self.heading_deg).matrix
        return Attitude(f"{own.name}, heading {self.heading_deg:g}", own.matrix @ turned)


class SplineSettings(BaseModel):
    """A cubic spline in the place of a polynomial."""

    model_config = STRICT

    spline: Annotated[int, Field(ge=1, le=20)]
    """Number of its intervals, of equal length."""

    def curve(self) -> Curve:
        """As it is fitted."""
        return Curve(intervals=self.spline)


Shape = Order | SplineSettings
"""Of a parameter over temperature: order of a polynomial, or a spline."""


class OrderSettings(BaseModel):
    """Each kind of parameter over temperature: order of a polynomial, or a spline; null leaves a kind out."""

    model_config = STRICT

    bias: Shape = 3
    scale_factor: Shape = 2
    misalignment: Shape = 1
    g_sensitivity: Shape | None = 1
    second_order: Shape | None = 1
    surface: Annotated[int, Field(ge=1, le=5)] | None = None
    """Total degree of a polynomial in temperature and the axis's own input, in the place of bias, scale_factor and
    second_order; 5 has 21 coefficients an axis."""

    def model(self) -> TriadModel:
        """The model that is fitted."""
        g, second = (None if shape is None else _curve(shape) for shape in (self.g_sensitivity, self.second_order))
        own = _curve(self.bias), _curve(self.scale_factor), _curve(self.misalignment)
        return TriadModel(*own, g, second, self.surface)


def _curve(shape: Shape) -> Curve:
    return Curve(shape) if isinstance(shape, int) else shape.curve()


class ImuOptions(BaseModel):
    """How the outputs of an inertial unit are fitted."""

    model_config = STRICT

    gravity: Annotated[float, Field(gt=9.7, lt=9.9)] | None = None
    """Gravity at the place [m/s^2]; left out: normal gravity at sea level."""
    row_s: Annotated[float, Field(ge=1.0, le=3600.0)] = 60.0
    """Length of the means that are fitted [s]; whole turns of the table are best."""
    rate_ppm: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard uncertainty of the rate table's scale [ppm]."""
    gravity_ppm: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard uncertainty of gravity [ppm]."""
    gyro_thermometers: tuple[str, str, str] = _THERMOMETERS
    """Channel with the temperature of each gyro."""
    accelerometer_thermometers: tuple[str, str, str] = _THERMOMETERS
    """The same of each accelerometer."""
    orders: OrderSettings = OrderSettings()
    """Of the curves over temperature."""

    @property
    def reference(self) -> Reference:
        """Uncertainty of what drives the unit."""
        return Reference(self.rate_ppm, self.gravity_ppm)

    def thermometers(self, kind: Literal["gyro", "accelerometer"]) -> tuple[str, str, str]:
        """Channels with the temperatures of the three axes."""
        return self.gyro_thermometers if kind == "gyro" else self.accelerometer_thermometers


class RunOptions(ImuOptions):
    """The same for runs, which know their attitudes, and mostly where they were."""

    latitude_deg: Latitude | None = None
    """Latitude, north positive; left out: as the runs state it."""


class ImuPlan(ImuOptions):
    """Where an inertial unit was calibrated, and how it stood when."""

    latitude_deg: Latitude
    """Latitude, north positive; gravity and the Earth's rate follow from it."""
    stays: Annotated[tuple[StaySettings, ...], Field(min_length=1)]
    """Attitudes, in the order of time."""

    @model_validator(mode="after")
    def _in_order(self) -> ImuPlan:
        for i, (one, other) in enumerate(zip(self.stays, self.stays[1:], strict=False), start=1):
            if other.from_s < one.to_s:
                text = f"from_s is {other.from_s:g}, the stay before ends at {one.to_s:g} s; put stays in order"
                raise PlacedError(text, ("stays", i, "from_s"))
        return self


def load_imu_plan(source: Path | str) -> tuple[ImuPlan, Document]:
    """A plan and the document that it was read from; InputError with everything that is wrong, by line."""
    document = read_yaml(source)
    return load_config(document, ImuPlan), document


def load_run_options(source: Path | str | None) -> RunOptions:
    """Options for runs; the usual ones for None. InputError as `load_imu_plan`."""
    return RunOptions() if source is None else load_config(source, RunOptions)


OUTPUTS = {"gyro": tuple(f"rate_{a}" for a in AXES), "accelerometer": tuple(f"acceleration_{a}" for a in AXES)}
"""Channels of the outputs of each triad."""
