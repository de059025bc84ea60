"""A server of the page with a run that exists only as states: `python -m benchmarks.web_source OUT HZ`.

Everything is real except the answer of the run: instead of asking a process, the watcher gets the next tick. HZ 0 is
as fast as the browser reads them, without dropping any. Ticks continue up to the last number on stdin.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import uvicorn

from bench.acquisition.recording.trace import Trace
from bench.acquisition.run import remote
from bench.web.ground.settings import Settings
from bench.web.live import watching
from bench.web.server.app import create_app

UNITS, DAY_S = ("SIM-0001",), 432_000.0
PROFILE = (
    "name: day\nsegments:\n  - {kind: ramp, to_degc: 33, rate_degc_per_min: 2}\n  - {kind: soak, duration_min: 1435}\n"
)


class Source:
    """A run of one unit: a tick for each request."""

    def __init__(self) -> None:
        self.trace, self.ticks, self._most = Trace(), 0, 1
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in sys.stdin:
            self._most = int(line)

    @property
    def rests(self) -> bool:
        """Whether all ticks were sent."""
        return self.ticks >= self._most

    def ask(self, _run: Any, _action: str, *_: Any, since: int = 0, generation: int = 0, **__: Any) -> dict[str, Any]:
        if not self.rests:
            self.ticks += 1
            wave = math.sin(self.ticks / 900)
            samples = (4.0 + wave - 0.3, 4.0 + wave + 0.3, 100 * (4.0 + wave), 100)  # lowest, highest, sum, number
            self.trace.add(float(self.ticks), (30 + 3 * wave, 30 + 2.9 * wave), [(UNITS[0], 29 + 2 * wave, samples)])
        return {**self._picture(), "trace": self.trace.since(since, generation)}

    def _picture(self) -> dict[str, Any]:
        t_s, degc = float(self.ticks), 30 + 2.9 * math.sin(self.ticks / 900)
        losses = {"received": 500 * self.ticks, "lost": 0, "corrupt": 0}
        segment = {"index": 1, "of": 2, "name": "soak", "kind": "soak", "target_degc": 33.0}
        guards = [
            {"name": name, "state": "ok", "text": "ok", "action": "abort", "signal": name, "value": round(degc, 2)}
            for name in ("chamber temperature", "unit silent", "controller alarm", "disk")
        ]
        return {
            "ok": True, "pid": os.getpid(), "state": "running", "t_s": t_s, "late_s": 0.0, "age_s": 0.0,
            "left_s": max(DAY_S - t_s, 0.0), "holding": [], "guards": guards,
            "segment": {**segment, "rate_degc_per_min": None, "from_s": 300.0, "left_s": max(DAY_S - t_s, 0.0)},
            "chamber": {"temperature_degc": round(degc, 3), "setpoint_degc": 33.0, "working_setpoint_degc": 33.0,
                        "on": True, "alarm": []},
            "units": [{"serial": UNITS[0], "temperature_degc": round(degc - 1, 3), "losses": losses, "dropped": None}],
        }  # fmt: skip


def unhindered(app: Any, watcher: Any, source: Source) -> None:
    """Continue when every browser has received the last state, so that states are never dropped.

    The listener hands a state to the server's loop: only after that a browser has it to receive.
    """

    def run() -> None:
        looked_s = 0.0
        while not watcher._stop.is_set():
            browsers = list(app.state.stream._browsers)
            if browsers and not any(browser.live for browser in browsers):
                for watched in watcher.runs:
                    watched.next_s = 0.0
                watcher.turn(time.monotonic())
                asyncio.run_coroutine_threadsafe(asyncio.sleep(0), watcher._listener._loop).result()
            elif time.monotonic() - looked_s > 1.0:
                looked_s = time.monotonic()
                watcher._look()
            time.sleep(watching.PERIOD_S if source.rests else 0.0005)

    watcher._run = run


def main(out: Path, hz: float) -> None:
    folder = out / UNITS[0] / "day"
    (folder / "journal").mkdir(parents=True)
    (folder / "profile.yaml").write_text(PROFILE)
    remote.LiveFile(os.getpid(), 9, "2026-01-01T00:00:00+00:00", [], "benchmark").write(folder)
    source = Source()
    patch.object(watching, "ask_run", source.ask).start()
    app = create_app(Settings(out=out))
    if not hz:
        start = watching.Watcher.start

        def started(watcher: Any) -> None:
            unhindered(app, watcher, source)
            watcher._thread = type(watcher._thread)(target=watcher._run, daemon=True)
            start(watcher)

        patch.object(watching.Watcher, "start", started).start()
    server = uvicorn.Server(
        uvicorn.Config(app, log_level="warning", access_log=False, ws="none", timeout_graceful_shutdown=1)
    )
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(json.dumps({"url": f"http://127.0.0.1:{listener.getsockname()[1]}"}), flush=True)
        asyncio.run(server.serve(sockets=[listener]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
