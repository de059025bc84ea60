"""Simulated supply of the units: a SCPI server on 127.0.0.1. What it is told is in force from the next step on."""

from __future__ import annotations

import re
import socketserver
import threading

_OUTPUT = re.compile(r"OUTP(?:UT)?(?::STAT(?:E)?)?(\?)?\s*(ON|OFF|1|0)?\s*,?\s*(?:\(@(\d+)\))?$", re.IGNORECASE)


class ScpiSupply:
    """A supply with one output, which is on; `port` is its TCP port."""

    def __init__(self, port: int = 0) -> None:
        self.on = True
        self.told: list[str] = []
        """Everything that it was told."""
        self._server = _Server(("127.0.0.1", port), _Session)
        self._server.supply = self
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """TCP port on 127.0.0.1."""
        return int(self._server.server_address[1])

    def take(self, line: str) -> str | None:
        """Obey one command; the answer of a query."""
        self.told.append(line)
        if line.upper() == "*IDN?":
            return "BENCH,SIMULATED SUPPLY,1,1.0"
        if (match := _OUTPUT.match(line)) is None:
            return None
        if match[1]:
            return str(int(self.on))
        if match[2]:
            self.on = match[2].upper() in {"ON", "1"}
        return None

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    allow_reuse_address = True
    block_on_close = False
    supply: ScpiSupply


class _Session(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        assert isinstance(self.server, _Server)
        for line in self.rfile:
            answer = self.server.supply.take(line.decode("ascii", errors="replace").strip())
            if answer is not None:
                self.wfile.write(f"{answer}\n".encode("ascii"))
