"""What a calibration certificate of an instrument states: uncertainties with their distribution, drift, correlation."""

from __future__ import annotations

from datetime import date
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator

from bench.base import STRICT

Unit = Literal["degC", "ppm", "deg"]
Distribution = Literal["normal", "rectangular", "triangular", "arcsine"]
DIVISORS: dict[str, float] = {
    "rectangular": float(np.sqrt(3.0)), "triangular": float(np.sqrt(6.0)), "arcsine": float(np.sqrt(2.0)),
}  # fmt: skip
"""Half-width over standard deviation (JCGM 100, 4.3.7 to 4.3.9; JCGM 101, 6.4)."""
_DAYS = 365.25


class Stated(BaseModel):
    """One uncertainty of an instrument: of its temperature [degC], its scale or frequency [ppm], an angle [deg]."""

    model_config = STRICT

    value: float = Field(gt=0)
    """Expanded uncertainty of a normal distribution; half-width of the others."""
    unit: Unit
    """Unit of the value."""
    k: float = Field(default=2.0, ge=1)
    """Coverage factor of a normal distribution's value."""
    distribution: Distribution = "normal"
    """Its distribution."""
    degrees_of_freedom: float | None = Field(default=None, ge=1)
    """Degrees of freedom; without them they count as infinite."""
    drift_per_year: float = Field(default=0.0, ge=0)
    """Largest change in a year since the calibration, in the same unit."""

    @property
    def standard(self) -> float:
        """Standard uncertainty without drift [own unit]."""
        return self.value / (self.k if self.distribution == "normal" else DIVISORS[self.distribution])

    def drifted(self, calibrated: date | None, on: date) -> float:
        """Standard uncertainty of the drift up to a day [own unit]: rectangular; a year where the day is unknown."""
        years = 1.0 if calibrated is None else max((on - calibrated).days, 0) / _DAYS
        return self.drift_per_year * years / DIVISORS["rectangular"]


class Correlation(BaseModel):
    """That two instruments were calibrated with the same standard, so that their errors go together."""

    model_config = STRICT

    serial: str
    """Serial number of the other instrument."""
    coefficient: float = Field(ge=-1, le=1)
    """Correlation coefficient of their errors."""


class Uncertain(BaseModel):
    """The part of an instrument that the budget uses."""

    model_config = STRICT

    name: str
    """Kind of instrument: `chamber sensor`, `rate table`, `time base`."""

    uncertainty: tuple[Stated, ...] = ()
    """What its certificate states; an instrument may have one in each unit."""
    correlated_with: tuple[Correlation, ...] = ()
    """Instruments whose errors go with those of this one."""

    @property
    def turns(self) -> bool:
        """Whether it is a rate table, by its name."""
        return "table" in self.name.lower()

    @model_validator(mode="after")
    def _once(self) -> Uncertain:
        units = [stated.unit for stated in self.uncertainty]
        if len(set(units)) < len(units):
            raise ValueError("uncertainty: each unit may occur once")
        if self.correlated_with and any(stated.degrees_of_freedom for stated in self.uncertainty):
            raise ValueError("correlated_with: leave out degrees_of_freedom, which correlated errors cannot have")
        return self
