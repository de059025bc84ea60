"""The list of all units: a page of it, and how many units stand how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import func, select

from bench.archive.registry.opening import Registry
from bench.archive.registry.summaries import SUMMARIES

Standing = Literal["pass", "fail", "unjudged", "uncalibrated"]
Order = Literal["newest", "oldest", "serial"]


@dataclass(frozen=True)
class Page:
    """Part of the list: `total` units are known, `matched` are listed, of which these are `units`.

    `standings`: how many of those that hold the text stand how.
    """

    total: int
    matched: int
    standings: dict[str, int]
    units: list[dict[str, Any]]


def listing(
    registry: Registry, text: str, standing: Standing | None, order: Order, limit: int, offset: int
) -> Page:  # fmt: skip
    """Units whose serial number or lot holds every word of `text`, and that stand like this."""
    one = SUMMARIES.c
    held = [one.words.contains(word, autoescape=True) for word in text.casefold().split()]
    count = func.count()
    places = {
        "newest": (one.last.desc().nulls_last(), one.serial.desc()),
        "oldest": (one.last.asc().nulls_first(), one.serial),
        "serial": (one.serial,),
    }
    chosen = select(one.serial).where(*held).order_by(*places[order]).limit(limit).offset(offset)
    if standing is not None:
        chosen = chosen.where(one.standing == standing)
    with registry.reading() as connection:
        counts = connection.execute(select(one.standing, count).where(*held).group_by(one.standing))
        standings = {str(name): int(number) for name, number in counts}
        total = connection.execute(select(count).select_from(SUMMARIES)).scalar_one() if held else None
        serials = list(connection.execute(chosen).scalars())
        rows = connection.execute(select(SUMMARIES).where(one.serial.in_(serials))).mappings()
        known = {row["serial"]: dict(row) for row in rows}
    everyone = sum(standings.values())
    matched = everyone if standing is None else standings.get(standing, 0)
    return Page(everyone if total is None else total, matched, standings, [known[serial] for serial in serials])
