"""The list of all units: number of runs, the last run, and the newest calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from sqlalchemy import func, select

from bench.archive.registry.opening import Registry
from bench.archive.registry.writing import TABLES
from bench.base import IntArray
from bench.record import Verdict

Standing = Literal["pass", "fail", "unjudged", "uncalibrated"]
_STANDINGS: tuple[Standing, ...] = get_args(Standing)
Order = Literal["newest", "oldest", "serial"]

Found = dict[str, Any]


def listing(registry: Registry) -> Listing:
    """All units."""
    unit, run, calibration, certificate = (
        TABLES[name] for name in ("units", "runs", "calibrations", "certificates")
    )  # fmt: skip
    judged = func.coalesce(certificate.c.verdict, calibration.c.judged).label("judged")
    chosen = (
        select(
            run.c.unit, run.c.created, run.c.station, run.c.state, run.c.path, run.c.corrected, calibration.c.model,
            judged, certificate.c.number,
        )
        .join_from(run, calibration, isouter=True)
        .join(certificate, certificate.c.run == run.c.id, isouter=True)
        .order_by(run.c.seen.asc().nulls_first(), run.c.created, run.c.id)
    )  # fmt: skip
    with registry.reading() as connection:
        units = {row.serial: _empty(row.serial, row.lot) for row in connection.execute(select(unit))}
        for row in connection.execute(chosen):
            one = units[row.unit]
            one["runs"] += 1
            one |= {"last": row.created, "last_run": row.path, "state": row.state, "station": row.station}
            if row.model is not None and not row.corrected:  # nothing is fitted to a unit that corrected itself
                one["calibrations"] += 1
                one |= {"calibrated": row.created, "model": row.model, "judged": row.judged}
                one["certificate"] = row.number
    return Listing([units[serial] for serial in sorted(units)])


class Listing:
    """All units by serial number, made for looking: numbers of units (n,) are their places."""

    def __init__(self, units: Sequence[Found]) -> None:
        """Texts that are looked through, how each unit stands, and their order in time."""
        self._units = [tuple(one[key] for key in _KEYS) for one in units]
        self._texts = [f"{one['serial']} {one['lot'] or ''}".casefold() for one in units]
        self._standing = np.array([_STANDINGS.index(_standing(one)) for one in units], dtype=np.int8)
        last = sorted(range(len(units)), key=lambda number: str(units[number]["last"] or ""))
        self._rank = np.empty(len(units), dtype=np.int64)
        self._rank[last] = np.arange(len(units))

    def __len__(self) -> int:
        """Number of units."""
        return len(self._units)

    def holding(self, text: str) -> IntArray:
        """Numbers of the units whose serial number or lot holds every word of `text`."""
        words = text.casefold().split()
        if not words:
            return np.arange(len(self))
        return np.array([n for n, own in enumerate(self._texts) if all(word in own for word in words)], dtype=np.int64)

    def chosen(self, numbers: IntArray, standing: Standing | None, order: Order) -> IntArray:
        """Those with this standing, in this order."""
        if standing is not None:
            numbers = numbers[self._standing[numbers] == _STANDINGS.index(standing)]
        if order == "serial":
            return numbers
        ordered: IntArray = numbers[np.argsort(self._rank[numbers], kind="stable")]
        return ordered[::-1] if order == "newest" else ordered

    def standings(self, numbers: IntArray) -> dict[str, int]:
        """How many of these stand how, without those that are none."""
        counts = np.bincount(self._standing[numbers], minlength=len(_STANDINGS))
        return {name: int(count) for name, count in zip(_STANDINGS, counts, strict=True) if count}

    def line(self, number: int) -> Found:
        """One unit, by key; `standing` comes from the newest calibration."""
        return {**dict(zip(_KEYS, self._units[number], strict=True)), "standing": _STANDINGS[self._standing[number]]}


def _empty(serial: str, lot: str | None) -> Found:
    return {
        "serial": serial, "lot": lot, "runs": 0, "calibrations": 0, "last": None, "last_run": None, "state": None,
        "station": None, "calibrated": None, "model": None, "judged": None, "certificate": None,
    }  # fmt: skip


_KEYS = tuple(_empty("", None))


def _standing(one: Found) -> Standing:
    if one["model"] is None:
        return "uncalibrated"
    if one["judged"] not in set(Verdict) or not Verdict(one["judged"]).judged:
        return "unjudged"
    return "pass" if Verdict(one["judged"]).within else "fail"
