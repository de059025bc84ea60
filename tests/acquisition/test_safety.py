"""The safe state on the simulated chamber and its clock: off when warm, warmed up first when cold, tried again."""

import pytest

from bench.acquisition.station.safety import SafeState, failures
from bench.acquisition.station.settings.safety import SafeStateSettings
from drivers.chamber import Chamber, SafeStep
from drivers.clock import SimClock
from drivers.modbus import ModbusLink
from drivers.registers import load_map
from drivers.sim.plant import Plant, PlantParameters
from drivers.sim.station import SimulatedStation


class Bench:
    """A simulated chamber that runs at a temperature, and the way to its safe state."""

    def __init__(self, degc, **settings):
        self.clock, self.events, self.beats, self.hurry = SimClock(), [], 0, False
        registers = load_map("watlow_f4t")
        self.world = SimulatedStation(registers, Plant(PlantParameters(), start_degc=degc), [])
        self.clock.attach(self.world.advance)
        self.link = ModbusLink(f"tcp://127.0.0.1:{self.world.modbus_port}")
        self.chamber = Chamber(self.link, registers, (-45.0, 95.0), self.clock)
        self.chamber.identify()
        self.chamber.set_point(degc)
        self.chamber.start()
        self.clock.sleep_until(10.0)
        self.way = SafeState(
            self.chamber,
            self.clock,
            SafeStateSettings(**settings),
            ambient_degc=23.0,
            retry_s=60.0,
            beat=self.beat,
            hurry=lambda: self.hurry,
            report=lambda kind, text, **facts: self.events.append((self.clock.now(), kind, text, facts.get("ok"))),
        )

    def beat(self):
        self.beats += 1

    def commands(self):
        commands = self.world.chamber.commands()
        return commands.setpoint, commands.on

    def texts(self):
        return [text for _, _, text, _ in self.events]

    def close(self):
        self.link.close()
        self.world.close()


@pytest.fixture
def at():
    opened = []

    def make(degc, **settings):
        opened.append(Bench(degc, **settings))
        return opened[-1]

    yield make
    for bench in opened:
        bench.close()


def test_a_warm_chamber_is_off_at_once(at):
    bench = at(80.0)
    steps = bench.way.make()
    assert (failures(steps), bench.commands(), bench.clock.now()) == ("", (23.0, False), 10.0)
    assert [ok for *_, ok in bench.events] == [True] * 3


def test_a_cold_chamber_is_warmed_up_first_and_the_bench_says_that_it_is_alive(at):
    bench = at(-30.0)
    assert failures(bench.way.make()) == ""
    assert bench.commands() == (23.0, False)
    air = bench.world.plant.state.process_value
    assert 18.0 <= air < 23.0
    assert bench.beats > bench.clock.now() - 15.0
    assert "warming up before it is switched off" in bench.texts()[0]
    assert bench.texts()[1].startswith("warmed up from -")


def test_nobody_waits_for_ever(at):
    bench = at(-30.0, warm_up_min=1.0)
    assert failures(bench.way.make()) == ""
    assert bench.clock.now() == pytest.approx(70.0, abs=2)
    assert next(ok for _, _, text, ok in bench.events if "warmed up" in text) is False
    assert bench.commands()[1] is False


@pytest.mark.parametrize(
    "settings", [{"warm_up_min": 0.0}, {"near_degc": 50.0}, {"near_degc": 49.0, "warm_up_min": 0.0}]
)
def test_warming_up_is_the_stations_choice(at, settings):
    bench = at(-20.0, **settings)
    bench.way.make()
    assert (bench.clock.now(), bench.commands()) == (10.0, (23.0, False))


def test_an_operator_in_a_hurry_ends_the_waiting_but_not_the_switching_off(at):
    bench = at(-30.0)
    bench.way.beat = lambda: setattr(bench, "hurry", bench.clock.now() > 20.0)
    assert failures(bench.way.make()) == ""
    assert bench.clock.now() < 25.0
    assert bench.commands() == (23.0, False)


def test_a_cold_chamber_with_an_alarm_is_not_heated(at):
    bench = at(-30.0)
    bench.world._publish = lambda: bench.world.chamber.publish(
        temperature=-30.0, working_setpoint=-30.0, alarms=["alarm_1"]
    )
    bench.clock.sleep_until(20.0)
    bench.way.make()
    assert (bench.clock.now(), bench.commands()[1]) == (20.0, False)


def test_a_chamber_that_does_not_answer_is_tried_again_and_then_said_loudly(at):
    bench = at(80.0)
    bench.world.chamber.close()
    steps = bench.way.make()
    assert bench.clock.now() == 70.0
    assert failures(steps).startswith("SAFE STATE NOT VERIFIED: set point to 23 degC")
    assert "switch the chamber off by hand" in failures(steps)
    assert bench.texts()[0].startswith("not reached yet, trying again for 60 s")
    assert [ok for *_, ok in bench.events[-3:]] == [False] * 3


def test_a_chamber_that_comes_back_in_time_is_made_safe(at):
    bench = at(80.0)
    safe, fails = bench.chamber.safe, [True, True, False]
    broken = [SafeStep("chamber off", False, "no answer")]
    bench.chamber.safe = lambda *args: broken if fails.pop(0) else safe(*args)
    assert failures(bench.way.make()) == ""
    assert bench.clock.now() == 13.0  # after 1 s and 2 s
    assert bench.commands() == (23.0, False)


def test_the_order_to_the_operator_names_the_equipment():
    chamber, table = SafeStep("chamber off", False, "no answer"), SafeStep("rate table stands", False, "no answer")
    sent = SafeStep("chamber off", False, "no answer", sent=True)
    ramp = SafeStep("ramp off", False, "no answer", sent=True)
    assert failures([ramp, sent]).startswith(
        "SAFE STATE NOT VERIFIED: ramp off (sent), chamber off (sent): no answer; "
    )
    assert failures([chamber]).endswith("; switch the chamber off by hand")
    assert failures([table]).endswith("; press the emergency stop of the rate table")
    assert failures([table, chamber]).endswith("of the rate table and switch the chamber off by hand")


def test_a_rate_table_is_stopped_before_the_chamber_and_again_when_it_did_not(at):
    bench = at(80.0)
    answers = [[SafeStep("rate table stands", False, "turns")], [SafeStep("rate table stands", True, "0 deg/s")]]
    order = []
    bench.way.stop_moving = lambda: order.append(bench.commands()[1]) or answers.pop(0)
    assert failures(bench.way.make()) == ""
    assert order == [True, False]
