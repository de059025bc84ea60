"""A rate table through its drivers: a CiA 402 drive on a python-can bus, an Ideal Aerosmith on a pseudo-terminal."""

import uuid

import can
import numpy as np
import pytest

from drivers import cia402
from drivers.aerosmith_table import AerosmithTable, Line
from drivers.canopen_drive import Drive
from drivers.canopen_table import CanopenTable
from drivers.clock import SimClock
from drivers.errors import ConfigError, IdentityError, LimitError, LinkError, ReadBackError, RefusedError
from drivers.rate_table import TableLimits
from drivers.sim.cia402_table import SimulatedTable, TableSettings
from tests.support.aerosmith import SimulatedAerosmith

LIMITS = TableLimits(rate_dps=200.0, accel_dps2=50.0)
NODE = 5


class Bench:
    """A table, its simulated drive and the clock of both."""

    def __init__(self, settings=None, interface="virtual"):
        settings = settings or TableSettings()
        channel = uuid.uuid4().hex
        self.buses = [can.Bus(interface=interface, channel=channel, preserve_timestamps=True) for _ in range(2)]
        self.clock = SimClock()
        self.sim = SimulatedTable(self.buses[0], NODE, settings)
        self.clock.attach(self.sim.advance)
        drive = Drive(NODE, settings.counts_per_degree, latency_s=0.01)
        self.table = CanopenTable(self.buses[1], drive, LIMITS, self.clock)
        self.table._node.sdo.RESPONSE_TIMEOUT = 0.1  # of wall time, which a cut cable costs

    def turn(self, rate_dps, seconds=5):
        """Turn and return the readings of the last second."""
        self.table.set_rate(rate_dps)
        return self.live(seconds)

    def live(self, seconds):
        readings = None
        for _ in range(seconds):
            self.clock.sleep_until(self.clock.now() + 1.0)
            readings = self.table.poll()
        return readings

    def close(self):
        self.table.close()
        self.sim.close()
        for bus in self.buses:
            bus.shutdown()


@pytest.fixture(params=["virtual", "blocks"])
def any_bus(request):
    bench = Bench(interface=request.param)
    yield bench
    bench.close()


@pytest.fixture
def bench():
    bench = Bench()
    bench.table.identify()
    bench.table.prepare()
    yield bench
    bench.close()


def test_it_turns_at_the_commanded_rate_by_its_own_encoder(any_bus):
    table = any_bus.table
    assert "CiA 402 drive, node 5" in table.identify()
    assert table.prepare() == ()
    table.enable()
    readings = any_bus.turn(-30.0)
    assert len(readings) == 50
    assert np.mean(readings["rate_dps"]) == pytest.approx(-30.0, abs=0.001)
    assert np.diff(readings["t_s"]) == pytest.approx(0.02)
    moved = np.polyfit(readings["t_s"], readings["position_deg"], 1)[0]
    assert moved == pytest.approx(-30.0, abs=0.01)
    assert table.rate() == pytest.approx(-30.0, abs=0.05)
    assert table.position() == pytest.approx(any_bus.sim.angle_deg, abs=0.01)


def test_two_runs_read_the_same():
    def once():
        bench = Bench()
        bench.table.prepare()
        bench.table.enable()
        readings = bench.turn(12.5, 3)
        bench.close()
        return readings

    first, second = once(), once()
    assert np.array_equal(first, second)


def test_the_acceleration_is_limited(bench):
    bench.table.enable()
    bench.table.poll()
    readings = bench.turn(100.0, 1)
    slope = np.diff(readings["rate_dps"]) / np.diff(readings["t_s"])
    assert np.mean(slope) == pytest.approx(LIMITS.accel_dps2, rel=0.02)
    bench.live(3)
    bench.table.set_rate(0.0, accel_dps2=20.0)
    readings = bench.live(1)
    assert np.polyfit(readings["t_s"], readings["rate_dps"], 1)[0] == pytest.approx(-20.0, rel=0.02)


