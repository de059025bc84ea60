"""The simulated controller, accessed by independent programs and by hand-made frames."""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess
import threading

import pytest
from modbus_tk import defines
from modbus_tk.exceptions import ModbusError
from modbus_tk.modbus_tcp import TcpMaster

from drivers.errors import ConfigError, LinkError
from drivers.registers import load_map, parse_map
from drivers.sim.modbus_chamber import ChamberCommands, ModbusChamber
from tests.drivers.test_chamber import HOST_STEPPED

F4T = load_map("watlow_f4t")


@pytest.fixture
def chamber():
    with ModbusChamber(F4T, limits=(-45.0, 130.0)) as chamber:
        yield chamber


@pytest.fixture
def master(chamber: ModbusChamber):
    master = TcpMaster("127.0.0.1", chamber.port, timeout_in_sec=5)
    yield master
    master.close()


def mbpoll(chamber: ModbusChamber, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("mbpoll")
    if program is None:
        pytest.skip("mbpoll (Debian package of that name) is not installed")
    command = [program, "-m", "tcp", "-p", str(chamber.port), "-a", "1", "-0", "-1", "-q", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


def test_mbpoll_reads_the_process_value(chamber: ModbusChamber):
    chamber.publish(temperature=-12.75, working_setpoint=-13.0)
    answer = mbpoll(chamber, "-r", "2820", "-t", "4:float", "127.0.0.1")
    assert answer.returncode == 0, answer.stderr
    assert "-12.75" in answer.stdout


def test_mbpoll_writes_a_set_point(chamber: ModbusChamber):
    answer = mbpoll(chamber, "-r", "2782", "-t", "4:float", "127.0.0.1", "--", "-40.5")
    assert answer.returncode == 0, answer.stderr
    assert chamber.commands() == ChamberCommands(-40.5, False, None)


def test_mbpoll_is_told_when_the_set_point_is_out_of_limits(chamber: ModbusChamber):
    answer = mbpoll(chamber, "-r", "2782", "-t", "4:float", "127.0.0.1", "200")
    assert "Illegal data value" in answer.stdout + answer.stderr
    assert chamber.commands().setpoint == 25.0


def read(master: TcpMaster, address: int, count: int, code: int = defines.READ_HOLDING_REGISTERS) -> tuple[int, ...]:
    return tuple(master.execute(1, code, address, count))


def write(master: TcpMaster, address: int, *words: int) -> None:
    if len(words) == 1:
        master.execute(1, defines.WRITE_SINGLE_REGISTER, address, output_value=words[0])
    else:
        master.execute(1, defines.WRITE_MULTIPLE_REGISTERS, address, output_value=list(words))


def test_floats_go_out_low_word_first(chamber: ModbusChamber, master: TcpMaster):
    chamber.publish(temperature=-40.5, working_setpoint=25.0)
    assert read(master, 2820, 2) == (0x0000, 0xC222)


def test_the_part_number_is_one_character_a_register(master: TcpMaster):
    assert bytes(read(master, 16, 3)) == b"F4T"


def test_the_polled_block_reads_across_its_holes(chamber: ModbusChamber, master: TcpMaster):
    words = read(master, 2782, 40)
    assert words[38:40] == (0x0000, 0x41C8)
    assert words[32] == 62


@pytest.mark.parametrize(
    ("address", "words", "code"),
    [
        (2820, (0, 0x41C8), 2),  # process value: read only
        (2774, (0, 0x41C8), 2),  # limit: read only
        (2782, (0x41C8,), 2),  # half a float
        (2783, (0x41C8, 0), 2),  # from its middle
        (2790, (1, 1), 2),  # a hole
        (9000, (1,), 2),  # nothing there
        (2782, (0, 0x4348), 3),  # 200 degC, outside the controller's limits
        (2782, (0, 0x7FC0), 3),  # NaN
        (2782, (0x41C8, 0x0000), 3),  # 25.0 with its words swapped
        (2730, (11,), 3),  # no such mode
        (2798, (0, 0xBF80), 3),  # a negative ramp rate
    ],
)
def test_a_wrong_write_is_refused_whole(
    chamber: ModbusChamber, master: TcpMaster, address: int, words: tuple[int, ...], code: int
):
    before = chamber.commands()
    with pytest.raises(ModbusError) as refused:
        write(master, address, *words)
    assert refused.value.get_exception_code() == code
    assert chamber.commands() == before


def test_a_write_that_begins_right_and_ends_wrong_changes_nothing(chamber: ModbusChamber, master: TcpMaster):
    with pytest.raises(ModbusError):
        write(master, 2794, 85, 0, 57)  # ramp action, then the hole behind it
    assert read(master, 2794, 1) == (62,)


@pytest.mark.parametrize("code", [defines.READ_COILS, defines.READ_INPUT_REGISTERS, defines.READ_DISCRETE_INPUTS])
def test_functions_that_the_controller_does_not_have_are_refused(master: TcpMaster, code: int):
    with pytest.raises(ModbusError) as refused:
        read(master, 2782, 2, code)
    assert refused.value.get_exception_code() == 1


def test_commands_follow_the_registers(chamber: ModbusChamber, master: TcpMaster):
    assert chamber.commands() == ChamberCommands(25.0, False, None)
    write(master, 2798, 0x0000, 0x4000)
    write(master, 2794, 85)
    write(master, 2782, 0x0000, 0x42AA)
    write(master, 2730, 10)
    assert chamber.commands() == ChamberCommands(85.0, True, 2.0)
    assert read(master, 2814, 1) == (10,)
    write(master, 2794, 62)
    assert chamber.commands().ramp_rate_degc_per_min is None


def test_the_plant_shows_in_the_registers(chamber: ModbusChamber, master: TcpMaster):
    chamber.publish(temperature=20.0, working_setpoint=21.0, power=-30.0, compressor=True, alarms=["alarm_2"])
    assert read(master, 33718, 1) == (63,)
    assert read(master, 2808, 2) == (0x0000, 0xC1F0)
    assert read(master, 1356, 1)[0] in (88, 61, 12)
    assert read(master, 1456, 1)[0] not in (88, 61, 12)
    chamber.publish(temperature=20.0, working_setpoint=21.0)
    assert read(master, 1456, 1)[0] in (88, 61, 12)


def test_a_plant_that_trips_shows_off(chamber: ModbusChamber, master: TcpMaster):
    write(master, 2730, 10)
    chamber.publish(temperature=20.0, working_setpoint=21.0, on=False)
    assert read(master, 2814, 1) == (62,)


def test_an_alarm_that_the_map_does_not_know_is_our_mistake(chamber: ModbusChamber):
    with pytest.raises(ConfigError, match="alarm_9"):
        chamber.publish(temperature=20.0, working_setpoint=21.0, alarms=["alarm_9"])


def test_any_map_is_served():
    with ModbusChamber(parse_map(HOST_STEPPED, "f4")) as chamber:
        master = TcpMaster("127.0.0.1", chamber.port, timeout_in_sec=5)
        write(master, 300, 0x10000 - 230)
        write(master, 202, 1)
        assert chamber.commands() == ChamberCommands(-23.0, True, None)
        assert read(master, 0, 1) == (5270,)
        master.close()


def test_a_request_in_two_pieces_is_one_request(chamber: ModbusChamber):
    request = bytes.fromhex("0007 0000 0006 01 03 0b04 0002")
    with socket.create_connection(("127.0.0.1", chamber.port), timeout=5) as wire:
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        wire.sendall(request[:7])
        wire.sendall(request[7:])
        assert wire.recv(100) == bytes.fromhex("0007 0000 0007 01 03 04 0000 41c8")


def test_clients_at_the_same_time_are_answered_apart(chamber: ModbusChamber):
    chamber.publish(temperature=-40.5, working_setpoint=25.0)
    wrong = []

    def ask(address: int, expected: bytes) -> None:
        with socket.create_connection(("127.0.0.1", chamber.port), timeout=10) as wire:
            for number in range(100):
                wire.sendall(struct.pack(">HHHBBHH", number, 0, 6, 1, 3, address, 2))
                answer = wire.recv(100)
                if answer[:2] != struct.pack(">H", number) or answer[9:] != expected:
                    wrong.append(answer)

    threads = [
        threading.Thread(target=ask, args=arguments)
        for arguments in [(2820, bytes.fromhex("0000c222")), (2810, bytes.fromhex("000041c8"))]
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_closing_leaves_neither_thread_nor_port_behind():
    before = set(threading.enumerate())
    chamber = ModbusChamber(F4T)
    port = chamber.port
    with socket.create_connection(("127.0.0.1", port), timeout=5) as wire:
        wire.sendall(bytes.fromhex("0007 0000 0006 01 03 0b04 0002"))
        assert wire.recv(100)
        chamber.close()
        chamber.close()
        assert wire.recv(10) == b""
    assert set(threading.enumerate()) == before
    with ModbusChamber(F4T, port=port) as again:
        assert again.port == port


def test_a_taken_port_is_a_clear_error(chamber: ModbusChamber):
    with pytest.raises(LinkError, match=str(chamber.port)):
        ModbusChamber(F4T, port=chamber.port)
