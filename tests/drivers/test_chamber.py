"""The chamber driver, beyond what test_contract.py tries with every map: writes read back, the safe state verified."""

from __future__ import annotations

import contextlib

import pytest

from drivers.chamber import Chamber, Write
from drivers.clock import SimClock
from drivers.errors import ConfigError, IdentityError, LimitError, LinkError, ReadBackError, RefusedError
from drivers.modbus import ModbusLink
from drivers.registers import load_map, parse_map
from drivers.sim.modbus_chamber import ChamberCommands, ModbusChamber

F4T = load_map("watlow_f4t")
HOST_STEPPED = """\
model: Watlow F4
registers:
  model_number: {address: 0, type: uint16, low: 5270, high: 5270, meaning: model, source: F4 manual ch. 7}
  temperature: {address: 100, type: int16, scale: 0.1, unit: degC, low: -80, high: 200, meaning: air, source: F4}
  setpoint: {address: 300, type: int16, scale: 0.1, write: 6, unit: degC, low: -80, high: 200, meaning: t, source: F4}
  mode: {address: 202, type: uint16, write: 6, values: {off: 0, on: 1}, meaning: run, source: F4}
poll: [temperature, mode, setpoint]
run: {register: mode, on: on, off: off, state: mode}
identify: []
"""


class Bench:
    """A simulated controller, the driver on it, and what the driver journalled."""

    def __init__(self, registers):
        self.server = ModbusChamber(registers)
        self.link = ModbusLink(self.server.url, timeout_s=5.0)
        self.clock = SimClock()
        self.writes = []
        self.chamber = Chamber(self.link, registers, (-40.0, 85.0), self.clock, journal=self.writes.append)

    def close(self):
        self.link.close()
        self.server.close()


@pytest.fixture
def connect():
    """Benches with other maps, recognised, and at the end of the test closed."""
    with contextlib.ExitStack() as benches:

        def connected(registers, identified=True):
            bench = Bench(registers)
            benches.callback(bench.close)
            if identified:
                bench.chamber.identify()
            return bench

        yield connected


@pytest.fixture
def bench(connect):
    return connect(F4T, identified=False)


@pytest.fixture
def ready(connect):
    return connect(F4T)


@pytest.fixture
def hot(ready):
    """On its way to 80 degC."""
    return begun(ready)


def begun(bench, degc=80.0):
    bench.chamber.set_point(degc)
    bench.chamber.start()
    return bench


def test_limits_are_those_of_station_and_controller_together(bench):
    wide = Chamber(bench.link, F4T, (-60.0, 100.0), bench.clock)
    wide.identify()
    assert wide.limits == (-45.0, 100.0)  # the controller's low, the station's high


def test_disjoint_limits_are_refused(bench):
    with pytest.raises(IdentityError, match="no common set point"):
        Chamber(bench.link, F4T, (140.0, 180.0), bench.clock).identify()


@pytest.mark.parametrize(
    ("register", "words", "message"),
    [
        ("part_number", [ord("P"), ord("M")] + [0] * 13, "part number"),
        ("temperature_unit", [30], "degF"),
        ("temperature", [0x0000, 0x7FC0], "temperature reads nan"),
        ("temperature", [0x41C8, 0x0000], "word order"),
        ("temperature", [0x0000, 0x447A], "1000 degC"),
    ],
)
def test_a_controller_that_is_not_the_described_one_is_refused(bench, register, words, message):
    bench.server.set_words(register, words)
    with pytest.raises(IdentityError, match=message):
        bench.chamber.identify()


def test_nothing_is_written_before_identify(bench):
    for command in (
        lambda: bench.chamber.set_point(20.0),
        lambda: bench.chamber.ramp_to(20.0, 1.0),
        bench.chamber.stop,
    ):
        with pytest.raises(IdentityError, match="identify"):
            command()
    assert bench.writes == []


