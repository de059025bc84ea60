"""A Modbus TCP server of modbus_tk, a library that is neither ours nor pymodbus."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

from modbus_tk import defines
from modbus_tk.modbus import Server, Slave
from modbus_tk.modbus_tcp import TcpServer

TRIES = 60_000


def started(server: Server) -> None:
    """Start its thread without `Event.isSet`: that warns, and a warning that is an error ends the thread."""
    server._go.isSet = server._go.is_set
    server.start()


def port_of(server: TcpServer) -> int:
    """The port that the server listens on; it is bound in the server's own thread."""
    for _ in range(TRIES):
        listener = server._sock
        if listener is not None and listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            return listener.getsockname()[1]
        time.sleep(0.001)
    raise TimeoutError("the server of modbus_tk does not listen")


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
