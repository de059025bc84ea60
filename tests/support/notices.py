"""Servers that take notices on 127.0.0.1: a webhook, and a mail server that speaks as much SMTP as is needed."""

from __future__ import annotations

import json
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler
from queue import Queue
from typing import Any

PATIENCE_S = 60.0


class Received:
    """What a server was sent, in order."""

    def __init__(self, port: int, messages: Queue[Any]) -> None:
        self.port, self._messages = port, messages

    def next(self) -> Any:
        return self._messages.get(timeout=PATIENCE_S)

    def all(self) -> list[Any]:
        """Those that are here by now."""
        return [self._messages.get() for _ in range(self._messages.qsize())]


@contextmanager
def _serving(handler: type[socketserver.BaseRequestHandler], messages: Queue[Any]) -> Iterator[Received]:
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield Received(server.server_address[1], messages)
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def webhook(status: int = 200, gate: threading.Event | None = None) -> Iterator[Received]:
    """Answers each message with `status`, as soon as `gate` is open."""
    messages: Queue[Any] = Queue()

    class Hook(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            messages.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            if gate is not None:
                gate.wait(PATIENCE_S)
            self.send_response(status)
            self.end_headers()

        def log_message(self, *args: Any) -> None:
            pass

    with _serving(Hook, messages) as received:
        yield received


@contextmanager
def mailbox() -> Iterator[Received]:
    """Takes every message, (recipients, text)."""
    messages: Queue[Any] = Queue()

    class Mail(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            self.say("220 mail ready")
            to: list[str] = []
            while line := self.rfile.readline().decode().strip():
                word = line[:4].upper()
                if word == "RCPT":
                    to.append(line)
                if word == "DATA":
                    self.say("354 go on")
                    text = b"".join(iter(self.rfile.readline, b".\r\n"))
                    messages.put((to, text.decode()))
                self.say("221 bye" if word == "QUIT" else "250 ok")
                if word == "QUIT":
                    return

        def say(self, text: str) -> None:
            self.wfile.write(f"{text}\r\n".encode())

    with _serving(Mail, messages) as received:
        yield received
