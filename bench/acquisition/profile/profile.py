"""Temperature profiles: a YAML file, and the legs that the sequencer executes.

A ramp asks the chamber for a rate and ends when the chamber has arrived; a soak keeps the set point; a step jumps,
settles and is averaged; a rate turns the rate table at a standing temperature; a tumble takes the unit through several
attitudes; a power cycle switches the units off and on; a repeat repeats. Times are nominal: the chamber may need longer
and the legs wait for it.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field, PrivateAttr, model_validator

from bench.acquisition.profile.guards import GuardSettings
from bench.acquisition.profile.legs import Leg, LegBuilder
from bench.acquisition.profile.orientation import OrientationSettings
from bench.acquisition.profile.segments import Name, Rates, Segment, SettleRule, Start
from bench.base import STRICT, BenchError, Document, FloatArray, library, load_config, parse_yaml, read_text, read_yaml

_USERS = Path("profiles")
"""The user's own profiles (`bench init`), in the folder in which the bench is started."""

__all__ = ["Profile", "SettleRule", "from_document", "load_profile", "profile_from_text", "taken_name"]


class Until(BaseModel):
    """When a run may end before the profile does: every ten minutes its units are compared with those of their lot."""

    model_config = STRICT

    error_dph: Annotated[float, Field(gt=0, le=1e6)]
    """Largest error of the calibration [deg/h RMS] over the lot's whole run, upper end of the 95 % interval."""
    lot: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """Lot that this rests on: `LOT-7` for its newest calibration where the run goes to, or `LOT-7/RUN` for one of them;
    `bench run --lot FOLDER` names another one. Left out, and without --lot: the run goes to its end."""
    audit_every: Annotated[int, Field(ge=0, le=1000)] = 10
    """Every so many runs of the lot one goes the whole way all the same, to check what is stated; 0: none."""


class Profile(BaseModel):
    """A temperature profile: what the chamber and the rate table do, in order."""

    model_config = STRICT

    name: Name
    description: str = ""
    """What the profile is for."""
    start: Start | None = None
    """Left out: the first segment starts where the chamber stands."""
    rates: Rates | None = None
    """Fastest ramps."""
    settle: SettleRule = SettleRule()
    """What settled means."""
    guards: tuple[GuardSettings, ...] = ()
    """Interlocks of this profile, beside the station's."""
    orientation: OrientationSettings | None = None
    """How the sensitive axis lies, where it differs from what the station says."""
    until: Until | None = None
    """When it may end earlier; without a lot it goes to its end."""
    segments: Annotated[tuple[Segment, ...], Field(min_length=1)]
    """What to do, in order."""

    _legs: tuple[Leg, ...] = PrivateAttr(())
    _file: str | None = PrivateAttr(None)
    _line: int | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _flatten(self) -> Profile:
        self._legs = LegBuilder(self).legs()
        return self

    def legs(self) -> tuple[Leg, ...]:
        """What the sequencer executes, in order."""
        return self._legs

    @property
    def file(self) -> str | None:
        """File that it was read from."""
        return self._file

    @property
    def line(self) -> int | None:
        """Line of its name in that file."""
        return self._line

    @property
    def duration_s(self) -> float:
        """Nominal duration [s]: without the time that the chamber needs beyond its set point."""
        return self._legs[-1].nominal_end_s

    def setpoint(self, t_s: float | FloatArray) -> FloatArray:
        """Nominal set point [degC] at times since the start [s]; before and after it, its first and last value."""
        times, temperatures = self.corners()
        return np.asarray(np.interp(t_s, times, temperatures), dtype=np.float64)

    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Times [s] and temperatures [degC] between which the nominal set point moves in straight lines."""
        first = self._legs[0]
        times, temperatures = [0.0], [first.from_degc]
        for leg in self._legs:
            for time, temperature in ((leg.nominal_start_s + leg.move_s, leg.target_degc),
                                      (leg.nominal_end_s, leg.target_degc)):  # fmt: skip
                if time > times[-1]:
                    times.append(time)
                    temperatures.append(temperature)
        return np.array(times), np.array(temperatures)


def load_profile(source: Path | str | Document) -> Profile:
    """Profile from its file, or from one that was read; InputError with everything that is wrong, by line."""
    return from_document(source if isinstance(source, Document) else read_yaml(source))


def profile_from_text(text: str, file: str = "profile") -> Profile:
    """Profile from YAML text; `file` is named in errors."""
    return from_document(parse_yaml(text, file))


def from_document(document: Document) -> Profile:
    """Profile from a parsed file; its legs know their lines."""
    profile = load_config(document, Profile)
    profile._file, profile._line = document.file, document.line(("name",))
    profile._legs = LegBuilder(profile, document.line).legs()
    return profile


def taken_name(profile: Profile) -> str:
    """What is wrong with the name of another profile, shipped or own, on this one; empty where there is none."""
    own = Path(profile.file or "")
    for folder, who in ((library(), "a shipped profile"), (own.parent, "{}"), (_USERS, f"{_USERS}/{{}}")):
        for file in sorted(folder.glob("*.yaml")):
            if file.resolve() != own.resolve() and _differs(file, profile):
                text = f"the name '{profile.name}' is taken by {who.format(file.name)} of other content; histories and "
                return f"{text}fleet would mix their runs; give this one a name of its own"
    return ""


def _differs(file: Path, profile: Profile) -> bool:
    """Whether a file is a profile of the same name and of other content."""
    with suppress(BenchError):  # of another kind, or damaged
        if profile.name in (text := read_text(file)):
            other = profile_from_text(text, str(file))
            return other.name == profile.name and other.model_dump() != profile.model_dump()
    return False
