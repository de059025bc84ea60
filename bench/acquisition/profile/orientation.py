"""Where the bench stands and how the sensitive axis lies: in the station file, in a profile, or a part in each."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from bench.base import STRICT
from bench.record import Orientation


class OrientationSettings(BaseModel):
    """Orientation of the units; what a profile states takes the place of what the station does."""

    model_config = STRICT

    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """Latitude, north positive."""
    axis: Literal["level", "vertical", "vertical_down"] | None = None
    """How the sensitive axis lies: level, or vertical with its positive end up, or down."""
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    """Azimuth of the positive end of a level axis, clockwise from true north; on a rate table, at its start."""

    @model_validator(mode="after")
    def _consistent(self) -> OrientationSettings:
        if self.azimuth_deg is not None and self.axis in {"vertical", "vertical_down"}:
            raise ValueError("a vertical axis has no azimuth; remove azimuth_deg or make the axis level")
        return self


def latitude(station: OrientationSettings | None, profile: OrientationSettings | None) -> float | None:
    """Latitude of a run [deg]; None where neither states it."""
    return next((one.latitude_deg for one in (profile, station) if one and one.latitude_deg is not None), None)


def stated(
    station: OrientationSettings | None, profile: OrientationSettings | None
) -> tuple[Orientation | None, tuple[str, ...]]:
    """The orientation of a run, None unless it is complete; and the keys that are missing."""
    known: dict[str, object] = {}
    for layer in (station, profile):
        if layer is not None:
            known |= layer.model_dump(exclude_none=True)
    if known.get("axis") != "level":
        known.pop("azimuth_deg", None)
    needed = ("latitude_deg", "axis", *(("azimuth_deg",) if known.get("axis", "level") == "level" else ()))
    missing = tuple(name for name in needed if name not in known)
    return (None, missing) if missing else (Orientation.model_validate(known), ())
