"""Which runs are compared: of a station, lot and time, of one profile, whole, of units that did not correct themselves,
real or simulated.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, select

from bench.archive.fleet.groups import ObjectArray
from bench.archive.registry.writing import TABLES
from bench.base import IntArray

IMPORT = "import"
UNKNOWN, ONE = "unknown", "no lot"
"""The station, and the lot, of runs that name none."""
NO_LOT = re.compile(r"^(.*?)[-_. ]?\d+$")
"""The lot of a unit without a recorded lot is its serial without the number at the end."""
COMPARED = ("unit", "lot", "station", "created", "profile", "state", "cause", "simulated", "corrected")
"""Columns of a run that a selection looks at."""
Row = Mapping[str, Any]
_FIRST, _LAST = (moment.replace(tzinfo=UTC) for moment in (datetime.min, datetime.max))


@dataclass(frozen=True)
class Selection:
    """A `profile`, or None for the one that most units have run; imported records are of the profile `import`."""

    profile: str | None = None
    station: str | None = None
    lot: str | None = None
    since: datetime | None = None
    until: datetime | None = None
    """First moment, and the one before which they began."""
    simulated: bool | None = None
    """Simulated runs alone, or none of them; None: they count only where there are no others."""

    def among(self) -> list[ColumnElement[bool]]:
        """Conditions on runs and units of the registry that leave out most of what `of` leaves out, and nothing else.

        The database has an index for each; those of the lot and of the days are wider than the selection.
        """
        run, unit = TABLES["runs"].c, TABLES["units"].c
        found: list[ColumnElement[bool]] = []
        if self.station is not None:
            nameless = run.station.is_(None) | (run.station == "")
            found.append(
                (run.station == self.station) | nameless if self.station == UNKNOWN else run.station == self.station
            )
        if self.lot is not None:
            beginning = unit.serial.startswith("" if self.lot == ONE else self.lot, autoescape=True)
            unnamed = select(unit.serial).where(unit.lot.is_(None) | (unit.lot == ""), beginning)
            found.append(run.unit.in_(select(unit.serial).where(unit.lot == self.lot).union(unnamed)))
        # A time in another zone may be of the day before or after, here and in the registry.
        if self.since:
            found.append(run.created >= _day_of(self.since, -2))
        if self.until:
            found.append(run.created < _day_of(self.until, 3))
        return found

    def of(self, runs: Sequence[Row]) -> tuple[list[Row], tuple[str, ...]]:
        """The runs that may stand in one figure, in their order, and what was left out, in words.

        Each has the columns of the registry's runs.
        """
        columns = {name: np.array([run[name] for run in runs], dtype=object) for name in COMPARED}
        columns["lot"] = np.array([lot_of(run["unit"], run["lot"]) for run in runs], dtype=object)
        columns["station"] = np.array([run["station"] or UNKNOWN for run in runs], dtype=object)
        kept, left = self.kept(columns)
        return [runs[i] for i in kept.tolist()], left

    def kept(self, runs: Mapping[str, ObjectArray]) -> tuple[IntArray, tuple[str, ...]]:
        """The same of columns (n,): the places of the runs."""
        left: list[str] = []
        found = np.arange(len(runs["unit"]))

        def keep(wanted: Any, words: str) -> None:
            nonlocal found
            kept = found[np.asarray(wanted, dtype=bool)]
            if kept.size < found.size:
                left.append(f"{found.size - kept.size} {words}")
            found = kept

        if self.station is not None:
            keep(runs["station"][found] == self.station, "of other stations")
        if self.lot is not None:
            keep(runs["lot"][found] == self.lot, "of other lots")
        if self.since or self.until:
            first, end = self.since or _FIRST, self.until or _LAST
            began = [datetime.fromisoformat(str(created)).astimezone(UTC) for created in runs["created"][found]]
            keep([first <= one < end for one in began], "of other days")
        keep(runs["state"][found] == "done", "that did not end as planned")
        keep(~runs["corrected"][found].astype(bool), "of units that corrected themselves")
        simulated = runs["simulated"][found].astype(bool)
        if self.simulated:
            keep(simulated, "not simulated")
        elif self.simulated is False or np.equal(runs["simulated"][found], False).any():
            keep(~simulated, "simulated")
        profiles = profile_of(runs["cause"][found], runs["profile"][found])
        pairs = zip(profiles.tolist(), runs["unit"][found].tolist(), strict=True)
        several = len(set(profiles.tolist())) > 1
        units = Counter(name for name, _ in (dict.fromkeys(pairs) if several else itertools.islice(pairs, 1)))
        profile = self.profile or max(units, key=units.__getitem__, default=None)
        others = ", ".join(sorted(str(name) for name in units if name != profile))
        keep(profiles == profile, f"of other profiles ({others}; --profile)")
        return found, tuple(left)


def lot_of(unit: str, recorded: str | None) -> str:
    """The lot of a unit: the recorded one, else its serial number without the digits at the end."""
    if recorded:
        return recorded
    match = NO_LOT.match(unit)
    return (match[1] if match else "") or ONE


def _day_of(moment: datetime, later: int) -> str:
    """Day so many days after a moment, as times of the registry begin."""
    day = moment.toordinal() + later
    return date.fromordinal(min(max(day, 1), date.max.toordinal())).isoformat()


def profile_of(cause: Any, profile: Any) -> ObjectArray:
    """What was run, of one run or of many (n,); the names of imported tables tell nothing of it."""
    return np.where(np.asarray(cause, dtype=object) == "imported", IMPORT, np.asarray(profile, dtype=object))
