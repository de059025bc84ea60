"""Which runs are compared: of a station, lot and time, of one profile, whole, of units that did not correct themselves,
real or simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Any

from sqlalchemy import ColumnElement, select

from bench.archive.registry.writing import TABLES

IMPORT = "import"
UNKNOWN, ONE = "unknown", "one"
"""The station, and the lot, of runs that name none."""
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Selection:
    """A `profile`, or None for the one that most units have run; imported records are of the profile `import`."""

    profile: str | None = None
    station: str | None = None
    lot: str | None = None
    since: date | None = None
    until: date | None = None
    """First and last day (UTC)."""

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
        # A time in another zone may be of the day before or after.
        if self.since:
            found.append(run.created >= (self.since - timedelta(days=1)).isoformat())
        if self.until:
            found.append(run.created < (self.until + timedelta(days=2)).isoformat())
        return found

    def of(self, runs: Sequence[Row]) -> tuple[list[Row], tuple[str, ...]]:
        """The runs that may stand in one figure, in their order, and what was left out, in words.

        Each has the columns of the registry's runs. Simulated runs count only where there are no others.
        """
        left: list[str] = []

        def keep(found: list[Row], wanted: Callable[[Row], bool], words: str) -> list[Row]:
            kept = [run for run in found if wanted(run)]
            if len(kept) < len(found):
                left.append(f"{len(found) - len(kept)} {words}")
            return kept

        found = list(runs)
        if self.station is not None:
            found = keep(found, lambda run: run["station"] == self.station, "of other stations")
        if self.lot is not None:
            found = keep(found, lambda run: run["lot"] == self.lot, "of other lots")
        if self.since or self.until:
            first, last = self.since or date.min, self.until or date.max
            found = keep(found, lambda run: first <= day_of(run) <= last, "of other days")
        found = keep(found, lambda run: run["state"] == "done", "that did not end as planned")
        found = keep(found, lambda run: not run["corrected"], "of units that corrected themselves")
        if any(run["simulated"] is False for run in found):
            found = keep(found, lambda run: not run["simulated"], "simulated")
        units: dict[Any, set[str]] = {}
        for run in found:
            units.setdefault(profile_of(run), set()).add(run["unit"])
        profile = self.profile or max(units, key=lambda name: len(units[name]), default=None)
        others = ", ".join(sorted(str(name) for name in units if name != profile))
        found = keep(found, lambda run: profile_of(run) == profile, f"of other profiles ({others}; --profile)")
        return found, tuple(left)


def day_of(run: Row) -> date:
    """Day on which it began (UTC)."""
    return datetime.fromisoformat(str(run["created"])).astimezone(UTC).date()


def profile_of(run: Row) -> Any:
    """What was run; the names of imported tables tell nothing of it."""
    return IMPORT if run["cause"] == "imported" else run["profile"]
