"""The driver of instruments: SCPI through pyvisa-sim and over a real socket, Modbus against servers."""

import os
import sys
import tty
from pathlib import Path
from unittest.mock import Mock

import pytest
from pydantic import ValidationError

from drivers.errors import ConfigError, IdentityError, LimitError, LinkError, ReadBackError
from drivers.instrument import Instrument, InstrumentRegister, Reading, Setting, open_line, plausible
from drivers.sim.instrument import ModbusInstrument, ScpiInstrument
from drivers.sim.ptys import PtyPair

LIBRARY = f"{Path(__file__).parent / 'visa.yaml'}@sim"
ON = Setting(command="OUTP 1", query="OUTP?", value=1)
OFF = Setting(command="OUTP 0", query="OUTP?", value=0)
VOLTAGE = Reading(channel="supply", query="V?")
OUTPUT = [("OUTP 1", "OUTP?", "1"), ("OUTP 0", "OUTP?", "0")]


def visa(address, **given):
    pytest.importorskip("pyvisa_sim")
    return Instrument("it", open_line(address, timeout_s=0.2, library=LIBRARY), **given)


@pytest.mark.parametrize("address", ["TCPIP0::192.168.1.20::inst0::INSTR", "GPIB0::22::INSTR"])
def test_a_visa_thermometer_is_read(address):
    thermometer = visa(address, identity="2210001")
    assert thermometer.identify() == "FLUKE,1524,2210001,1.6"
    reading = Reading(channel="reference_temperature", query="READ? 1", answer="{any},{value},C", offset=0.0035)
    assert thermometer.read(reading) == pytest.approx(-40.01, abs=1e-9)
    thermometer.close()
    assert thermometer.read(reading) == pytest.approx(-40.01, abs=1e-9)  # opened again


def test_a_visa_supply_is_set_and_read_back():
    supply = visa("ASRL1::INSTR")
    twelve = Setting(command="VOLT 12.000", query="VOLT?", value=12, tolerance=0.001)
    assert not supply.is_set(twelve)
    supply.set(twelve)
    supply.set(ON)
    assert supply.read(Reading(channel="supply", query="VOLT?")) == 12.0
    assert (supply.is_set(twelve), supply.is_set(ON), supply.is_set(OFF)) == (True, True, False)
    with pytest.raises(ReadBackError, match=r"it: VOLT 31.000 was sent, and 12.000 is read back instead of 31"):
        supply.set(Setting(command="VOLT 31.000", query="VOLT?", value=31))


def test_what_is_no_value_is_refused_by_name():
    thermometer = visa("GPIB0::22::INSTR", identity="2210002")
    with pytest.raises(LimitError, match=r"it: READ\? 2 answers 9.9E37: beyond the range"):
        thermometer.read(Reading(channel="humidity", query="READ? 2"))
    with pytest.raises(LimitError, match=r"answers '1,-40.0135,C', which does not fit '\{value\}'"):
        thermometer.read(Reading(channel="humidity", query="READ? 1"))
    with pytest.raises(IdentityError, match=r"it is 'FLUKE,1524,2210001,1.6', the station file says '2210002'"):
        thermometer.identify()
    with pytest.raises(LinkError, match=r"it: \*IDN\?: no answer"):
        visa("GPIB0::9::INSTR").identify()
    limited = Reading(channel="humidity", query="H?", low=0, high=100)
    assert plausible(limited, 30.0) == 30.0
    with pytest.raises(LimitError, match="humidity reads 101, the station file allows 0 to 100"):
        plausible(limited, 101.0)


def test_a_visa_address_without_pyvisa_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvisa", None)
    with pytest.raises(ConfigError, match=r"needs PyVISA: pip install 'gyro-thermal-bench\[instruments\]'"):
        open_line("GPIB0::22::INSTR")


@pytest.fixture
def scpi():
    server = ScpiInstrument("MAKER,MODEL,7,1.0", {"MEAS:VOLT?": lambda: "1.5E1"}, OUTPUT)
    yield server
    server.close()


@pytest.mark.parametrize("visa_library", [False, True])
def test_the_same_over_a_real_socket(scpi, visa_library):
    if visa_library:
        pytest.importorskip("pyvisa_py")
    address = f"TCPIP::127.0.0.1::{scpi.port}::SOCKET" if visa_library else f"socket://127.0.0.1:{scpi.port}"
    supply = Instrument("supply", open_line(address, timeout_s=5.0))
    assert supply.identify() == "MAKER,MODEL,7,1.0"
    assert supply.read(Reading(channel="supply", query="MEAS:VOLT?", unit="V")) == 15.0
    supply.set(ON)
    supply.set(OFF)
    assert scpi.told[-4:] == ["OUTP 1", "OUTP?", "OUTP 0", "OUTP?"]
    supply.close()


