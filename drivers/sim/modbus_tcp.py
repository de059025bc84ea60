"""A Modbus TCP server in a thread of its own, without an event loop: a request costs two system calls and no more.

Framing and exceptions after "MODBUS Messaging on TCP/IP Implementation Guide V1.0b" and "MODBUS Application Protocol
Specification V1.1b3". A request for another device is not answered, as behind a gateway; a connection that does not
speak Modbus is closed.
"""

from __future__ import annotations

import selectors
import socket
import struct
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass

Answer = Callable[[int, int, int, "Sequence[int] | None"], "Sequence[int] | int"]
"""(function code, address, count, words to write or None) to the words read ([] for a write), or an exception code."""

_HEAD, _PAIR = struct.Struct(">HHHB"), struct.Struct(">HH")
_MOST_READ, _MOST_WRITTEN, _MOST_FRAME = 125, 123, 254
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3


class ModbusTcp:
    """Listens on 127.0.0.1 from construction until `close()`; `answer` runs in its thread and must be quick."""

    def __init__(self, answer: Answer, spans: Sequence[tuple[int, int]], port: int, device_id: int) -> None:
        """Serve the addresses `spans` (first, behind the last); all others get exception 2. OSError: port is taken."""
        self._answer, self._spans, self._device_id = answer, spans, device_id
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listener.getsockname()[1]
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name="modbus-chamber", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close all connections and end the thread; a second call changes nothing."""
        if self._thread.is_alive():
            self._wake.send(b"\0")
            self._thread.join()
            self._wake.close()

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector, self._listener, self._woken, ExitStack() as connections:
            selector.register(self._woken, selectors.EVENT_READ)
            selector.register(self._listener, selectors.EVENT_READ)
            while self._turn(selector, connections):
                pass

    def _turn(self, selector: selectors.BaseSelector, connections: ExitStack) -> bool:
        """Wait for something to do, and do it; False: the end."""
        for key, _ in selector.select():
            if key.fileobj is self._woken:
                return False
            if key.fileobj is self._listener:
                connection = connections.enter_context(self._listener.accept()[0])
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                selector.register(connection, selectors.EVENT_READ, _Line(connection))
            elif not self._serve(key.data):
                selector.unregister(key.fileobj)
                key.data.socket.close()
        return True

    def _serve(self, line: _Line) -> bool:
        """Answer what has arrived; False: the connection is over."""
        with suppress(OSError):
            new = line.socket.recv(4096)
            waiting = line.begun + new
            while len(waiting) >= _HEAD.size:
                number, protocol, length, device = _HEAD.unpack_from(waiting)
                if protocol or not 2 <= length <= _MOST_FRAME:
                    return False
                if len(waiting) < 6 + length:
                    break
                request, waiting = waiting[_HEAD.size : 6 + length], waiting[6 + length :]
                if device == self._device_id:
                    answer = self._answered(request)
                    line.socket.sendall(_HEAD.pack(number, 0, len(answer) + 1, device) + answer)
            line.begun = waiting
            return bool(new)
        return False

    def _answered(self, request: bytes) -> bytes:
        """The answer to a request, both without their heads."""
        code = request[0]
        answer: bytes | int
        if code in (3, 4):
            answer = self._read(code, request)
        elif code in (6, 16):
            answer = self._write(code, request)
        else:
            answer = _ILLEGAL_FUNCTION
        return bytes((code | 0x80, answer)) if isinstance(answer, int) else answer

    def _read(self, code: int, request: bytes) -> bytes | int:
        if len(request) != 5:
            return _ILLEGAL_VALUE
        address, count = _PAIR.unpack_from(request, 1)
        if not 1 <= count <= _MOST_READ:
            return _ILLEGAL_VALUE
        if not self._has(address, count):
            return _ILLEGAL_ADDRESS
        words = self._answer(code, address, count, None)
        if isinstance(words, int):
            return words
        return struct.pack(f">BB{count}H", code, 2 * count, *words)

    def _write(self, code: int, request: bytes) -> bytes | int:
        if len(request) < 5:
            return _ILLEGAL_VALUE
        address, count = _PAIR.unpack_from(request, 1)
        data = request[3:]
        if code == 16:
            data = request[6:]
            if not 1 <= count <= _MOST_WRITTEN or request[5:6] != bytes([2 * count]):
                return _ILLEGAL_VALUE
        else:
            count = 1
        if len(data) != 2 * count:
            return _ILLEGAL_VALUE
        if not self._has(address, count):
            return _ILLEGAL_ADDRESS
        refused = self._answer(code, address, count, struct.unpack(f">{count}H", data))
        return refused if isinstance(refused, int) else request[:5]

    def _has(self, address: int, count: int) -> bool:
        return any(low <= address and address + count <= high for low, high in self._spans)


@dataclass
class _Line:
    """An open connection, with the beginning of a request that has not arrived whole."""

    socket: socket.socket
    begun: bytes = b""
