"""The plan of a calibration: what is run, fitted and delivered, against which limits, and what doubt leads to."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from bench.base import STRICT

Action = Literal["ship", "hold", "stop"]
Text = Annotated[str, Field(min_length=1)]


class Policy(BaseModel):
    """What a doubt leads to: `ship` goes on and says it, `hold` waits for a person (`--release`), `stop` ends it."""

    model_config = STRICT

    marginal: Action = "hold"
    """The verdict against the limits is MARGINAL."""
    missing_effect: Action = "hold"
    """The diagnosis names an effect that the delivered model lacks."""
    unknown_effect: Action = "hold"
    """Something is left that no effect of the library explains."""
    undecided: Action = "hold"
    """An effect is suspected and not proved, or a slow cause cannot be told from the noise."""
    tie: Action = "hold"
    """Several effects explain these data equally well, and one of them is in the model or missing."""
    undiagnosed: Action = "hold"
    """No diagnosis could be made."""


class Plan(BaseModel):
    """How units of one kind are calibrated. Paths are relative to the plan's file."""

    model_config = STRICT

    name: Text
    """Name of the plan, as it stands in job files."""
    description: str = ""
    """What it is for."""
    profile: Text
    """Profile of the calibration run."""
    verification: Text
    """Profile of the verification run, with the unit's own correction on; another one than `profile`."""
    static: Text | None = None
    """Profile of an isothermal run before the calibration: the noise is read from it. Left out: from the soaks."""
    models: tuple[Text, ...] = ()
    """Models, by name or file; what has the least error on unseen data is delivered."""
    imu: Literal[True] | Text | None = None
    """Instead of `models`, of an inertial unit: all its axes are fitted from the attitudes of the profile. True, or the
    file with options of that fit (`bench imu --plan`)."""
    improve: bool = False
    """Effects that the diagnosis finds missing in the first model are added where held-out data prove them."""
    limits: Text
    """Limits file; its verdict is the job's."""
    form: Literal["float32", "fixed", "split", "split_fixed"] | None = None
    """Embedded form; left out: the one with the least error."""
    laboratory: Text | None = None
    """Laboratory file of the certificate; left out: that of the station."""
    equipment: Text | None = None
    """Reference equipment; overdue equipment blocks the job. Left out: that of the station."""
    certificate: bool = True
    """Make a certificate at the end."""
    interrupted: Literal["resume", "repeat"] = "resume"
    """A run that was cut off goes on from there, as with `bench resume`; or is done again whole."""
    policy: Policy = Policy()
    """What doubts lead to."""

    @model_validator(mode="after")
    def _fitted(self) -> Plan:
        if bool(self.models) == bool(self.imu):
            raise ValueError("name `models`, or state `imu: true` for an inertial unit")
        return self
