"""python-can interface `loopcan`: a CAN bus between processes over TCP on 127.0.0.1, without loss and without drivers.

A broker in one process (`bench sim`) forwards every frame of one client to all others, in the same order for all. The
sockets carry FRAME records of 24 bytes, of 80 on a bus with CAN FD. The broker stamps frames with calendar time unless
the sender stamps them.
"""

from __future__ import annotations

import contextlib
import select
import selectors
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import can
import numpy as np

from drivers.can_record import CLASSICAL_BYTES, FD_BYTES, frame_type
from drivers.frames import to_messages, to_record
from drivers.journal import FrameArray

HELLO, HELLO_FD = b"GTBCAN1\n", b"GTBCANF\n"
"""The broker's first bytes, without and with CAN FD; a client that has read them receives every later frame."""

MAX_BACKLOG = 64 << 20
"""A client that is this many bytes behind is dropped: it hangs, and its backlog would fill the simulator's memory."""


def _format(fd: bool) -> tuple[bytes, np.dtype[np.void]]:
    """The broker's first bytes, and the record that its sockets carry."""
    return (HELLO_FD, frame_type(FD_BYTES)) if fd else (HELLO, frame_type(CLASSICAL_BYTES))


class _Client:
    """The broker's end of one connection."""

    def __init__(self, connection: socket.socket, hello: bytes) -> None:
        self.socket = connection
        self.received = b""
        self.backlog = bytearray(hello)


class Broker:
    """Serves one bus on 127.0.0.1, TCP port `port`, in a separate thread; with `fd`, one with CAN FD."""

    def __init__(self, port: int = 0, fd: bool = False) -> None:
        self._hello, self._type = _format(fd)
        self._listener = socket.create_server(("127.0.0.1", port))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self.dropped_clients = 0
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._clients: list[_Client] = []
        self._waker, self._waking = socket.socketpair()
        self._selector.register(self._waking, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._serve, name="loopcan broker", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, and disconnect every client; a second call does nothing."""
        if self._thread.is_alive():
            self._waker.send(b"x")
            self._thread.join()
        self._waker.close()

    def _serve(self) -> None:
        running = True
        while running:
            for key, events in self._selector.select():
                if key.fileobj is self._waking:
                    running = False
                elif key.fileobj is self._listener:
                    self._accept()
                else:
                    self._exchange(key.data, events)
        for client in self._clients:
            client.socket.close()
        self._listener.close()
        self._waking.close()
        self._selector.close()

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(connection, self._hello)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ | selectors.EVENT_WRITE, client)

    def _exchange(self, client: _Client, events: int) -> None:
        try:
            if events & selectors.EVENT_READ:
                self._relay(client)
            if events & selectors.EVENT_WRITE and client in self._clients:
                del client.backlog[: client.socket.send(client.backlog)]
                self._watch(client)
        except (ConnectionError, TimeoutError):
            self._drop(client)
        except BlockingIOError:
            pass

    def _relay(self, sender: _Client) -> None:
        new = sender.socket.recv(1 << 16)
        if not new:
            self._drop(sender)
            return
        data = sender.received + new
        whole = len(data) // self._type.itemsize * self._type.itemsize
        sender.received = data[whole:]
        frames = np.frombuffer(data[:whole], dtype=self._type).copy()
        frames["t_ns"][frames["t_ns"] == 0] = time.time_ns()
        for client in [client for client in self._clients if client is not sender]:
            client.backlog += frames.tobytes()
            if len(client.backlog) > MAX_BACKLOG:
                self.dropped_clients += 1
                self._drop(client)
            else:
                self._watch(client)

    def _watch(self, client: _Client) -> None:
        writing = selectors.EVENT_WRITE if client.backlog else 0
        self._selector.modify(client.socket, selectors.EVENT_READ | writing, client)

    def _drop(self, client: _Client) -> None:
        self._clients.remove(client)
        self._selector.unregister(client.socket)
        client.socket.close()


class LoopBus(can.BusABC):
    """One client; `channel` is the broker's port, or 127.0.0.1:port; `fd` as the broker has it.

    With `preserve_timestamps` a message keeps the `timestamp` of its sender (for 0 the broker still stamps it).
    """

    def __init__(
        self,
        channel: Any,
        can_filters: Any = None,
        preserve_timestamps: bool = False,
        timeout: float = 5.0,
        fd: bool = False,
        **_: Any,
    ) -> None:
        host, port = str(channel).rpartition(":")[::2]
        if host not in ("", "127.0.0.1", "localhost") or not port.isdigit():
            raise ValueError(f"loopcan channel '{channel}': must be a port on 127.0.0.1")
        self.channel_info = f"loopcan 127.0.0.1:{port}"
        self.preserve_timestamps = preserve_timestamps
        expected, self._type = _format(fd)
        self._messages: Iterator[can.Message] = iter(())
        self._rest = b""
        self._sending = threading.Lock()
        try:
            self._socket = socket.create_connection(("127.0.0.1", int(port)), timeout)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            hello = self._socket.recv(len(HELLO), socket.MSG_WAITALL)
        except OSError as error:
            raise can.CanInitializationError(f"{self.channel_info}: no broker ({error})") from error
        if hello != expected:
            self._socket.close()
            text = "the server there is not a loopcan broker"
            if hello in {HELLO, HELLO_FD}:
                text = f"the bus there is {'classical, remove' if fd else 'one with CAN FD, state'} `fd: true`"
            raise can.CanInitializationError(f"{self.channel_info}: {text}")
        self._socket.settimeout(None)
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one message; CanOperationError without a broker, or for CAN FD on a classical bus."""
        room = self._type["data"].itemsize
        try:
            self._write(to_record(msg, round(msg.timestamp * 1e9) if self.preserve_timestamps else 0, room=room))
        except ValueError as error:
            raise can.CanOperationError(str(error)) from None

    def send_block(self, frames: FrameArray) -> None:
        """Send FRAME records (n,); the broker stamps them unless `preserve_timestamps` is set."""
        if not self.preserve_timestamps:
            frames = frames.copy()
            frames["t_ns"] = 0
        self._write(frames.tobytes())

    def shutdown(self) -> None:
        """Disconnect; a second call does nothing."""
        if not self._is_shutdown:
            super().shutdown()
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message = next(self._messages, None)
        if message is None and self._fill(timeout):
            message = next(self._messages)
        return message, False

    def _fill(self, timeout: float | None) -> bool:
        """Wait for at least one complete record."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            remaining = None if deadline is None else max(deadline - time.monotonic(), 0.0)
            try:
                if not select.select([self._socket], [], [], remaining)[0]:
                    return False
                new = self._socket.recv(1 << 16)
            except (OSError, ValueError) as error:  # select raises ValueError for a closed socket
                raise can.CanOperationError(f"{self.channel_info} is closed") from error
            if not new:
                raise can.CanOperationError(f"{self.channel_info}: the broker has closed the connection")
            data = self._rest + new
            whole = len(data) // self._type.itemsize * self._type.itemsize
            self._rest = data[whole:]
            if whole:
                self._messages = to_messages(np.frombuffer(data[:whole], dtype=self._type), self.channel_info)
                return True

    def _write(self, data: bytes) -> None:
        try:
            with self._sending:
                self._socket.sendall(data)
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: connection to the broker lost ({error})") from error
