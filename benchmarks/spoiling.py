"""A separate proxy of the tests between driver and chamber: it forwards every request and corrupts chosen answers.

Independent of `drivers.sim.faults`, which the bench offers for rehearsals: it implements Modbus TCP on plain sockets.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

HEADER = 7
TIMEOUT_S = 0.15
"""Of the driver under test: a tenth of what it is in use, and so are the delays below [s]."""
SECOND_S = 0.1
LATE_S = 3 * TIMEOUT_S


@dataclass(frozen=True)
class Spoiled:
    """Bytes sent instead of an answer: pieces after delays [s], and whether the connection is kept."""

    pieces: Sequence[tuple[float, bytes]] = ()
    then: Literal["stay", "close", "reset"] = "stay"


Spoil = Callable[[bytes, bytes, random.Random], Spoiled]
"""Request and answer, both with their header, to what is sent."""


def _one(data: bytes) -> Spoiled:
    return Spoiled([(0.0, data)])


def _framed(answer: bytes, pdu: bytes) -> Spoiled:
    """The same header with another content and the correct length."""
    return _one(answer[:4] + struct.pack(">H", len(pdu) + 1) + answer[6:HEADER] + pdu)


def _exception(code: int) -> Spoil:
    return lambda request, answer, rng: _framed(answer, bytes([request[HEADER] | 0x80, code]))


def _replaced(at: int, change: Callable[[int], int]) -> Spoil:
    """One byte of the answer is replaced."""
    return lambda request, answer, rng: _one(answer[:at] + bytes([change(answer[at]) & 0xFF]) + answer[at + 1 :])


def _length(value: int) -> Spoil:
    return lambda request, answer, rng: _one(answer[:4] + struct.pack(">H", value) + answer[6:])


def _filled(byte: int) -> Spoil:
    """Correct frame, all data bytes equal: registers for a read, address and value for a write."""

    def spoil(request: bytes, answer: bytes, rng: random.Random) -> Spoiled:
        kept = HEADER + (2 if answer[HEADER] in (3, 4) else 1)
        return _one(answer[:kept] + bytes([byte]) * (len(answer) - kept))

    return spoil


def _noise(request: bytes, answer: bytes, rng: random.Random) -> Spoiled:
    kept = HEADER + (2 if answer[HEADER] in (3, 4) else 1)
    return _one(answer[:kept] + rng.randbytes(len(answer) - kept))


def _shorter(request: bytes, answer: bytes, rng: random.Random) -> Spoiled:
    """One register less, every length consistent; a write answer without its last two bytes."""
    pdu = answer[HEADER:]
    return _framed(answer, bytes([pdu[0], pdu[1] - 2]) + pdu[2:-2] if pdu[0] in (3, 4) else pdu[:-2])


def _longer(request: bytes, answer: bytes, rng: random.Random) -> Spoiled:
    pdu = answer[HEADER:]
    return _framed(answer, bytes([pdu[0], pdu[1] + 2]) + pdu[2:] + b"\0\0" if pdu[0] in (3, 4) else pdu + b"\0\0")


def _dribble(request: bytes, answer: bytes, rng: random.Random) -> Spoiled:
    return Spoiled([(SECOND_S, bytes([byte])) for byte in answer])


KINDS: Mapping[str, Spoil] = {
    **{f"exception {code}": _exception(code) for code in (1, 2, 3, 4, 5, 6, 8, 10, 11, 255)},
    "transaction id + 1": _replaced(1, lambda byte: byte + 1),
    "transaction id 0": lambda request, answer, rng: _one(b"\0\0" + answer[2:]),
    "protocol id": _replaced(3, lambda byte: byte + 1),
    "unit id + 1": _replaced(6, lambda byte: byte + 1),
    "unit id 0": _replaced(6, lambda byte: 0),
    "another function": _replaced(HEADER, lambda byte: byte ^ 7),
    "unknown function": _replaced(HEADER, lambda byte: 0x63),
    "exception without a code": lambda request, answer, rng: _framed(answer, bytes([request[HEADER] | 0x80])),
    "byte count": _replaced(HEADER + 1, lambda byte: byte + 2),
    "one register less": _shorter,
    "one register more": _longer,
    "length 0": _length(0),
    "length 1": _length(1),
    "length 65535": _length(0xFFFF),
    "header only": lambda request, answer, rng: _one(answer[:HEADER]),
    "one byte": lambda request, answer, rng: _one(answer[:1]),
    "half, then nothing": lambda request, answer, rng: _one(answer[: len(answer) // 2]),
    "half, then closed": lambda request, answer, rng: Spoiled([(0.0, answer[: len(answer) // 2])], "close"),
    "half, then reset": lambda request, answer, rng: Spoiled([(0.0, answer[: len(answer) // 2])], "reset"),
    "nothing": lambda request, answer, rng: Spoiled(),
    "closed": lambda request, answer, rng: Spoiled((), "close"),
    "reset": lambda request, answer, rng: Spoiled((), "reset"),
    "oversized": lambda request, answer, rng: _framed(answer, answer[HEADER:] + rng.randbytes(300)),
    "10 kB behind it": lambda request, answer, rng: _one(answer[:HEADER] + rng.randbytes(10_000)),
    "garbage": lambda request, answer, rng: _one(rng.randbytes(len(answer))),
    "zeros": lambda request, answer, rng: _one(bytes(len(answer))),
    "registers all 0": _filled(0x00),
    "registers all 1": _filled(0xFF),
    "registers at random": _noise,
    "the request again": lambda request, answer, rng: _one(request),
    "too late": lambda request, answer, rng: Spoiled([(LATE_S, answer)]),
    "one byte a second": _dribble,
}
"""Kinds of spoiling, by what is wrong with the answer."""


class SpoilingProxy:
    """Forwards Modbus TCP to `upstream` [port on this computer]; once armed, spoils the answers to one function."""

    def __init__(self, upstream: int, function: int, kind: str, seed: int) -> None:
        self.struck = 0
        """How many answers were spoiled."""
        self.passed = 0
        """How many requests reached the chamber."""
        self.armed = False
        self._upstream, self._function, self._spoil = upstream, function, KINDS[kind]
        self._random = random.Random(seed)
        self._ends = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, name="spoiling proxy", daemon=True).start()

    def close(self) -> None:
        """Accept no further connections; threads of open connections end with them."""
        self._ends.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        upstream = ("127.0.0.1", self._upstream)
        with contextlib.suppress(OSError, EOFError), client, socket.create_connection(upstream) as behind:
            while not self._ends.is_set():
                request = _frame(client)
                behind.sendall(request)
                answer = _frame(behind)
                self.passed += 1
                spoiled = Spoiled([(0.0, answer)])
                if self.armed and request[HEADER] == self._function:
                    spoiled = self._spoil(request, answer, self._random)
                    self.struck += spoiled != Spoiled([(0.0, answer)])  # an echo repeats some requests anyway
                if not self._send(client, spoiled):
                    return

    def _send(self, client: socket.socket, spoiled: Spoiled) -> bool:
        """Whether the connection is kept."""
        for wait_s, data in spoiled.pieces:
            if self._ends.wait(wait_s):
                return False
            client.sendall(data)
        if spoiled.then == "reset":
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        return spoiled.then == "stay"


def _frame(source: socket.socket) -> bytes:
    """One frame with its header; EOFError when the peer has closed the connection."""
    head = _exactly(source, HEADER)
    return head + _exactly(source, int.from_bytes(head[4:6], "big") - 1)


def _exactly(source: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = source.recv(count - len(data))
        if not more:
            raise EOFError
        data += more
    return data
