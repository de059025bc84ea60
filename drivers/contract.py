"""What every register map has to do on the wire: one list of behaviours, for shipped maps and for yours.

Each behaviour is tried on a fresh simulated controller that serves the map, through the real driver and a real link.
`bench doctor STATION --contract` runs it for the map of a station file; the tests run it for every shipped map, over
each wire, and against a Modbus server that is not ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.chamber import Chamber, Write
from drivers.clock import SimClock
from drivers.controller import WEAR_WRITES
from drivers.errors import ConfigError, DriverError, IdentityError, LimitError
from drivers.modbus import ModbusLink
from drivers.register import Register, Value
from drivers.register_map import RegisterMap
from drivers.sim.modbus_chamber import ModbusChamber

LIMITS = (-40.0, 85.0)
"""Station limits [degC] of the trial; every map has to allow them."""


class Served(Protocol):
    """A controller that serves a map: its address, and its registers from the inside."""

    @property
    def url(self) -> str:
        """Address for a link."""

    def words(self, name: str) -> list[int]:
        """Raw words of a register."""

    def set_words(self, name: str, words: Iterable[int]) -> None:
        """Put raw words into a register; of a masked one only its bits."""

    def close(self) -> None:
        """End it."""


class NotApplicable(Exception):  # noqa: N818 - an outcome, not an error
    """The controller has nothing that this behaviour is about."""


@dataclass(frozen=True)
class Outcome:
    """How one behaviour went."""

    behaviour: str
    verdict: Literal["ok", "failed", "not applicable"]
    detail: str = ""


class Trial:
    """One behaviour's fresh controller, and the driver on it."""

    def __init__(self, registers: RegisterMap, served: Served) -> None:
        self.described = registers
        self.map = registers.with_decimals(dict.fromkeys(registers.decimals, 1))
        self.served = served
        self.link = ModbusLink(served.url, timeout_s=5.0, attempts=1)
        self.writes: list[Write] = []
        self.clock = SimClock()
        self.chamber = Chamber(self.link, registers, LIMITS, self.clock, journal=self.writes.append, secondary_s=0.0)

    def value(self, name: str) -> Value:
        """What a register holds."""
        return self.map[name].decode(self.served.words(name))

    def put(self, name: str, value: Value) -> None:
        """Change a register from the controller's side."""
        self.served.set_words(name, self.map[name].encode(value))

    def image(self) -> dict[str, list[int]]:
        """All registers."""
        return {name: self.served.words(name) for name in self.map.registers}

    def refused(self, error: type[DriverError], call: Callable[[], object], what: str) -> str:
        """The text of the refusal that has to come."""
        try:
            call()
        except error as refusal:
            return str(refusal)
        raise AssertionError(f"{what} was not refused")


def check(true: bool, text: str) -> None:
    """AssertionError with `text` unless `true`; unlike assert it also stands with -O."""
    if not true:
        raise AssertionError(text)


def _identifies(trial: Trial) -> None:
    before = trial.image()
    identity = trial.chamber.identify()
    check(identity.model == trial.map.model, f"identified as {identity.model}")
    check(trial.image() == before and not trial.writes, "identify wrote something")


def _refuses_another_model(trial: Trial) -> None:
    rules = [rule for rule in trial.map.identify if rule.register != trial.map.unit_register]
    if not rules:
        raise NotApplicable("no rule about the model")
    for rule in rules:
        kept = trial.served.words(rule.register)
        trial.served.set_words(rule.register, _foreign(trial.map[rule.register]))
        trial.refused(IdentityError, trial.chamber.identify, f"another {rule.register}")
        trial.served.set_words(rule.register, kept)


def _refuses_other_units(trial: Trial) -> None:
    unit = trial.map.unit_register
    if unit is None:
        raise NotApplicable("the controller does not tell its unit")
    rule = next(rule for rule in trial.map.identify if rule.register == unit)
    for name in trial.map[unit].values:
        if not rule.accepts(name):
            trial.put(unit, name)
            trial.refused(IdentityError, trial.chamber.identify, name)