def test_poll_tells_what_the_controller_shows(ready):
    ready.server.publish(temperature=20.5, working_setpoint=21.5, power=-25.0, compressor=True)
    ready.clock.sleep_until(10.0)
    reading = ready.chamber.poll()
    assert (reading.t_s, reading.temperature, reading.setpoint, reading.working_setpoint) == (10.0, 20.5, 25.0, 21.5)
    assert (reading.power, reading.on, reading.alarm, reading.compressor) == (-25.0, False, (), True)


def test_a_poll_is_one_request_and_the_slow_registers_come_seldom(ready):
    ready.chamber.poll()
    before = ready.link.counters.requests
    for _ in range(4):
        ready.clock.sleep_until(ready.clock.now() + 1.0)
        ready.chamber.poll()
    assert ready.link.counters.requests - before == 4
    ready.clock.sleep_until(5.0)
    ready.chamber.poll()
    assert ready.link.counters.requests - before == 5 + len(F4T.secondary)


def test_a_set_point_arrives_and_is_journalled(ready):
    ready.clock.sleep_until(7.0)
    ready.chamber.set_point(-40.0)
    assert ready.server.commands().setpoint == -40.0
    assert ready.writes == [Write(7.0, "setpoint", 25.0, -40.0, -40.0)]
    assert ready.chamber.commanded == -40.0


@pytest.mark.parametrize("target", [-40.01, 85.01, float("nan"), float("inf"), 1000.0])
def test_a_set_point_outside_the_limits_is_refused_not_clipped(ready, target):
    for command in (lambda: ready.chamber.set_point(target), lambda: ready.chamber.ramp_to(target, 1.0)):
        with pytest.raises(LimitError):
            command()
    assert ready.writes == []
    assert ready.server.commands() == ChamberCommands(25.0, False, None)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), 100.0])
def test_a_ramp_rate_that_is_none_is_refused_before_anything_is_sent(ready, rate):
    with pytest.raises(LimitError):
        ready.chamber.ramp_to(50.0, rate)
    assert ready.writes == []


def test_a_native_ramp_is_set_up_before_its_target(ready):
    ready.chamber.ramp_to(85.0, 2.0)
    ready.chamber.start()
    assert ready.server.commands() == ChamberCommands(85.0, True, 2.0)
    assert [write.register for write in ready.writes] == ["ramp_rate", "ramp_action", "setpoint", "mode"]


def test_hold_stays_where_the_ramp_is(ready):
    ready.chamber.ramp_to(85.0, 2.0)
    ready.server.publish(temperature=40.0, working_setpoint=42.5)
    assert ready.chamber.hold() == 42.5
    assert ready.server.commands() == ChamberCommands(42.5, False, None)


def test_without_a_native_ramp_the_host_steps(connect):
    bench = connect(parse_map(HOST_STEPPED, "f4"))
    assert not bench.chamber.native_ramp
    with pytest.raises(ConfigError, match="step the set point"):
        bench.chamber.ramp_to(50.0, 1.0)
    bench.chamber.set_point(25.3)
    assert bench.server.commands().setpoint == pytest.approx(25.3)
    reading = bench.chamber.poll()
    assert (reading.working_setpoint, reading.power, reading.compressor) == (None, None, None)
    assert all(step.ok for step in bench.chamber.safe(25.0))


def test_a_set_point_that_the_controller_changes_is_an_error(ready, monkeypatch):
    """Seen on real chambers: the controller clamps silently, or stores 0.0 from swapped words."""
    write = ready.link.write

    def clamp(register, value):
        write(register, value)
        ready.server.set_words("setpoint", F4T["setpoint"].encode(70.0))

    monkeypatch.setattr(ready.link, "write", clamp)
    with pytest.raises(ReadBackError, match="wrote 80"):
        ready.chamber.set_point(80.0)
    assert ready.chamber.commanded is None
    assert ready.writes[-1].read_back == 70.0


def test_another_controller_after_a_reconnection_gets_no_write(ready):
    ready.link.close()
    ready.server.set_words("temperature_unit", [30])
    with pytest.raises(IdentityError, match="degF"):
        ready.chamber.set_point(40.0)
    assert ready.writes == []


def test_limits_that_changed_over_a_reconnection_are_kept(ready):
    ready.link.close()
    ready.server.set_words("setpoint_high", F4T["setpoint_high"].encode(50.0))
    with pytest.raises(LimitError, match="50"):
        ready.chamber.set_point(60.0)


