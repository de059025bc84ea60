"""The sections of the station file on its safe state and its watchdog."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from bench.base import STRICT


class SafeStateSettings(BaseModel):
    """How the safe state is reached: set point to ambient, warmed up where it is cold, then off."""

    model_config = STRICT

    near_degc: Annotated[float, Field(gt=0, le=50)] = 5.0
    """Colder than ambient by more than this: warmed up before it is switched off, so that nothing frosts."""
    warm_up_min: Annotated[float, Field(ge=0, le=600)] = 60.0
    """Longest time for that; 0: never wait."""
    step_s: Annotated[float, Field(gt=0, le=600)] = 10.0
    """Longest time of each step."""
    retry_min: Annotated[float, Field(ge=0, le=600)] = 2.0
    """A chamber that does not answer is tried again for this long."""


class WatchdogSettings(BaseModel):
    """The process that makes a real station safe when the bench is killed or hangs."""

    model_config = STRICT

    silent_s: Annotated[float, Field(ge=1, le=3600)] = 60.0
    """A bench that is silent for longer hangs: it is killed, and the equipment made safe without it."""
    retry_min: Annotated[float, Field(ge=0, le=1440)] = 30.0
    """A chamber that does not answer is tried again for this long."""