def _refuses_wrong_words(trial: Trial) -> None:
    temperature = trial.map["temperature"]
    swapped = tuple(reversed(temperature.encode(25.0))) if temperature.count == 2 else (0x7FFF,)
    trial.served.set_words("temperature", swapped)
    trial.refused(IdentityError, trial.chamber.identify, "a temperature that none can be")


def _follows_decimals(trial: Trial) -> None:
    if not trial.described.decimals:
        raise NotApplicable("no implied decimals")
    for places in (0, 1, 2):
        for name in trial.described.decimals:
            trial.put(name, float(places))
        known = trial.described.with_decimals(dict.fromkeys(trial.described.decimals, places))
        for name in ("temperature", "setpoint", "setpoint_low", "setpoint_high"):
            if name in known:
                trial.served.set_words(
                    name, known[name].encode({"setpoint_low": -40, "setpoint_high": 85}.get(name, 25))
                )
        trial.chamber.identify()
        trial.chamber.set_point(30.0)
        reading = trial.chamber.poll()
        check((reading.temperature, reading.setpoint) == (25.0, 30.0), f"{places} decimals: {reading}")
    for name in trial.described.decimals:
        trial.served.set_words(name, (9,))
    trial.refused(IdentityError, trial.chamber.identify, "9 decimals")


def _reads_what_is_there(trial: Trial) -> None:
    trial.chamber.identify()
    for degc in (-39.5, 0.0, 84.5):
        trial.put("temperature", degc)
        reading = trial.chamber.poll()
        check(reading.temperature == degc, f"{degc} degC reads {reading.temperature}")
    check(not reading.on and not reading.alarm, f"a resting controller reads on {reading.on}, {reading.alarm}")


def _sets_its_set_point(trial: Trial) -> None:
    trial.chamber.identify()
    before = trial.image()
    trial.chamber.set_point(-20.5)
    ours = {"setpoint", *trial.map.setpoint_copies}
    check(all(trial.value(name) == -20.5 for name in ours), "the set point did not arrive")
    check(trial.chamber.poll().setpoint == -20.5, "the set point does not read back")
    check(_changed(trial, before) <= ours | set(_ramp_off(trial)), f"also changed: {_changed(trial, before) - ours}")
    count = trial.chamber.writes
    trial.chamber.set_point(-20.5)
    check(trial.chamber.writes == count, "what stood already was written again")


def _refuses_what_is_outside(trial: Trial) -> None:
    trial.chamber.identify()
    before = trial.image()
    for degc in (LIMITS[0] - 1.0, LIMITS[1] + 1.0, float("nan")):
        trial.refused(LimitError, lambda target=degc: trial.chamber.set_point(target), f"{degc:g} degC")  # type: ignore[misc]
    check(trial.image() == before, "something was sent")


def _ramps(trial: Trial) -> None:
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


def _spares_its_memory(trial: Trial) -> None:
    if trial.map.eeprom_writes is None:
        raise NotApplicable("no limit on writes")
    trial.chamber.identify()

    def step_from_the_host() -> None:
        for step in range(WEAR_WRITES + 2):
            trial.clock.sleep_until(trial.clock.now() + 1.0)
            trial.chamber.set_point(float(step))

    trial.refused(LimitError, step_from_the_host, "a ramp stepped by the host")
    check(trial.chamber.writes <= WEAR_WRITES, f"{trial.chamber.writes} writes")
    check(all(step.ok for step in trial.chamber.safe(25.0)), "the safe state was kept off by the limit on writes")


def _starts_and_stops(trial: Trial) -> None:
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


def _shows_alarms(trial: Trial) -> None:
    watched = [trial.map[name] for name in (*trial.map.poll, *trial.map.secondary)]
    alarms = [register for register in watched if register.normal or register.alarming]
    if not alarms:
        raise NotApplicable("the controller shows no alarms")
    trial.chamber.identify()
    for register in alarms:
        quiet = trial.served.words(register.name)
        trial.served.set_words(register.name, _alarm(register))
        shown = [text.split(":")[0] for text in trial.chamber.poll().alarm]
        check(register.name in shown, f"{register.name} is not shown")
        trial.served.set_words(register.name, quiet)
    check(not trial.chamber.poll().alarm and not trial.writes, "an alarm stays, or was written")


