"""Simulated instruments on 127.0.0.1: a SCPI server and a Modbus server that do what they are described to do."""

from __future__ import annotations

import socket
import socketserver
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress

from pymodbus.constants import ExcCodes

from drivers.register import Register, Value
from drivers.sim.modbus_wire import ModbusWire

_READ_BACK = {5: 1, 6: 3, 16: 3}
"""Space that a function code writes; pymodbus reads back what it has written."""


class ScpiInstrument:
    """Answers queries and obeys commands; `port` is its TCP port."""

    def __init__(
        self,
        identity: str,
        values: Mapping[str, Callable[[], str]],
        settings: Iterable[tuple[str, str, str]] = (),
        *,
        first: Mapping[str, str] | None = None,
        port: int = 0,
    ) -> None:
        """`values`: answer of each query. `settings`: command, query that reads it back, its answer from then on.

        `first`: what queries of settings are answered with before any command; left out: 0.
        """
        self.told: list[str] = []
        """Everything that it was told."""
        self.disobeys = False
        """Whether commands have no effect."""
        self.silent = False
        """Whether it answers nothing."""
        self._values, self._settings = dict(values), {command: (query, said) for command, query, said in settings}
        self._identity = identity
        self._state = {query: "0" for query, _ in self._settings.values()} | dict(first or {})
        self._server = _Server(("127.0.0.1", port))
        self._server.instrument = self
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """TCP port on 127.0.0.1."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """Address for the driver."""
        return f"socket://127.0.0.1:{self.port}"

    def reads(self, query: str) -> str:
        """What a query of a setting is answered with now."""
        return self._state[query]

    def take(self, line: str) -> str | None:
        """Obey one command; the answer of a query."""
        self.told.append(line)
        if self.silent:
            return None
        if line == "*IDN?":
            return self._identity
        if line in self._settings and not self.disobeys:
            query, said = self._settings[line]
            self._state[query] = said
        if line in self._values:
            return self._values[line]()
        return self._state.get(line)

    def close(self) -> None:
        """Stop the server and its connections; a second call does nothing."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._server.server_close()
            for connection in list(self._server.connections):
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
            self._thread.join()


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    allow_reuse_address = True
    block_on_close = False
    instrument: ScpiInstrument

    def __init__(self, where: tuple[str, int]) -> None:
        self.connections: set[socket.socket] = set()
        super().__init__(where, _Session)


class _Session(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        assert isinstance(self.server, _Server)
        self.server.connections.add(self.connection)
        with suppress(OSError):
            for line in self.rfile:
                answer = self.server.instrument.take(line.decode("ascii", errors="replace").strip())
                if answer is not None:
                    self.wfile.write(f"{answer}\n".encode("ascii"))
        self.server.connections.discard(self.connection)


class ModbusInstrument:
    """Serves some registers; listens from construction until `close()`. Usable as a context manager."""

    def __init__(self, registers: Sequence[Register], *, port: int = 0) -> None:
        """Every register reads 0 at first. Raises LinkError when the port is in use."""
        self.disobeys = self.silent = False
        """Whether writes have no effect; whether only its gateway answers, that it does not respond."""
        self._lock = threading.Lock()
        size = 16 + max(register.end for register in registers)
        self._spaces = {code: [0] * size for code in (1, 2, 3, 4)}
        spans = [(register.address, register.end) for register in registers if not register.is_bit]
        bits = any(register.is_bit for register in registers)
        self._wire = ModbusWire(self._answer, spans or [(0, 1)], bits=bits, port=port)

    def __enter__(self) -> ModbusInstrument:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Address for a ModbusLink."""
        return self._wire.url

    @property
    def address(self) -> str:
        """Address for the driver."""
        return self._wire.url

    def show(self, register: Register, value: Value) -> None:
        """What a register reads from now on."""
        with self._lock:
            self._spaces[register.read][register.address : register.end] = register.encode(value)

    def value(self, register: Register) -> Value:
        """What a register reads now."""
        with self._lock:
            return register.decode(self._spaces[register.read][register.address : register.end])

    def close(self) -> None:
        """Close all connections and end the thread; a second call does nothing."""
        self._wire.close()

    def _answer(self, code: int, address: int, count: int, new: Sequence[int] | None) -> list[int] | ExcCodes:
        if self.silent:
            return ExcCodes.GATEWAY_NO_RESPONSE
        with self._lock:
            if new is None:
                return self._spaces[_READ_BACK.get(code, code)][address : address + count]
            if not self.disobeys:
                self._spaces[_READ_BACK[code]][address : address + len(new)] = new
            return []
