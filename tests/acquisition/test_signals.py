"""Signals that guards watch: frozen values, doors, overrides, buses."""

from types import SimpleNamespace

import pytest

from bench.acquisition.profile.guards import OPTIONAL, Signal, told_by
from bench.acquisition.run.signals import Signals, told
from bench.acquisition.station.links import Link
from bench.base import INSTRUMENTS
from drivers.chamber import ChamberReading
from drivers.clock import SimClock
from drivers.registers import load_map


class Bench:
    """Signals of a chamber that is read once a second."""

    def __init__(self, commanded=23.0):
        self.clock = SimClock()
        chamber = SimpleNamespace(commanded=commanded)
        station = SimpleNamespace(
            clock=self.clock, chamber=chamber, units=[], bus_failed_s=0.0, instruments=SimpleNamespace(latest={})
        )
        self.link = SimpleNamespace(link=Link("chamber", SimpleNamespace(), print), deviations=())
        self.signals = Signals(station, self.link)

    def read(self, temperature=23.0, power=0.0, on=True, setpoint=23.0, **more):
        self.clock.sleep_until(self.clock.now() + 1.0)
        now_s = self.clock.now()
        self.signals.take(ChamberReading(now_s, temperature, setpoint, setpoint, power, on, (), None, **more), True)
        return self.signals.collect()


def test_a_value_is_frozen_while_not_a_bit_of_it_changes_under_power():
    bench = Bench()
    for t_s, (temperature, power, frozen_s) in enumerate(
        [
            (40.0, 50.0, 0),
            (40.0, 50.0, 1),
            (40.0, -20.0, 2),
            (40.1, 50.0, 0),
            (40.1, 0.0, 0),
            (40.1, 0.0, 0),
            (40.1, 1.0, 1),
        ]
    ):
        assert bench.read(temperature, power)["frozen_s"].value == frozen_s, t_s


def test_a_controller_that_does_not_tell_its_output_has_no_frozen_value():
    assert {"frozen_s", "power"}.isdisjoint(Bench().read(power=None))


@pytest.mark.parametrize("name", ["door", "sensor_break"])
def test_door_and_sensor_break_are_there_where_the_controller_tells(name):
    assert name not in Bench().read()
    assert Bench().read(**{name: True})[name].value == 1.0
    assert Bench().read(**{name: False})[name].value == 0.0


def test_another_set_point_is_an_override_with_both_numbers():
    override = Bench().read(setpoint=60.0)["override"]
    assert (override.value, override.detail) == (1.0, "set point is 60 degC, the bench commanded 23")
    assert Bench().read(setpoint=23.1)["override"].value == 0.0
    assert Bench(commanded=None).read(setpoint=60.0)["override"].value == 0.0


def test_what_a_chamber_was_found_to_do_after_a_silence_is_an_override():
    bench = Bench()
    bench.link.deviations = ("mode is manual",)
    assert bench.read()["override"] == Signal(1.0, 1.0, "mode is manual")


def test_a_chamber_may_take_a_while_to_be_on():
    bench = Bench()
    values = [bench.read(on=False)["override"].value for _ in range(13)]
    assert values == [0.0] * 11 + [1.0] * 2
    assert bench.read(on=True)["override"].value == 0.0


def test_what_a_map_and_a_reading_tell_agree_on_the_names():
    assert {*told_by(load_map("watlow_f4t").registers)} == {"power", "frozen_s"}
    everything = ChamberReading(0.0, 23.0, 23.0, 23.0, 1.0, True, (), None, door=False, sensor_break=False)
    assert told(everything) == OPTIONAL - {*INSTRUMENTS}
    assert told(ChamberReading(0.0, 23.0, 23.0, None, None, True, (), None)) == set()