def _shows_a_broken_sensor(trial: Trial) -> None:
    trial.chamber.identify()
    if "sensor_break" in trial.map:
        check(trial.chamber.poll().sensor_break is False, "a sound sensor reads broken")
        trial.put("sensor_break", "broken")
        check(trial.chamber.poll().sensor_break is True, "a broken sensor reads sound")
    else:
        check(trial.chamber.poll().sensor_break is None, "tells what it cannot know")
    temperature = trial.map["temperature"]
    words = (0x7FC0, 0) if temperature.type == "float32" else (0x7FFF,)
    words = tuple(reversed(words)) if temperature.word_order == "low_first" else words
    trial.served.set_words("temperature", words)
    text = trial.refused(LimitError, trial.chamber.poll, "a temperature of a broken sensor")
    check("sensor" in text, text)


def _shows_its_door(trial: Trial) -> None:
    trial.chamber.identify()
    if "door" not in trial.map:
        check(trial.chamber.poll().door is None, "tells what it cannot know")
        raise NotApplicable("no door switch")
    check(trial.chamber.poll().door is False, "a closed door reads open")
    trial.put("door", "open")
    check(trial.chamber.poll().door is True, "an open door reads closed")


def _notices_other_hands(trial: Trial) -> None:
    trial.chamber.identify()
    trial.chamber.set_point(30.0)
    trial.chamber.start()
    check(not trial.chamber.deviations(), f"deviates from itself: {trial.chamber.deviations()}")
    for name in ("setpoint", *trial.map.setpoint_copies):
        trial.put(name, 60.0)
        check(any(text.startswith(name) for text in trial.chamber.deviations()), f"a foreign {name} goes unnoticed")
        trial.put(name, 30.0)
    trial.put(trial.map.run.state, trial.map.run.off)
    check(len(trial.chamber.deviations()) == 1, "switched off at the panel goes unnoticed")


def _reaches_the_safe_state(trial: Trial) -> None:
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


BEHAVIOURS: dict[str, Callable[[Trial], None]] = {
    "identifies the described controller and writes nothing": _identifies,
    "refuses another model": _refuses_another_model,
    "refuses every unit but degC": _refuses_other_units,
    "refuses a wrong word order or an impossible temperature": _refuses_wrong_words,
    "follows the controller's implied decimals": _follows_decimals,
    "reads what is there": _reads_what_is_there,
    "writes its set points, once, and nothing else": _sets_its_set_point,
    "refuses set points outside the limits before anything is sent": _refuses_what_is_outside,
    "ramps natively, or by steps of the host": _ramps,
    "spares a memory that wears out": _spares_its_memory,
    "starts after a set point, stops, and spares its compressor": _starts_and_stops,
    "shows every alarm and clears none": _shows_alarms,
    "shows a broken sensor": _shows_a_broken_sensor,
    "shows its door": _shows_its_door,
    "notices set points and switches of others": _notices_other_hands,
    "reaches the safe state": _reaches_the_safe_state,
}


def try_map(registers: RegisterMap, serve: Callable[[RegisterMap], Served] = ModbusChamber) -> list[Outcome]:
    """Every behaviour of `registers`, each on a controller of its own that `serve` makes."""
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


def _changed(trial: Trial, before: dict[str, list[int]]) -> set[str]:
    return {name for name, words in trial.image().items() if words != before[name]}


def _ramp_off(trial: Trial) -> Sequence[str]:
    return tuple(trial.map.ramp.off) if trial.map.ramp else ()


def _foreign(register: Register) -> tuple[int, ...]:
    """Words that satisfy no sensible rule about a register."""
    if register.type == "ascii":
        return (ord("?"),) * register.count
    return (0xFFFF if register.mask is None else register.mask,) * register.count


def _alarm(register: Register) -> tuple[int, ...]:
    for name, code in register.values.items():
        if register.is_alarm(name):
            return (code,)
    bits = 0xFFFF if register.mask is None else register.mask
    return (next(code for code in range(1, 0x10000) if code & bits == code and code not in register.values.values()),)
