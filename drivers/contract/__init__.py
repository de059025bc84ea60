"""Behaviours that every register map must show on the wire, shipped maps and users' maps alike.

Each behaviour is tested on a new simulated controller that serves the map, through the real driver and a real link.
`bench doctor STATION --contract` does this for the map of a station file; the tests do it for every shipped map, over
each wire, and against an independent Modbus server.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from drivers.contract import commanding, recognising
from drivers.contract.trial import NotApplicable, Served, Trial
from drivers.errors import DriverError
from drivers.register_map import RegisterMap
from drivers.sim.modbus_chamber import ModbusChamber

__all__ = ["BEHAVIOURS", "Outcome", "Served", "try_map"]


@dataclass(frozen=True)
class Outcome:
    """Outcome of one behaviour."""

    behaviour: str
    verdict: Literal["ok", "failed", "not applicable"]
    detail: str = ""


BEHAVIOURS: dict[str, Callable[[Trial], None]] = {
    "identifies the described controller and writes nothing": recognising.identifies,
    "refuses another model": recognising.refuses_another_model,
    "refuses every unit but degC": recognising.refuses_other_units,
    "refuses a wrong word order or an impossible temperature": recognising.refuses_wrong_words,
    "follows the controller's implied decimals": recognising.follows_decimals,
    "reads temperatures and states correctly": recognising.reads_what_is_there,
    "writes its set points, once, and nothing else": commanding.sets_its_set_point,
    "refuses set points outside the limits before anything is sent": commanding.refuses_what_is_outside,
    "ramps natively, or by steps of the host": commanding.ramps,
    "limits writes to a memory that wears out": commanding.spares_its_memory,
    "starts after a set point, stops, and protects its compressor": commanding.starts_and_stops,
    "shows every alarm and clears none": recognising.shows_alarms,
    "shows a broken sensor": recognising.shows_a_broken_sensor,
    "shows its door": recognising.shows_its_door,
    "detects set points and switches changed by others": commanding.notices_other_hands,
    "reaches the safe state": commanding.reaches_the_safe_state,
}


def try_map(registers: RegisterMap, serve: Callable[[RegisterMap], Served] = ModbusChamber) -> list[Outcome]:
    """Test every behaviour of `registers`, each on a new controller that `serve` makes."""
    return [_try(name, behaviour, registers, serve) for name, behaviour in BEHAVIOURS.items()]


def _try(
    name: str, behaviour: Callable[[Trial], None], registers: RegisterMap, serve: Callable[[RegisterMap], Served]
) -> Outcome:
    served = serve(registers)
    trial = Trial(registers, served)
    try:
        behaviour(trial)
    except NotApplicable as reason:
        return Outcome(name, "not applicable", str(reason))
    except (AssertionError, DriverError) as error:
        return Outcome(name, "failed", str(error))
    finally:
        trial.link.close()
        served.close()
    return Outcome(name, "ok")
