"""An axis of a fixture through its driver: a CiA 402 drive in profile position mode on a python-can bus."""

import uuid

import can
import pytest

from drivers import cia402
from drivers.canopen_axis import CanopenAxis
from drivers.canopen_drive import Drive
from drivers.clock import SimClock
from drivers.errors import LimitError, ReadBackError, RefusedError
from drivers.rate_table import TableLimits
from drivers.sim.cia402_table import SimulatedTable, TableSettings


class Bench:
    def __init__(self, counts_per_degree=11650.8444):
        channel = uuid.uuid4().hex
        self.buses = [can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) for _ in range(2)]
        self.clock = SimClock()
        self.sim = SimulatedTable(self.buses[0], 6, TableSettings())
        self.clock.attach(self.sim.advance)
        self.axis = CanopenAxis(self.buses[1], Drive(6, counts_per_degree), TableLimits(20.0, 10.0), self.clock)
        self.axis.identify()
        self.axis.prepare()

    def arrive(self, position_deg):
        """Go there; the time that it took [s]."""
        began, limit_s = self.clock.now(), self.axis.longest_s(position_deg)
        self.axis.go(position_deg)
        while not self.axis.arrived:
            assert self.clock.now() - began < limit_s
            self.clock.sleep_until(self.clock.now() + 0.5)
            self.axis.poll()
        return self.clock.now() - began


@pytest.fixture
def bench():
    bench = Bench()
    yield bench
    bench.axis.close()
    bench.sim.close()
    for bus in bench.buses:
        bus.shutdown()


def test_it_goes_to_a_position_by_the_profile_and_stays_there(bench):
    bench.axis.enable()
    took_s = bench.arrive(90.0)
    assert took_s == pytest.approx(90 / 20 + 20 / 10, abs=1.0)  # trapezoid
    assert bench.sim.angle_deg == pytest.approx(90.0, abs=0.003)
    bench.arrive(-45.0)
    for _ in range(5):
        bench.clock.sleep_until(bench.clock.now() + 1.0)
        bench.axis.poll()
    assert bench.sim.angle_deg == pytest.approx(-45.0, abs=0.003)
    assert bench.axis.position() == pytest.approx(-45.0, abs=0.003)


def test_nothing_moves_when_it_is_switched_on(bench):
    bench.axis.enable()
    bench.arrive(30.0)
    assert [step.ok for step in bench.axis.safe()] == [True, True, True]
    bench.axis.enable()
    bench.clock.sleep_until(bench.clock.now() + 3.0)
    assert bench.sim.angle_deg == pytest.approx(30.0, abs=0.003)


def test_the_quick_stop_ends_a_move(bench):
    bench.axis.enable()
    bench.axis.go(300.0)
    bench.clock.sleep_until(bench.clock.now() + 4.0)
    steps = bench.axis.safe()
    assert all(step.ok for step in steps), steps
    assert 40 < bench.sim.angle_deg < 110
    assert steps[0].what == "fixture axis quick stop"


def test_a_fault_on_the_way_is_told(bench):
    bench.axis.enable()
    bench.axis.go(100.0)
    bench.sim.fail(0x8611)
    with pytest.raises(RefusedError, match="fixture axis node 6: drive fault 0x8611"):
        bench.axis.poll()


def test_a_position_that_the_drive_cannot_hold_is_not_sent(bench):
    bench.axis.enable()
    with pytest.raises(LimitError, match="nothing was sent"):
        bench.axis.go(1e6)


def test_an_axis_that_stands_elsewhere_than_it_says_is_found(bench):
    bench.axis.enable()
    bench.arrive(10.0)
    bench.axis.go(12.0)
    bench.sim._node._read_callbacks.insert(0, lambda index, **_: 0x0627 if index == cia402.STATUS else None)
    with pytest.raises(ReadBackError, match=r"target reached, but its encoder reads 10\.0\d\d deg, -[12]\.\d+ deg off"):
        assert bench.axis.arrived