def has_no(bench, name, monkeypatch):
    """The controller does not have this register."""
    read = bench.link.read

    def without(register):
        if register.name == name:
            raise RefusedError("exception 2, illegal address", 2)
        return read(register)

    monkeypatch.setattr(bench.link, "read", without)


def test_an_optional_register_that_is_not_there_is_left_alone(bench, monkeypatch):
    has_no(bench, "compressor", monkeypatch)
    bench.chamber.identify()
    assert bench.chamber.poll().compressor is None


def test_a_controller_that_does_not_read_across_gaps_is_polled_one_by_one(bench, monkeypatch):
    def refuse(registers):
        if len(members := tuple(registers)) > 1:
            raise RefusedError("exception 2, illegal address", 2)
        return read_block(members)

    read_block = bench.link.read_block
    monkeypatch.setattr(bench.link, "read_block", refuse)
    bench.chamber.identify()
    assert bench.chamber.poll().temperature == 25.0


class TestSafeState:
    def test_goes_to_ambient_first_and_then_off(self, ready):
        ready.chamber.ramp_to(85.0, 2.0)
        ready.chamber.start()
        ready.writes.clear()
        steps = ready.chamber.safe(25.0)
        assert [step.ok for step in steps] == [True, True, True]
        assert [write.register for write in ready.writes] == ["setpoint", "ramp_action", "mode"]
        assert ready.server.commands() == ChamberCommands(25.0, False, None)

    def test_is_reached_by_a_watchdog_that_never_identified(self, bench):
        bench.server.set_words("mode", [10])
        assert all(step.ok for step in bench.chamber.safe(25.0))
        assert not bench.server.commands().on

    def test_is_reached_with_a_broken_sensor(self, hot):
        hot.server.set_words("temperature", [0x0000, 0x7FC0])
        assert all(step.ok for step in hot.chamber.safe(25.0))
        assert hot.server.commands() == ChamberCommands(25.0, False, None)

    def test_switches_off_even_when_ambient_cannot_be_commanded(self, hot):
        steps = hot.chamber.safe(200.0)
        assert [step.ok for step in steps] == [False, True, True]
        assert "200" in steps[0].detail
        assert not hot.server.commands().on

    def test_says_so_when_the_chamber_stays_on(self, hot, monkeypatch):
        hot.clock.attach(lambda _t0, _t1: hot.server.set_words("mode_active", [10]))
        write = hot.link.write

        def stubborn(register, value):
            write(register, value)
            hot.server.set_words("mode_active", [10])

        monkeypatch.setattr(hot.link, "write", stubborn)
        steps = hot.chamber.safe(25.0)
        assert [step.ok for step in steps] == [True, True, False]
        assert "mode_active is not off" in steps[2].detail

    def test_never_raises_and_reports_a_lost_link(self, ready):
        ready.server.close()
        steps = ready.chamber.safe(25.0)
        assert [step.ok for step in steps] == [False, False, False]
        assert all("attempts" in step.detail for step in steps)
        assert not any(step.sent for step in steps)


def unreadable(bench, monkeypatch):
    def nonsense(registers):
        raise LinkError("the answer belongs to function 4")

    monkeypatch.setattr(bench.link, "read_block", nonsense)


