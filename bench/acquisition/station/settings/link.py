"""What the silence of a device means."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from bench.base import STRICT


class LinkSettings(BaseModel):
    """What silence of a device means, and what to do when it answers again."""

    model_config = STRICT

    degraded_after_s: Annotated[float, Field(gt=0, le=3600)] = 10.0
    """Silent for this long: degraded; the run goes on, what it did not say is missing in the data."""
    lost_after_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    """Silent for this long: lost; the run ends, through the safe state."""
    retry_most_s: Annotated[float, Field(ge=1, le=600)] = 10.0
    """Longest time between two attempts to reach it; the first come after 1, 2, 4, … s."""
    on_return: Literal["continue", "abort"] = "continue"
    """When a degraded device answers again, is the one described and does what we told it: go on, or end the run."""

    @model_validator(mode="after")
    def _ordered(self) -> LinkSettings:
        if self.degraded_after_s >= self.lost_after_s:
            text = f"degraded_after_s ({self.degraded_after_s:g}) must be below lost_after_s ({self.lost_after_s:g})"
            raise ValueError(text)
        return self