def test_an_instrument_that_is_silent_disobeys_or_is_gone_is_said(scpi):
    line = open_line(f"socket://127.0.0.1:{scpi.port}", timeout_s=0.3)
    supply = Instrument("supply", line)
    with pytest.raises(LinkError, match=r"supply: NONE\?: no answer within 0.3 s"):
        supply.read(Reading(channel="supply", query="NONE?"))
    scpi._values["V?"] = lambda: "9" * 5000
    with pytest.raises(LinkError, match=r"supply: V\?: an answer of 5000 characters, which begins with '9{40}'$"):
        supply.read(VOLTAGE)
    scpi.disobeys = True
    with pytest.raises(ReadBackError, match="supply: OUTP 1 was sent, and 0 is read back instead of 1"):
        supply.set(ON)
    scpi.disobeys = False
    supply.set(ON)
    supply.close()
    scpi.close()
    with pytest.raises(LinkError, match=rf"supply: {scpi.address}: .*refused"):
        supply.is_set(ON)


def test_a_serial_instrument_that_is_unplugged_or_takes_nothing_does_not_answer():
    pair = PtyPair()
    meter = Instrument("meter", open_line(pair.right, timeout_s=0.1))
    with pytest.raises(LinkError, match=r"meter: V\?: no answer within 0.1 s"):
        meter.read(VOLTAGE)
    meter._line.send("V")  # it is open now
    pair.close()
    with pytest.raises(LinkError, match=r"meter: /dev/pts/.*Input/output error"):
        meter.read(VOLTAGE)
    full, line = os.openpty()
    tty.setraw(line)
    deaf = open_line(os.ttyname(line), timeout_s=0.1)
    with pytest.raises(LinkError, match="Write timeout"):
        deaf.send("X" * 100_000)
    deaf.close()
    os.close(full)
    os.close(line)


@pytest.mark.parametrize("error", [EOFError(), RuntimeError("RPC: bad reply")])
def test_whatever_a_visa_library_raises_is_no_answer(error, monkeypatch):
    meter = visa("GPIB0::22::INSTR")
    meter.identify()
    monkeypatch.setattr(type(meter._line._resource), "write", Mock(side_effect=error))
    with pytest.raises(LinkError, match=r"it: GPIB0::22::INSTR: (EOFError|RPC: bad reply)$"):
        meter.read(VOLTAGE)


COIL = InstrumentRegister(address=0, type="bit", read=1, write=5, values={"off": 0, "on": 1})
HUMIDITY = InstrumentRegister(address=3, type="int16", read=4, scale=0.1)


def test_modbus_values_and_coils():
    with ModbusInstrument([HUMIDITY, COIL]) as server:
        server.show(HUMIDITY, 43.7)
        device = Instrument("hygrometer", open_line(server.url, timeout_s=5.0))
        assert device.identify() == ""
        assert device.read(Reading(channel="humidity", modbus=HUMIDITY)) == pytest.approx(43.7)
        on, off = (Setting(modbus=COIL, value=value) for value in ("on", "off"))
        assert not device.is_set(on)
        device.set(on)
        assert device.is_set(on)
        assert server.value(COIL) == "on"
        device.set(off)
        assert server.value(COIL) == "off"
        device.close()
    with pytest.raises(LinkError, match="hygrometer: "):
        device.read(Reading(channel="humidity", modbus=HUMIDITY))


@pytest.mark.parametrize(
    ("kind", "content", "said"),
    [
        (Reading, {"channel": "humidity"}, "either `query`"),
        (Reading, {"channel": "humidity", "query": "H?", "modbus": HUMIDITY}, "either `query`"),
        (Reading, {"channel": "humidity", "query": "H?", "answer": "{valu}"}, "needs `{value}` once"),
        (Reading, {"channel": "humidity", "modbus": COIL}, "a channel is a number"),
        (Reading, {"channel": "humidity", "query": "H?", "scale": 0}, "scale is 0"),
        (Setting, {"command": "OUTP 1", "value": 1}, "either `query`"),
        (Setting, {"query": "OUTP?", "value": 1}, "needs `command`"),
        (Setting, {"modbus": HUMIDITY, "value": 1}, "needs `write`"),
    ],
)
def test_a_description_that_cannot_be_is_refused(kind, content, said):
    with pytest.raises(ValidationError) as refused:
        kind(**content)
    assert said in str(refused.value)
