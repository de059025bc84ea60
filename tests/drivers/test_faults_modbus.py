"""Each fault of the Modbus wire: what the link returns or raises, the next request, the counts."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import minimalmodbus
import pytest
from modbus_tk.modbus import Slave

from drivers.errors import DriverError, LinkError, RefusedError
from drivers.modbus import ModbusLink
from drivers.registers import Register
from drivers.sim.faults.named import ON_MODBUS
from drivers.sim.faults.proxy import Front, ModbusProxy
from tests.support import foreign_server


def number(name: str, address: int, write: int | None = None) -> Register:
    """A temperature as the Watlow F4T holds it."""
    limits = {"low": -80.0, "high": 200.0, "unit": "degC", "meaning": "air", "source": "F4T"}
    return Register(name=name, address=address, type="float32", word_order="low_first", write=write, **limits)


PV, SP = number("temperature", 2820), number("setpoint", 2782, write=16)
WORDS_25 = [0x0000, 0x41C8]  # 25.0, low word first
WORDS_MINUS_40 = [0x0000, 0xC222]
TIMEOUT_S, SLOWEST_S, PATIENT_S = 0.08, 0.3, 10.0

RAISES: dict[str, tuple[type[DriverError], str]] = {
    "delay": (LinkError, "no valid answer"),
    "drop": (LinkError, "no valid answer"),
    "silence": (LinkError, "no valid answer"),
    "truncate": (LinkError, "no valid answer"),
    "garble": (LinkError, "no valid answer"),
    "transaction": (LinkError, "no valid answer"),
    "device": (LinkError, "no valid answer"),
    "function": (LinkError, "belongs to function 4"),
    "count": (LinkError, "the answer has 1 words"),
    "exception": (RefusedError, "exception 6, device busy"),
    "echo": (LinkError, "no valid answer"),
    "close": (LinkError, "no valid answer"),
    "refuse": (LinkError, "no connection|no valid answer|connection"),
}
"""What one request raises under each fault; the others are harmless or lie, see below."""

FRONTS: dict[Front, list[str]] = {
    "tcp": [name for name in RAISES if name != "echo"],
    "rtu+tcp": [name for name in RAISES if name != "transaction"],
    "rtu": [name for name in RAISES if name not in ("transaction", "close", "refuse")],
}
CASES = [(front, name) for front, names in FRONTS.items() for name in names]
CONNECTED = [case for case in CASES if case[1] != "refuse"]


@pytest.fixture(scope="module")
def upstream() -> Iterator[tuple[Slave, int]]:
    """A healthy server that is neither ours nor pymodbus: its device and its port."""
    with foreign_server.holding("f4t", 2700, 200) as (slave, port):
        yield slave, port


@pytest.fixture
def device(upstream: tuple[Slave, int]) -> Slave:
    slave = upstream[0]
    slave.set_values("f4t", PV.address, WORDS_25)
    slave.set_values("f4t", SP.address, WORDS_25)
    return slave


@contextmanager
def served(upstream: tuple[Slave, int], front: Front = "tcp", attempts: int = 1) -> Iterator:
    proxy = ModbusProxy(("127.0.0.1", upstream[1]), front)
    link = ModbusLink(proxy.url, timeout_s=TIMEOUT_S, slowest_s=SLOWEST_S, attempts=attempts)
    link._client.comm_params.timeout_connect = PATIENT_S
    try:
        yield proxy, link
    finally:
        link.close()
        proxy.close()


@contextmanager
def hurried(link: ModbusLink) -> Iterator[None]:
    """The short timeout is used only when no answer must come: a busy computer is not a fault of the wire."""
    link._client.comm_params.timeout_connect = TIMEOUT_S
    yield
    link._client.comm_params.timeout_connect = PATIENT_S


@pytest.mark.parametrize("front", FRONTS)
def test_without_faults_the_proxy_is_not_noticed(upstream, device, front: Front):
    with served(upstream, front) as (proxy, link):
        assert link.read(PV) == 25.0
        link.write(SP, -40.5)
        assert device.get_values("f4t", SP.address, 2) == tuple(WORDS_MINUS_40)
        assert link.read(SP) == -40.5
        assert (link.counters.requests, link.counters.faults, link.counters.connections) == (3, 0, 1)
        assert proxy.requests == 3
        assert not proxy.counts


@pytest.mark.parametrize(("front", "name"), CASES)
def test_a_fault_is_an_error_and_the_request_after_it_is_right(upstream, device, front: Front, name: str):
    error, text = RAISES[name]
    with served(upstream, front) as (proxy, link):
        assert link.read(SP) == 25.0
        device.set_values("f4t", SP.address, WORDS_MINUS_40)
        proxy.inject(name, seconds=3 * TIMEOUT_S)
        with hurried(link), pytest.raises(error, match=text):
            link.read(PV)
        proxy.clear()
        assert link.read(SP) == -40.5, "the value of now, and of this register"
        assert link.counters.faults == (error is LinkError)
        assert proxy.counts[name] >= 1


@pytest.mark.parametrize(("front", "name"), CONNECTED)
def test_a_fault_that_strikes_once_is_asked_away(upstream, device, front: Front, name: str):
    with served(upstream, front, attempts=9) as (proxy, link):
        assert link.read(SP) == 25.0
        proxy.inject(name, times=1, seconds=1.5 * TIMEOUT_S)
        with hurried(link):
            assert link.read(PV) == 25.0
        assert link.counters.retries >= 1
        assert proxy.counts[name] == 1


@pytest.mark.parametrize("front", FRONTS)
def test_an_answer_in_two_pieces_is_an_answer(upstream, device, front: Front):
    with served(upstream, front) as (proxy, link):
        proxy.inject("split")
        assert link.read(PV) == 25.0
        assert link.counters.faults == 0


def test_a_short_delay_is_no_fault(upstream, device):
    with served(upstream) as (proxy, link):
        proxy.inject("delay", seconds=TIMEOUT_S)
        assert link.read(PV) == 25.0
        assert link.counters.faults == 0


def test_a_stuck_value_looks_sound_on_the_wire(upstream, device):
    """A check of the answer cannot detect it: the guard on a frozen value does, and the read-back of a write."""
    with served(upstream) as (proxy, link):
        proxy.inject("stuck")
        assert (link.read(PV), link.read(SP)) == (25.0, 25.0)
        device.set_values("f4t", PV.address, WORDS_MINUS_40)
        link.write(SP, -40.5)
        assert (link.read(PV), link.read(SP)) == (25.0, 25.0)
        assert link.counters.faults == 0
        proxy.clear("stuck")
        assert (link.read(PV), link.read(SP)) == (-40.5, -40.5)


@pytest.mark.parametrize("name", ["drop", "truncate", "close"])
def test_a_write_whose_answer_was_lost_did_reach_the_device(upstream, device, name: str):
    """So after an error the state is unknown: read back first."""
    with served(upstream) as (proxy, link):
        assert link.read(SP) == 25.0
        proxy.inject(name, times=1)
        with hurried(link), pytest.raises(LinkError):
            link.write(SP, -40.5)
        assert link.read(SP) == -40.5


def test_a_write_that_was_never_heard_did_not(upstream, device):
    with served(upstream) as (proxy, link):
        assert link.read(SP) == 25.0
        proxy.inject("silence", times=1)
        with hurried(link), pytest.raises(LinkError):
            link.write(SP, -40.5)
        assert link.read(SP) == 25.0


@pytest.mark.parametrize("name", ["count", "function"])
def test_a_write_with_a_foreign_echo_is_an_error(upstream, device, name: str):
    with served(upstream) as (proxy, link):
        assert link.read(SP) == 25.0
        proxy.inject(name)
        with hurried(link), pytest.raises(LinkError, match=r"echoes another write|belongs to function|no valid answer"):
            link.write(SP, -40.5)


def test_a_gateway_that_gives_up_before_its_device_does_not_mislead_the_next_request(upstream, device):
    """Exception 11 over RTU; the device's answer follows and would be mistaken for the next one."""
    with served(upstream, "rtu+tcp", attempts=9) as (proxy, link):
        assert link.read(SP) == 25.0
        proxy.inject("exception", times=1, code=11)
        with hurried(link):
            assert link.read(PV) == 25.0
        assert proxy.counts["exception"] == 1
        assert link.counters.retries >= 1
        assert link.counters.connections == 1, "a serial gateway keeps its one client"