class TestSafeStateOfAControllerThatCannotBeRead:
    def test_every_command_is_sent_and_nothing_called_verified(self, ready, monkeypatch):
        ready.chamber.ramp_to(80.0, 2.0)
        ready.chamber.start()
        unreadable(ready, monkeypatch)
        ready.writes.clear()
        steps = ready.chamber.safe(25.0)
        assert [(step.ok, step.sent, step.detail) for step in steps] == [
            (False, True, "the answer belongs to function 4")
        ] * 3
        assert ready.server.commands() == ChamberCommands(25.0, False, None)
        assert [(write.register, write.read_back) for write in ready.writes] == [
            ("setpoint", "not read back"),
            ("ramp_action", "not read back"),
            ("mode", "not read back"),
        ]

    def test_off_is_sent_even_when_every_write_is_answered_by_nonsense(self, hot, monkeypatch):
        unreadable(hot, monkeypatch)
        send = hot.link.send

        def and_then_fail(register, value):
            send(register, value)
            raise LinkError("the answer echoes another write")

        monkeypatch.setattr(hot.link, "send", and_then_fail)
        assert [step.sent for step in hot.chamber.safe(25.0)] == [True] * 3
        assert hot.server.commands() == ChamberCommands(25.0, False, None)

    def test_what_our_own_bug_kept_from_being_sent_is_not_called_sent(self, ready, monkeypatch):
        def bug(register, value):
            raise NameError("name 'client' is not defined")

        unreadable(ready, monkeypatch)
        monkeypatch.setattr(ready.link, "send", bug)
        assert not any(step.sent for step in ready.chamber.safe(25.0))

    def test_a_display_in_degf_gets_no_set_point_and_is_switched_off(self, hot):
        hot.server.set_words("temperature_unit", [30])
        steps = hot.chamber.safe(25.0)
        assert [(step.ok, step.sent) for step in steps] == [(False, False), (False, True), (False, True)]
        assert all("degF" in step.detail for step in steps)
        assert hot.server.commands() == ChamberCommands(80.0, False, None)

    def test_other_decimals_than_at_the_start_get_no_set_point(self, connect):
        bench = begun(connect(load_map("watlow_f4")))
        bench.server.set_words("decimals", [0])
        steps = bench.chamber.safe(25.0)
        assert [(step.ok, step.sent) for step in steps] == [(False, False), (False, True), (False, True)]
        assert "when it was recognised first" in steps[0].detail

    def test_the_set_point_goes_out_with_the_decimals_of_the_start(self, monkeypatch, connect):
        bench = begun(connect(load_map("watlow_f4")))
        unreadable(bench, monkeypatch)
        bench.chamber.safe(25.0)
        assert bench.server.commands().setpoint == 25.0
        assert not bench.server.commands().on

    def test_outside_the_limits_of_the_start_only_off_goes_out(self, hot, monkeypatch):
        unreadable(hot, monkeypatch)
        assert [step.sent for step in hot.chamber.safe(200.0)] == [False, True, True]
        assert hot.server.commands() == ChamberCommands(80.0, False, None)

    def test_a_watchdog_goes_by_what_the_bench_read(self, hot, monkeypatch):
        unreadable(hot, monkeypatch)
        other = Chamber(hot.link, F4T, (-40.0, 85.0), hot.clock, known=hot.chamber.known)
        assert [step.sent for step in other.safe(25.0)] == [True] * 3
        assert hot.server.commands() == ChamberCommands(25.0, False, None)

    def test_one_that_was_never_recognised_gets_nothing(self, bench, monkeypatch):
        bench.server.set_words("mode", [10])
        unreadable(bench, monkeypatch)
        assert not any(step.sent for step in bench.chamber.safe(25.0))
        assert bench.server.commands().on

    def test_of_a_word_that_holds_more_only_our_bits_change(self, monkeypatch, connect):
        bench = connect(load_map("binder_mb2"), identified=False)
        bench.server._words[0x1158] = 0x0101
        bench.chamber.identify()
        bench.chamber.identify()
        begun(bench)
        sent = []
        send = bench.link.send
        monkeypatch.setattr(bench.link, "send", lambda register, value: sent.append(value) or send(register, value))
        unreadable(bench, monkeypatch)
        bench.chamber.safe(25.0)
        assert sent[-1] == 0x0103
        assert not bench.server.commands().on

    def test_it_is_verified_again_as_soon_as_it_can_be_read(self, hot, monkeypatch):
        read, fails = hot.link.read_block, [True]

        def once(registers):
            if fails and fails.pop():
                raise LinkError("no valid answer")
            return read(registers)

        monkeypatch.setattr(hot.link, "read_block", once)
        assert [(step.ok, step.sent) for step in hot.chamber.safe(25.0)] == [
            (False, True),
            (True, False),
            (True, False),
        ]
        assert all(step.ok for step in hot.chamber.safe(25.0))