@pytest.mark.parametrize(("rate", "accel"), [(200.1, None), (-200.1, None), (10.0, 51.0), (10.0, 0.0), (np.nan, None)])
def test_what_is_outside_the_limits_is_refused_before_anything_is_sent(bench, rate, accel):
    bench.table.enable()
    sent = []
    bench.sim._node.add_write_callback(lambda **what: sent.append(what))
    with pytest.raises(LimitError, match="nothing was sent"):
        bench.table.set_rate(rate, accel)
    assert sent == []


def test_limits_must_be_limits():
    with pytest.raises(ConfigError, match="must be above 0"):
        TableLimits(0.0, 50.0)
    with pytest.raises(ConfigError, match="does not fit the drive's 32 bits"):
        Bench(TableSettings(counts_per_degree=2e7))


def test_quick_stop_in_mid_turn_is_verified_by_status_and_encoder(bench):
    bench.table.enable()
    bench.turn(100.0)
    steps = bench.table.safe()
    assert [(step.what, step.ok) for step in steps] == [
        ("rate table quick stop", True), ("rate table stands", True), ("rate table off", True),
    ]  # fmt: skip
    assert "quick stop active" in steps[0].detail
    assert "0.0" in steps[1].detail
    assert bench.sim.rate_dps == 0.0
    assert bench.sim.state == "switch on disabled"
    assert bench.table.safe() == []  # once is enough


def test_a_table_that_was_never_enabled_is_left_as_it_was_found(bench):
    assert bench.table.safe() == []


def test_a_table_that_does_not_stop_is_said(bench):
    bench.table.enable()
    bench.turn(100.0)
    bench.sim._node.set_data(cia402.QUICK_STOP_DECELERATION, 0, (10).to_bytes(4, "little"))  # brakes worn out
    stands = bench.table.safe()[1]
    assert not stands.ok
    assert "not 'standing' within" in stands.detail


def test_the_axis_stops_by_itself_when_the_bench_dies(bench):
    bench.table.enable()
    bench.turn(100.0)
    bench.clock.sleep_until(bench.clock.now() + 2.0)
    assert bench.sim.state == cia402.ENABLED
    bench.clock.sleep_until(bench.clock.now() + 4.0)  # nobody polls
    assert bench.sim.state == cia402.STOPPING
    assert bench.sim.rate_dps == 0.0
    with pytest.raises(ReadBackError, match="it was switched off externally"):
        bench.table.poll()


def test_a_cut_cable_is_a_lost_link_and_an_unverified_safe_state(bench):
    bench.table.enable()
    bench.turn(20.0)
    bench.sim.cut()
    with pytest.raises(LinkError, match="rate table node 5"):
        bench.live(1)
    steps = bench.table.safe()
    assert not any(step.ok for step in steps)
    bench.clock.sleep_until(bench.clock.now() + 6.0)
    assert bench.sim.rate_dps == 0.0  # the drive has missed our heartbeat as well


def test_a_drive_that_answers_but_reports_nothing_is_a_lost_link(bench):
    bench.table.enable()
    bench.turn(20.0)
    bench.sim._send = lambda *what: None
    with pytest.raises(LinkError, match="neither readings nor a heartbeat"):
        bench.live(5)


def test_a_fault_of_the_drive_is_told_and_never_cleared(bench):
    bench.table.enable()
    bench.turn(50.0)
    bench.sim.fail(0x2310)
    with pytest.raises(RefusedError, match="drive fault 0x2310") as caught:
        bench.live(1)
    assert caught.value.code == 0x2310
    bench.table.safe()
    assert bench.sim.state == cia402.FAULT
    with pytest.raises(RefusedError, match="reset it at the drive"):
        bench.table.enable()


def test_a_drive_that_lost_its_power_in_between_is_noticed(bench):
    bench.table.enable()
    bench.turn(50.0)
    bench.sim.reset()
    with pytest.raises(ReadBackError, match="switch on disabled"):
        bench.live(1)


def test_a_drive_of_another_kind_is_refused(bench):
    bench.sim._node.object_dictionary[cia402.DEVICE_TYPE].default = 0x0191  # an I/O device
    with pytest.raises(IdentityError, match="device profile 401"):
        bench.table.identify()


