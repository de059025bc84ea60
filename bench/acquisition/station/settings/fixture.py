"""The section of the station file on the fixture that holds the units in their attitudes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from bench.acquisition.profile.segments import AttitudeName, Attitudes, names_of
from bench.acquisition.station.settings.axes import AxisSettings, Positions, positions
from bench.base import STRICT, PlacedError
from bench.record import ATTITUDES


class FixtureSettings(BaseModel):
    """A fixture that people, a program of the laboratory, or drives turn when the run asks for it."""

    model_config = STRICT

    attitudes: Attitudes
    """What it can hold the units in: the attitudes of a tumble of 6, 12 or 24 positions, or a list of names. Of a
    tumble, driven axes offer those that they reach."""
    operator: Literal["asked", "simulated"] = "asked"
    """Who turns it: people, who are asked and confirm; or nobody, on a simulated station that runs unattended."""
    takes_s: Annotated[float, Field(ge=1.0, le=86_400.0)] = 60.0
    """Time that one change takes; of expected durations, and of the simulated operator."""
    turn: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Program and arguments that bring the fixture into an attitude and end with exit code 0 when it stands:
    `{attitude}` is its name, `{matrix}` its nine numbers, row by row, from the table's frame to the unit's axes. Left
    out: people turn it; they are asked, too, where the program fails."""
    timeout_s: Annotated[float, Field(gt=0, le=86_400)] = 600.0
    """Longest time that the program may take [s]."""
    folder: Annotated[str, Field(min_length=1)] | None = None
    """Where the program is started, relative to the station file; left out: the folder of the station file."""
    axes: Annotated[tuple[AxisSettings, ...], Field(max_length=3)] = ()
    """Two or three driven axes, from the rate table to the units; left out: it has none."""
    zero: AttitudeName = "z_up"
    """Attitude of the units with all axes at 0."""
    forgets: tuple[Annotated[int, Field(ge=1)], ...] = ()
    """Changes, counted from 1, that the simulated operator first confirms without having turned anything."""

    @model_validator(mode="after")
    def _program_is_whole(self) -> FixtureSettings:
        if self.turn and self.operator == "simulated":
            raise PlacedError("a simulated operator turns by himself; remove `turn` or `operator`", ("turn",))
        for place in re.findall(r"\{(\w*)\}", " ".join(self.turn)):
            if place not in {"attitude", "matrix"}:
                raise PlacedError(f"{{{place}}} is not known here; allowed: {{attitude}}, {{matrix}}", ("turn",))
        return self

    @model_validator(mode="after")
    def _axes_reach(self) -> FixtureSettings:
        if not self.axes:
            return self
        if len(self.axes) == 1:
            raise PlacedError("one axis is not enough: name two or three", ("axes",))
        if self.turn or self.operator == "simulated":
            raise PlacedError("driven axes turn by themselves; remove `turn` and `operator`", ("axes",))
        reached = self.names
        if not reached:
            raise PlacedError(f"the axes reach none of the attitudes from {self.zero}; look at `about`", ("axes",))
        if not isinstance(self.attitudes, int):
            for i, name in enumerate(self.attitudes):
                if name not in reached:
                    raise PlacedError(f"the axes do not reach {name}; remove it, or look at `about` and the ranges",
                                      ("attitudes", i))  # fmt: skip
        return self

    def position(self, attitude: str) -> Positions | None:
        """Where the driven axes hold an attitude; None: they do not reach it."""
        return positions(self.axes, ATTITUDES[self.zero], ATTITUDES[attitude])

    def beside(self, folder: Path) -> FixtureSettings:
        """The same with a program that is started in the folder of the station file, or relative to it."""
        return self.model_copy(update={"folder": str((folder / (self.folder or "")).absolute())})

    @property
    def driven(self) -> str:
        """What turns it, for people; empty: people do."""
        return "the fixture's drives" if self.axes else "the fixture's program" if self.turn else ""

    @property
    def names(self) -> tuple[str, ...]:
        """Its attitudes, written out."""
        stated = names_of(self.attitudes)
        return tuple(name for name in stated if self.position(name) is not None) if self.axes else stated
