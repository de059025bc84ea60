"""Every interface of python-can by its name: errors name missing packages, timing and filters are passed on."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import can
import numpy as np
import pytest
from pydantic import ValidationError

from bench.acquisition.station.settings.bus import Bus
from bench.acquisition.station.settings.unit import UnitSettings
from drivers.canbus import BusSettings, InProcessCapture, open_bus
from drivers.errors import ConfigError, LinkError
from drivers.interfaces import NEEDS, _options, unit_filters
from drivers.journal import JournalWriter
from drivers.sim.can_gyro import CanGyro

OURS = {"blocks", "loopcan", "virtual", "faulty"}


def test_every_interface_of_python_can_is_known():
    """A new version of python-can may add one."""
    assert set(can.VALID_INTERFACES) - OURS - {"socketcand"} == set(NEEDS)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere other libraries are missing")
@pytest.mark.parametrize(
    ("interface", "named"),
    [
        ("pcan", "PCAN-Basic"),
        ("kvaser", "CANlib"),
        ("vector", "XL Driver Library"),
        ("ixxat", "VCI"),
        ("nixnet", "NI-XNET"),
        ("neovi", "python-ics"),
        ("systec", "USB-CAN"),
        ("canalystii", "canalystii"),
        ("gs_usb", "gs-usb"),
    ],
)
def test_a_library_that_is_not_there_is_named(interface: str, named: str):
    try:
        bus = open_bus(BusSettings(interface, "0", 500_000))
    except LinkError:
        pytest.skip(f"the library of {interface} is installed here")
    except ConfigError as error:
        text = str(error)
        assert f"CAN bus {interface}:0: " in text
        assert f"{interface} needs " in text
        assert named in text
        assert "\n" not in text
    else:
        bus.shutdown()
        pytest.skip(f"{interface} works here")


def test_an_interface_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(ConfigError, match=r"no interface 'pcam'; it has .*pcan.*socketcan"):
        open_bus(BusSettings("pcam", "PCAN_USBBUS1"))


def test_a_wrong_option_is_refused():
    with pytest.raises(ConfigError, match=r"socketcand:can0: .*host.*options"):
        open_bus(BusSettings("socketcand", "can0"))
    with pytest.raises(ConfigError, match="receive_own_messages must stay off"):
        open_bus(BusSettings("virtual", "x", options={"receive_own_messages": True}))


def test_an_adapter_that_is_not_plugged_in_is_a_link_error():
    with pytest.raises(LinkError, match="does not open"):
        open_bus(BusSettings("slcan", "/dev/ttyNOTHING", 500_000))


def test_bit_rates_and_timing_reach_the_interface():
    assert _options(BusSettings("pcan", "c", 500_000)) == {"bitrate": 500_000}
    fd = Bus(interface="pcan", channel="c", bitrate=500_000, fd=True, data_bitrate=2_000_000).to_driver()
    assert _options(fd) == {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000}
    exact = {"f_clock": 8_000_000, "brp": 1, "tseg1": 13, "tseg2": 2, "sjw": 1}
    timing = _options(Bus(interface="slcan", channel="c", timing=exact).to_driver())["timing"]
    assert isinstance(timing, can.BitTiming)
    assert timing.bitrate == 500_000
    point = {
        "f_clock": 80_000_000,
        "nom_bitrate": 500_000,
        "nom_sample_point": 80.0,
        "data_bitrate": 2_000_000,
        "data_sample_point": 75.0,
    }
    timing = _options(Bus(interface="kvaser", channel="c", fd=True, timing=point).to_driver())["timing"]
    assert isinstance(timing, can.BitTimingFd)
    assert (timing.nom_bitrate, timing.data_bitrate) == (500_000, 2_000_000)


@pytest.mark.parametrize("timing", [{"f_clock": 8_000_000}, {"f_clock": 1, "brp": 1, "tseg1": 1, "tseg2": 1, "sjw": 9}])
def test_a_timing_that_cannot_be_is_refused(timing: dict[str, int]):
    with pytest.raises(ConfigError, match="timing"):
        open_bus(BusSettings("pcan", "c", timing=timing))


def test_a_station_file_that_contradicts_itself_is_refused():
    with pytest.raises(ValidationError, match="only CAN FD"):
        Bus(interface="pcan", channel="c", data_bitrate=2_000_000)
    with pytest.raises(ValidationError, match="exclude each other"):
        Bus(interface="pcan", channel="c", bitrate=1, timing={"f_clock": 1})


def test_filters_let_through_the_units_of_the_station_and_nothing_else():
    units = [UnitSettings(serial="a", bus="b", number=2), UnitSettings(serial="c", bus="b", number=5)]
    filters = Bus(interface="blocks", channel="x").to_driver(units).filters
    assert filters == unit_filters([("vibratory", 2, None), ("vibratory", 5, None)])
    assert len(filters) == 10
    everything = Bus(interface="blocks", channel="x", filtered=False).to_driver(units)
    assert not everything.filters

    with open_bus(BusSettings("blocks", "filter")) as sender:
        bus = open_bus(BusSettings("blocks", "filter", filters=filters))
        for number in (2, 3, 5):
            CanGyro(sender, number, number).send(0.0, _signals())
        sender.send(can.Message(arbitration_id=0x555, is_extended_id=False))
        sender.send(can.Message(arbitration_id=0x122, is_extended_id=True))
        numbers = bus.recv_block(0.0)["id"] & 0xF
        assert set(numbers.tolist()) == {2, 5}
        bus.shutdown()


def _signals() -> SimpleNamespace:
    slow = np.zeros(50)
    rate = np.zeros(500)
    return SimpleNamespace(rate_dph=rate, temperature=slow, frequency=slow, drive=slow, quadrature=slow, supply=5.0)


def test_a_long_fd_frame_is_counted_and_a_short_one_kept(tmp_path):
    with open_bus(BusSettings("virtual", "fd")) as sender, open_bus(BusSettings("virtual", "fd")) as bus:
        writer = JournalWriter(tmp_path / "j")
        capture = InProcessCapture(bus, writer, stamp=lambda t_s: round(t_s * 1e9))
        sender.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(8)))
        sender.send(can.Message(arbitration_id=2, is_fd=True, data=bytes(12)))
        sender.send(can.Message(arbitration_id=3, data=bytes(8)))
        assert capture.poll()["id"].tolist() == [1, 3]
        assert (capture.health().unreadable, capture.health().state) == (1, "ok")
        writer.close()
