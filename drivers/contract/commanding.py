"""Behaviours under command: set points, ramps, on and off, changes by others, the safe state."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.contract.trial import LIMITS, NotApplicable, Trial, check
from drivers.controller import WEAR_WRITES
from drivers.errors import ConfigError, LimitError


def sets_its_set_point(trial: Trial) -> None:
    """Writes the set point and its copies, and no other register."""
    trial.chamber.identify()
    before = trial.image()
    trial.chamber.set_point(-20.5)
    ours = {"setpoint", *trial.map.setpoint_copies}
    check(all(trial.value(name) == -20.5 for name in ours), "the set point did not arrive")
    check(trial.chamber.poll().setpoint == -20.5, "the set point does not read back")
    check(_changed(trial, before) <= ours | set(_ramp_off(trial)), f"also changed: {_changed(trial, before) - ours}")
    count = trial.chamber.writes
    trial.chamber.set_point(-20.5)
    check(trial.chamber.writes == count, "an unchanged set point was written again")


def refuses_what_is_outside(trial: Trial) -> None:
    """A value outside the limits is neither sent nor clipped."""
    trial.chamber.identify()
    before = trial.image()
    for degc in (LIMITS[0] - 1.0, LIMITS[1] + 1.0, float("nan")):
        trial.refused(LimitError, lambda target=degc: trial.chamber.set_point(target), f"{degc:g} degC")  # type: ignore[misc]
    check(trial.image() == before, "something was sent")


def ramps(trial: Trial) -> None:
    """Ramps natively, or by many small steps of the host."""
    trial.chamber.identify()
    trial.chamber.set_point(20.0)
    ramp = trial.map.ramp
    if ramp is None:
        trial.refused(ConfigError, lambda: trial.chamber.ramp_to(60.0, 1.0), "a ramp that the controller does not have")
        for step in range(60):
            trial.chamber.set_point(20.0 + step * 0.5)
        check(trial.value("setpoint") == 49.5, "host steps did not arrive")
        return
    trial.refused(LimitError, lambda: trial.chamber.ramp_to(60.0, 0.0), "a ramp of 0 degC/min")
    trial.chamber.ramp_to(60.0, 2.0)
    check(trial.value(ramp.rate) == 2.0 and trial.value("setpoint") == 60.0, "rate or target did not arrive")
    check(all(trial.value(name) == value for name, value in ramp.on.items()), "the ramp is not on")
    trial.chamber.set_point(30.0)
    check(all(trial.value(name) == value for name, value in ramp.off.items()), "a set point leaves the ramp on")


def spares_its_memory(trial: Trial) -> None:
    """Steps of the host are refused; the safe state is not."""
    if trial.map.eeprom_writes is None:
        raise NotApplicable("no limit on writes")
    trial.chamber.identify()

    def step_from_the_host() -> None:
        for step in range(WEAR_WRITES + 2):
            trial.clock.sleep_until(trial.clock.now() + 1.0)
            trial.chamber.set_point(float(step))

    trial.refused(LimitError, step_from_the_host, "a ramp stepped by the host")
    check(trial.chamber.writes <= WEAR_WRITES, f"{trial.chamber.writes} writes")
    check(all(step.ok for step in trial.chamber.safe(25.0)), "the limit on writes prevented the safe state")


def starts_and_stops(trial: Trial) -> None:
    """Does not start before a set point, and does not change neighbouring bits."""
    trial.chamber.identify()
    trial.refused(LimitError, trial.chamber.start, "a start before any set point")
    trial.chamber.set_point(30.0)
    register = trial.map[trial.map.run.register]
    neighbours = 0 if register.mask is None else 0xFFFF & ~register.mask
    before = trial.served.words(register.name)[0] & neighbours
    trial.chamber.start()
    check(trial.chamber.poll().on, "it does not read on")
    check(trial.served.words(register.name)[0] & neighbours == before, "the other bits of its word changed")
    trial.chamber.stop()
    check(not trial.chamber.poll().on, "it does not read off")
    off_s = trial.clock.now()
    trial.chamber.start()
    check(trial.clock.now() - off_s >= trial.map.run.least_off_s, "it was started too soon for its compressor")


def notices_other_hands(trial: Trial) -> None:
    """Detects a set point or a switch that was changed by others."""
    trial.chamber.identify()
    trial.chamber.set_point(30.0)
    trial.chamber.start()
    check(not trial.chamber.deviations(), f"deviates from itself: {trial.chamber.deviations()}")
    for name in ("setpoint", *trial.map.setpoint_copies):
        trial.put(name, 60.0)
        check(any(text.startswith(name) for text in trial.chamber.deviations()), f"a changed {name} was not detected")
        trial.put(name, 30.0)
    trial.put(trial.map.run.state, trial.map.run.off)
    check(len(trial.chamber.deviations()) == 1, "switching off at the panel was not detected")


def reaches_the_safe_state(trial: Trial) -> None:
    """Goes to ambient first, then off; both are read back."""
    trial.chamber.identify()
    trial.chamber.set_point(80.0)
    trial.chamber.start()
    if trial.map.native_ramp:
        trial.chamber.ramp_to(-20.0, 2.0)
    steps = trial.chamber.safe(25.0)
    check(all(step.ok for step in steps), f"{[step for step in steps if not step.ok]}")
    ours = ("setpoint", *trial.map.setpoint_copies)
    check(all(trial.value(name) == 25.0 for name in ours), "the set point is not ambient")
    check(not trial.chamber.poll().on, "it is still on")


def _changed(trial: Trial, before: dict[str, list[int]]) -> set[str]:
    return {name for name, words in trial.image().items() if words != before[name]}


def _ramp_off(trial: Trial) -> Sequence[str]:
    return tuple(trial.map.ramp.off) if trial.map.ramp else ()
