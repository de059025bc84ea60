"""Behaviours while reading: the controller is recognised or refused; readings, alarms, sensor and door."""

from __future__ import annotations

from drivers.contract.trial import NotApplicable, Trial, alarm, check, foreign
from drivers.errors import IdentityError, LimitError


def identifies(trial: Trial) -> None:
    """Model, unit, limits and temperature are read; nothing is written."""
    before = trial.image()
    identity = trial.chamber.identify()
    check(identity.model == trial.map.model, f"identified as {identity.model}")
    check(trial.image() == before and not trial.writes, "identify wrote something")


def refuses_another_model(trial: Trial) -> None:
    """Every rule about the model refuses another one."""
    rules = [rule for rule in trial.map.identify if rule.register != trial.map.unit_register]
    if not rules:
        raise NotApplicable("no rule about the model")
    for rule in rules:
        kept = trial.served.words(rule.register)
        trial.served.set_words(rule.register, foreign(trial.map[rule.register]))
        trial.refused(IdentityError, trial.chamber.identify, f"another {rule.register}")
        trial.served.set_words(rule.register, kept)


def refuses_other_units(trial: Trial) -> None:
    """Refuses every unit except degC."""
    unit = trial.map.unit_register
    if unit is None:
        raise NotApplicable("the controller does not report its unit")
    check("celsius" in trial.map[unit].values, f"{unit} has no value named celsius")
    for name in set(trial.map[unit].values) - {"celsius"}:
        trial.put(unit, name)
        trial.refused(IdentityError, trial.chamber.identify, name)


def refuses_wrong_words(trial: Trial) -> None:
    """Refuses swapped words or an impossible temperature."""
    temperature = trial.map["temperature"]
    swapped = tuple(reversed(temperature.encode(25.0))) if temperature.count == 2 else temperature.impossible
    trial.served.set_words("temperature", swapped)
    trial.refused(IdentityError, trial.chamber.identify, "an impossible temperature")


def follows_decimals(trial: Trial) -> None:
    """Follows integers whose decimal point is set in the controller."""
    if not trial.described.decimals:
        raise NotApplicable("no implied decimals")
    for places in (0, 1, 2):
        trial.connect()  # the first recognition holds until the next connection
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


def reads_what_is_there(trial: Trial) -> None:
    """Reads temperatures of both signs, and an idle controller as off without alarms."""
    trial.chamber.identify()
    for degc in (-39.5, 0.0, 84.5):
        trial.put("temperature", degc)
        reading = trial.chamber.poll()
        check(reading.temperature == degc, f"{degc} degC reads {reading.temperature}")
    check(not reading.on and not reading.alarm, f"an idle controller reads on {reading.on}, {reading.alarm}")


def shows_alarms(trial: Trial) -> None:
    """Shows the alarm of each register, and never writes to it."""
    watched = [trial.map[name] for name in (*trial.map.poll, *trial.map.secondary)]
    alarms = [register for register in watched if register.normal or register.alarming]
    if not alarms:
        raise NotApplicable("the controller shows no alarms")
    trial.chamber.identify()
    for register in alarms:
        quiet = trial.served.words(register.name)
        trial.served.set_words(register.name, alarm(register))
        shown = [text.split(":")[0] for text in trial.chamber.poll().alarm]
        check(register.name in shown, f"{register.name} is not shown")
        trial.served.set_words(register.name, quiet)
    check(not trial.chamber.poll().alarm and not trial.writes, "an alarm stays, or was written")


def shows_a_broken_sensor(trial: Trial) -> None:
    """Shows it by its register, and by an impossible temperature."""
    trial.chamber.identify()
    if "sensor_break" in trial.map:
        check(trial.chamber.poll().sensor_break is False, "an intact sensor reads broken")
        trial.put("sensor_break", "broken")
        check(trial.chamber.poll().sensor_break is True, "a broken sensor reads intact")
    else:
        check(trial.chamber.poll().sensor_break is None, "reports a state that the controller does not have")
    trial.served.set_words("temperature", trial.map["temperature"].impossible)
    text = trial.refused(LimitError, trial.chamber.poll, "a temperature of a broken sensor")
    check("sensor" in text, text)


def shows_its_door(trial: Trial) -> None:
    """Shows open and closed; unknown without a switch."""
    trial.chamber.identify()
    if "door" not in trial.map:
        check(trial.chamber.poll().door is None, "reports a state that the controller does not have")
        raise NotApplicable("no door switch")
    check(trial.chamber.poll().door is False, "a closed door reads open")
    trial.put("door", "open")
    check(trial.chamber.poll().door is True, "an open door reads closed")
