"""The section of the station file on the fixture that holds the units in their attitudes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from bench.acquisition.profile.segments import Attitudes, names_of
from bench.base import STRICT


class FixtureSettings(BaseModel):
    """A fixture that people turn when the run asks them to."""

    model_config = STRICT

    attitudes: Attitudes
    """What it can hold the units in: the attitudes of a tumble of 6, 12 or 24 positions, or a list of names."""
    operator: Literal["asked", "simulated"] = "asked"
    """Who turns it: people, who are asked and confirm; or nobody, on a simulated station that runs unattended."""
    takes_s: Annotated[float, Field(ge=1.0, le=86_400.0)] = 60.0
    """Time that one change takes; of expected durations, and of the simulated operator."""
    forgets: tuple[Annotated[int, Field(ge=1)], ...] = ()
    """Changes, counted from 1, that the simulated operator first confirms without having turned anything."""

    @property
    def names(self) -> tuple[str, ...]:
        """Its attitudes, written out."""
        return names_of(self.attitudes)
