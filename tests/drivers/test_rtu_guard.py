"""RTU answers are not numbered. With a quarter of them late, the link never returns a value of another register."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerType

from drivers.errors import LinkError
from drivers.modbus import ModbusLink
from tests.support.slow_device import SLOWEST_S, TIMEOUT_S, behind_a_gateway, on_a_pty, poll, register

READS = 18


def guarded(link: ModbusLink) -> Callable[[int], int | None]:
    def read(address: int) -> int | None:
        try:
            return int(link.read(register(address)))
        except LinkError:
            return None

    return read


def unguarded(client: ModbusSerialClient | ModbusTcpClient) -> Callable[[int], int | None]:
    def read(address: int) -> int | None:
        try:
            answer = client.read_holding_registers(address, count=1, device_id=1)
        except ModbusException:
            return None
        return None if answer.isError() else answer.registers[0]

    return read


@pytest.mark.parametrize("attempts", [1, 3])
@pytest.mark.slow
def test_on_a_serial_line_no_late_answer_becomes_a_wrong_value(attempts: int):
    with on_a_pty() as (line, device):
        link = ModbusLink(f"rtu://{line}", timeout_s=TIMEOUT_S, slowest_s=SLOWEST_S, attempts=attempts)
        wrong, failed = poll(guarded(link), READS)
        link.close()
    assert device.late >= READS // 6
    assert wrong == 0
    assert failed <= device.late
    assert link.counters.faults >= device.late


@pytest.mark.slow
def test_over_a_gateway_no_late_answer_becomes_a_wrong_value():
    with behind_a_gateway() as (port, device):
        link = ModbusLink(f"rtu+tcp://127.0.0.1:{port}", timeout_s=TIMEOUT_S, slowest_s=SLOWEST_S, attempts=1)
        wrong, _ = poll(guarded(link), READS)
        link.close()
    assert device.late >= READS // 6
    assert wrong == 0
    assert link.counters.connections == 1


@pytest.mark.parametrize("retries", [0, 3])
def test_the_same_line_without_the_guard_returns_wrong_values(retries: int):
    """Otherwise the tests above would show nothing."""
    with on_a_pty() as (line, _):
        client = ModbusSerialClient(line, timeout=TIMEOUT_S, retries=retries)
        client.connect()
        wrong, _ = poll(unguarded(client), READS)
        client.close()
    assert wrong > 0


def test_the_same_gateway_without_the_guard_returns_wrong_values():
    with behind_a_gateway() as (port, _):
        client = ModbusTcpClient("127.0.0.1", port=port, framer=FramerType.RTU, timeout=TIMEOUT_S, retries=0)
        client.connect()
        wrong, _ = poll(unguarded(client), READS)
        client.close()
    assert wrong > 0


def test_the_device_ends_although_requests_are_left_unread():
    with on_a_pty(share=1.0) as (line, device), Path(line).open("wb", buffering=0) as client:
        client.write(2 * bytes.fromhex("01 03 0064 0001 C5D5"))
    assert device.late <= 2
