"""A raw RTU device of our own, on a pty or a TCP socket, that answers some requests later than the client waits."""

from __future__ import annotations

import os
import random
import select
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from modbus_tk.utils import calculate_crc

from drivers.registers import Register

TIMEOUT_S, LATE_S, SLOWEST_S = 0.1, 0.16, 0.8
"""The client waits, a late answer takes, no answer takes; far apart, so that a busy computer changes nothing."""


def register(address: int) -> Register:
    return Register(name=f"r{address}", address=address, type="uint16", meaning="its own address", source="test")


class SlowDevice:
    """Every register holds its own address; a share of the answers comes late. One request at a time, as on a wire."""

    def __init__(self, read: Callable[[], bytes], write: Callable[[bytes], object], share: float = 0.25) -> None:
        self._read, self._write = read, write
        self._share, self._random = share, random.Random(1)
        self.late = 0
        self.thread = threading.Thread(target=self._serve)
        self.thread.start()

    def _serve(self) -> None:
        data = b""
        with suppress(OSError):
            while new := self._read():
                data += new
                while len(data) >= 8:
                    self._answer(data[:8])
                    data = data[8:]

    def _answer(self, request: bytes) -> None:
        device, code, address, count = struct.unpack(">BBHH", request[:6])
        if self._random.random() < self._share:
            self.late += 1
            time.sleep(LATE_S)
        frame = struct.pack(f">BBB{count}H", device, code, 2 * count, *range(address, address + count))
        self._write(frame + struct.pack(">H", calculate_crc(frame)))


@contextmanager
def on_a_pty(share: float = 0.25) -> Iterator[tuple[str, SlowDevice]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    stopped, stop = os.pipe()

    def read() -> bytes:
        return b"" if stopped in select.select([master, stopped], [], [])[0] else os.read(master, 300)

    box = SlowDevice(read, lambda data: os.write(master, data), share)
    try:
        yield os.ttyname(slave), box
    finally:
        os.close(stop)
        box.thread.join()
        for end in (stopped, master, slave):
            os.close(end)


@contextmanager
def behind_a_gateway(share: float = 0.25) -> Iterator[tuple[int, SlowDevice]]:
    """RTU frames over TCP; one client, as the usual gateways have it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        connection: list[socket.socket] = []

        def read() -> bytes:
            if not connection:
                connection.append(listener.accept()[0])
            return connection[0].recv(300)

        def write(data: bytes) -> None:
            connection[0].sendall(data)

        box = SlowDevice(read, write, share)
        try:
            yield listener.getsockname()[1], box
        finally:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            for end in connection:
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
                end.close()
            box.thread.join()


def poll(read: Callable[[int], int | None], count: int) -> tuple[int, int]:
    """Read three registers in turn; how many reads returned a wrong value, and how many none."""
    wrong = failed = 0
    for k in range(count):
        address = (100, 200, 300)[k % 3]
        value = read(address)
        failed += value is None
        wrong += value is not None and value != address
    return wrong, failed