@pytest.mark.parametrize("unit", [10.0, 0.1])
def test_a_drive_with_another_unit_of_velocity_is_found_out_at_a_slow_rate(unit):
    bench = Bench(TableSettings(velocity_unit=unit))
    bench.table.prepare()
    with pytest.raises(IdentityError, match="commanded 1 deg/s, its position moves by"):
        bench.table.enable()
    assert all(step.ok for step in bench.table.safe())
    bench.close()


def test_without_pdo_and_heartbeat_the_readings_are_polled_and_the_lack_is_told():
    bench = Bench()
    for index in (cia402.TPDO1, cia402.CONSUMER_HEARTBEAT, cia402.ABORT_OPTION):
        del bench.sim._node.object_dictionary[index]
    told = bench.table.prepare()
    assert [text.split(":")[0] for text in told] == [
        "readings by PDO (they are polled)", "supervision of our heartbeat", "quick stop when our heartbeat is missing",
    ]  # fmt: skip
    bench.close()


def test_the_position_goes_on_when_the_register_goes_over_its_end():
    settings = TableSettings(counts_per_degree=1e7)  # +-215 degrees in 32 bits
    bench = Bench(settings)
    bench.table.prepare()
    bench.table.enable()
    bench.turn(50.0, 8)
    readings = bench.live(4)
    assert readings["position_deg"][-1] == pytest.approx(bench.sim.angle_deg, abs=0.01)
    bench.close()


# ---- Ideal Aerosmith -------------------------------------------------------------------------------------------------


@pytest.fixture
def serial_table():
    opened = []

    def make(jog_per_dps=1.0, jog_unit="deg/s", modulo=False):
        clock = SimClock()
        sim = SimulatedAerosmith(clock.now, jog_per_dps, modulo)
        table = AerosmithTable(Line(sim.port, timeout_s=0.5), LIMITS, clock, jog_unit)
        opened.extend([table, sim])
        return table, sim, clock

    yield make
    for thing in opened:
        thing.close()


def polled(table, clock, seconds):
    readings = [table.poll()]
    for _ in range(seconds):
        clock.sleep_until(clock.now() + 1.0)
        readings.append(table.poll())
    return np.concatenate(readings)


@pytest.mark.parametrize(("per_dps", "unit"), [(1.0, "deg/s"), (60.0, "deg/min")])
@pytest.mark.parametrize("modulo", [False, True])
def test_the_serial_table_turns_at_the_commanded_rate(serial_table, per_dps, unit, modulo):
    table, sim, clock = serial_table(per_dps, unit, modulo)
    assert "motion status 0" in table.identify()
    table.enable()
    table.set_rate(-100.0)
    readings = polled(table, clock, 10)
    assert readings["rate_dps"][-5:] == pytest.approx(-100.0, abs=0.01)
    assert readings["position_deg"][-1] == pytest.approx(sim._angle_deg, abs=0.01)
    assert all(step.ok for step in table.safe())
    assert sim._rate_dps == 0.0
    assert not sim.motor


@pytest.mark.parametrize(("per_dps", "unit"), [(60.0, "deg/s"), (1.0, "deg/min")])
def test_the_unit_of_jog_is_found_out_by_position_over_time(serial_table, per_dps, unit):
    table, sim, _ = serial_table(per_dps, unit)
    with pytest.raises(IdentityError, match=f"the station file states {unit}; correct jog_unit"):
        table.enable()
    assert abs(sim._target_dps) <= 1.0  # tried where nothing can be hurt
    assert all(step.ok for step in table.safe())


def test_a_silent_serial_table_is_a_lost_link(serial_table):
    table, sim, _ = serial_table()
    sim.silent = True
    with pytest.raises(LinkError, match="no answer within"):
        table.identify()


def test_a_refused_command_is_told(serial_table):
    table, _, _ = serial_table()
    with pytest.raises(RefusedError, match="was refused"):
        table._ask("XYZ")


def test_serial_limits_are_checked_before_anything_is_sent(serial_table):
    table, _, _ = serial_table()
    with pytest.raises(LimitError, match="nothing was sent"):
        table.set_rate(500.0)


def test_a_port_that_is_not_there_is_a_lost_link():
    with pytest.raises(LinkError, match="does not open"):
        AerosmithTable(Line("/dev/no-such-port"), LIMITS, SimClock())
