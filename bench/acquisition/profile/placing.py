"""What a check says about attitudes: those that the station has not, and how often people have to turn the fixture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from bench.acquisition.profile.legs import Leg

_AWAY_DEGC = 10.0


@dataclass(frozen=True)
class Reach:
    """What a station's fixture can do."""

    attitudes: tuple[str, ...]
    takes_s: float
    driven: str = ""
    """What turns it, for people; empty: people do."""


def changes(legs: Sequence[Leg]) -> list[Leg]:
    """Legs before which the units are brought into another attitude."""
    found: list[Leg] = []
    for leg in legs:
        if leg.attitude is not None and (not found or leg.attitude != found[-1].attitude):
            found.append(leg)
    return found


def attitude_findings(
    legs: Sequence[Leg], reach: Reach | None, ambient_degc: float, latitude_known: bool
) -> Iterator[tuple[Literal["error", "warning", "info"], str, Leg]]:
    """Level, text and leg of each."""
    turned = changes(legs)
    if not turned:
        return
    first = turned[0]
    if reach is None:
        text = f"{first.name}: attitude {first.attitude}, but the station has no fixture; name one with `fixture`"
        yield "error", text, first
        return
    missing = {leg.attitude: leg for leg in reversed(turned) if leg.attitude not in reach.attitudes}
    for name, leg in missing.items():
        text = f"{leg.name}: the station's fixture does not reach {name}; it has {', '.join(reach.attitudes)}"
        yield "error", text, leg
    each = len({leg.attitude for leg in turned})
    who = reach.driven or "the operator"
    text = f"{len(turned)} changes of position by {who} ({each} attitudes), {reach.takes_s:g} s each"
    yield "info", f"{text}; the chamber holds meanwhile, until each is confirmed", first
    away = [leg for leg in turned if abs(leg.from_degc - ambient_degc) > _AWAY_DEGC]
    if away and not reach.driven:
        text = (
            f"{len(away)} of the changes of position are more than {_AWAY_DEGC:g} degC from ambient: turn the fixture"
        )
        yield "info", f"{text} from outside, an open door ends the run", away[0]
    if not latitude_known:
        text = "`orientation` of station or profile states no latitude_deg: `bench imu` needs it in a plan"
        yield "warning", text, first
