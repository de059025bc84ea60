"""A Modbus TCP server of modbus_tk, a library that is neither ours nor pymodbus."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from modbus_tk import defines
from modbus_tk.modbus import Server, Slave
from modbus_tk.modbus_tcp import TcpServer

from tests.support.waiting import until


def started(server: Server) -> None:
    """Start its thread without `Event.isSet`: that warns, and a warning that is an error ends the thread."""
    server._go.isSet = server._go.is_set
    server.start()


def port_of(server: TcpServer) -> int:
    """The port that the server listens on; it is bound in the server's own thread."""
    until(lambda: server._sock is not None and server._sock.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN))
    return server._sock.getsockname()[1]


@contextmanager
def holding(name: str, first: int, count: int) -> Iterator[tuple[Slave, int]]:
    """A server whose device 1 has a block of holding registers: the device, and the port."""
    server = TcpServer(port=0, address="127.0.0.1", timeout_in_sec=1)
    slave = server.add_slave(1)
    slave.add_block(name, defines.HOLDING_REGISTERS, first, count)
    started(server)
    try:
        yield slave, port_of(server)
    finally:
        server.stop()