def test_faults_repeat_with_their_seed(upstream, device):
    def struck() -> list[bool]:
        with served(upstream) as (proxy, link):
            proxy.inject("exception", share=0.5, code=2)
            return [isinstance(_outcome(link), RefusedError) for _ in range(20)]

    first = struck()
    assert first == struck()
    assert 0 < sum(first) < 20


def _outcome(link: ModbusLink) -> object:
    try:
        return link.read(PV)
    except DriverError as error:
        return error


def test_a_fault_that_does_not_exist_here_is_refused(upstream):
    with served(upstream) as (proxy, _):
        for name in ("echo", "nonsense"):
            with pytest.raises(ValueError, match="must be one of"):
                proxy.inject(name)
    assert set(RAISES) | {"split", "stuck", "ignore"} == set(ON_MODBUS)


@pytest.mark.parametrize("front", FRONTS)
def test_a_write_that_is_confirmed_and_not_executed_shows_when_it_is_read_back(upstream, device, front: Front):
    device.set_values("f4t", SP.address, WORDS_MINUS_40)
    with served(upstream, front) as (proxy, link):
        proxy.inject("ignore")
        link.write(SP, 25.0)
        assert link.read(SP) == -40.5
        proxy.clear()
        link.write(SP, 25.0)
        assert link.read(SP) == 25.0


def test_minimalmodbus_reads_our_serial_line(upstream, device):
    with served(upstream, "rtu") as (proxy, _):
        peer = minimalmodbus.Instrument(proxy.url.removeprefix("rtu://"), 1)
        peer.serial.timeout = 1.0
        assert peer.read_float(PV.address, byteorder=minimalmodbus.BYTEORDER_LITTLE_SWAP) == 25.0
        peer.write_registers(SP.address, WORDS_MINUS_40)
        assert device.get_values("f4t", SP.address, 2) == tuple(WORDS_MINUS_40)
        proxy.inject("garble", times=1)
        with pytest.raises(minimalmodbus.ModbusException):
            peer.read_registers(PV.address, 2)
        peer.serial.close()


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="needs mbpoll (libmodbus)")
@pytest.mark.parametrize("front", ["tcp", "rtu"])
def test_libmodbus_reads_through_the_proxy(upstream, device, front: Front):
    with served(upstream, front) as (proxy, _):
        if front == "rtu":
            where = ["-m", "rtu", "-b", "19200", "-P", "none", proxy.url.removeprefix("rtu://")]
        else:
            where = ["-m", "tcp", "-p", str(proxy.port), "127.0.0.1"]
        command = ["mbpoll", "-0", "-a", "1", "-t", "4:float", "-r", str(PV.address), "-1", *where]
        said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout
        assert f"[{PV.address}]: \t25" in said
