"""The notification file: who is told that a run ended, tripped or holds. Its URLs hold passwords: nothing copies it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from bench.base import STRICT, PlacedError

Kind = Literal["end", "trip", "hold", "calibration"]
Text = Annotated[str, Field(min_length=1)]


class Recipient(BaseModel):
    """One address."""

    model_config = STRICT

    name: Annotated[str, Field(min_length=1, max_length=80)]
    """What events and messages call it; the URL is never shown."""
    url: Text
    """URL of a service of the library apprise, such as `mailtos://…`, `jsons://…` (a webhook), `dbus://` (desktop)."""
    when: Annotated[tuple[Kind, ...], Field(min_length=1)] = ("end", "trip", "hold", "calibration")
    """What it is told: the end of a run, a guard that ends one (`trip`), a hold, a calibration that ended or waits for
    somebody."""


class NotifyFile(BaseModel):
    """Who is told what happens on a station while nobody stands beside it."""

    model_config = STRICT

    recipients: Annotated[tuple[Recipient, ...], Field(min_length=1)]
    """Everybody who is told."""

    @model_validator(mode="after")
    def _apart(self) -> NotifyFile:
        names = [recipient.name for recipient in self.recipients]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise PlacedError(f"{name!r} stands twice; events could not tell them apart", ("recipients", i, "name"))
        return self