def test_the_link_comes_back_by_itself_after_the_controller_did(ready):
    port = ready.server.port
    ready.server.close()
    with pytest.raises(LinkError):
        ready.chamber.poll()
    ready.server = ModbusChamber(F4T, port=port)
    assert ready.chamber.poll().temperature == 25.0
    ready.chamber.set_point(30.0)
    assert ready.link.counters.connections == 2


def test_limits_that_are_no_range_are_refused(bench):
    for limits in [(50.0, -40.0), (float("nan"), 85.0), (-40.0, float("inf"))]:
        with pytest.raises(ConfigError):
            Chamber(bench.link, F4T, limits, bench.clock)


class TestSafeStateInTime:
    def test_each_step_ends_in_time_although_the_link_is_slow(self, ready, monkeypatch):
        """A minute of bench time for each request, as with a line that answers only at the last attempt."""
        read = ready.link.read

        def slow(register):
            ready.clock.sleep_until(ready.clock.now() + 60.0)
            return read(register)

        ready.chamber.set_point(80.0)
        monkeypatch.setattr(ready.link, "read", slow)
        begun_s = ready.clock.now()
        steps = ready.chamber.safe(25.0, limit_s=10.0)
        assert [(step.ok, step.sent) for step in steps] == [(False, True)] * 3
        assert all("time limit" in step.detail for step in steps)
        assert ready.server.commands() == ChamberCommands(25.0, False, None)
        assert ready.clock.now() - begun_s <= 3 * 60.0

    def test_is_reached_without_waiting_for_the_compressor(self, connect):
        text = HOST_STEPPED.replace("state: mode}", "state: mode, least_on_s: 300}")
        bench = begun(connect(parse_map(text, "f4")), 20.0)
        assert all(step.ok for step in bench.chamber.safe(25.0))
        assert bench.clock.now() < 10.0


def test_a_compressor_gets_its_time_on_and_off(connect):
    text = HOST_STEPPED.replace("state: mode}", "state: mode, least_on_s: 60, least_off_s: 180}")
    bench = begun(connect(parse_map(text, "f4")), 20.0)
    assert bench.clock.now() == 0.0  # how long it was off before is not ours to know; the controller has its own timer
    bench.chamber.stop()
    assert bench.clock.now() == 60.0
    bench.chamber.start()
    assert bench.clock.now() == 240.0


def test_what_the_controller_holds_is_compared_with_what_we_commanded(ready):
    assert ready.chamber.deviations() == []
    assert begun(ready, 30.0).chamber.deviations() == []
    ready.server.set_words("setpoint", F4T["setpoint"].encode(60.0))
    ready.server.set_words("mode_active", [62])
    assert ready.chamber.deviations() == [
        "setpoint is 60 degC, the bench commanded 30 degC",
        "mode_active is off, the bench commanded auto",
    ]


def test_a_sensor_that_the_controller_calls_broken_is_named_before_its_value(connect):
    f4 = load_map("watlow_f4")
    bench = connect(f4)
    bench.server.publish(temperature=25.0, working_setpoint=25.0, sensor_break=True)
    assert bench.chamber.poll().sensor_break is True
    bench.server.set_words("temperature", [0x7FFF])
    with pytest.raises(LimitError, match="reports a broken sensor"):
        bench.chamber.poll()


def test_decimals_that_cannot_be_read_are_refused(monkeypatch, connect):
    bench = connect(load_map("watlow_f4"), identified=False)
    has_no(bench, "decimals", monkeypatch)
    with pytest.raises(IdentityError, match="decimals cannot be read"):
        bench.chamber.identify()


def test_bits_beside_ours_stay_as_they_are(connect):
    bench = connect(load_map("binder_mb2"))
    bench.server.set_words("mode", [0x0002])
    with bench.server._lock:
        bench.server._words[0x1158] |= 0x0041  # humidity off and anticondensation
    begun(bench, 30.0)
    assert bench.server.words("mode") == [0x0041]
    bench.chamber.stop()
    assert bench.server.words("mode") == [0x0043]
