"""Waiting times of the workbench: `python -m benchmarks.workbench OUT UNIT/RUN` (a 500 Hz run of some hours).

Ten thousand copies of the run's small files make the list; the rest is requested over HTTP as by the page.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import httpx
import uvicorn

from bench.web.ground.settings import Settings
from bench.web.server.app import create_app

API = "/api/v1"
SPLINE: dict[str, Any] = {"name": "spline", "effects": [{"effect": "spline", "intervals": 24, "ends": "natural"}]}
LAG: dict[str, Any] = {"name": "spline + lag", "effects": [*SPLINE["effects"], {"effect": "thermal_lag"}]}
SMALL = ("manifest.json", "compare.json", "calibration.json", "diagnosis.json")


@contextmanager
def served(out: Path) -> Iterator[httpx.Client]:
    server = uvicorn.Server(uvicorn.Config(create_app(Settings(out=out)), port=0, log_level="warning"))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=600, trust_env=False) as client:
            yield client
    finally:
        server.should_exit = True
        thread.join()


def timed(what: str, call: Callable[[], object], best_of: int = 1) -> None:
    took = []
    for _ in range(best_of):
        begin = perf_counter()
        call()
        took.append(perf_counter() - begin)
    print(f"{what:<58} {min(took):8.3f} s", flush=True)


def computed(client: httpx.Client, path: str, body: dict[str, Any]) -> None:
    asked = client.post(f"{API}{path}", json=body).raise_for_status().json()
    while True:
        answer = client.get(f"{API}/jobs/{asked['job']}", params={"wait_s": 20}).json()
        if answer["state"] == "failed":
            raise RuntimeError(answer["detail"])
        if answer["state"] == "done":
            return


def listing(source: Path, root: Path) -> None:
    for i in range(10_000):
        folder = root / f"U-{i // 20:04d}" / f"2026{1 + i % 12:02d}{1 + i % 28:02d}T{i % 20:02d}0000Z_ramp"
        (folder / "journal").mkdir(parents=True)
        for name in SMALL:
            if (source / name).is_file():
                shutil.copyfile(source / name, folder / name)
    with served(root) as client:
        timed("10,000 runs, first list ever", lambda: client.get(f"{API}/runs"))
        for q in ("u-0123", "ramp 20261105", "ramp"):
            timed(f"filtered by '{q}'", lambda q=q: client.get(f"{API}/runs", params={"q": q}), 5)  # type: ignore[misc]
        sleep(1.1)
        timed("filtered, the disk looked at again", lambda: client.get(f"{API}/runs?q=u-0123"))
    with served(root) as client:
        timed("first list of the next server", lambda: client.get(f"{API}/runs"))


def workbench(client: httpx.Client, run: str) -> None:
    def figure(kind: str, **more: Any) -> Callable[[], None]:
        return lambda: computed(client, "/figures", {"kind": kind, "runs": [run], "model": SPLINE, **more})

    def analysis(*models: dict[str, Any]) -> Callable[[], None]:
        return lambda: computed(client, "/analyses", {"runs": [run], "models": list(models)})

    client.get(f"{API}/models")
    sleep(5)  # the page's reader chooses a run meanwhile, and the processes get ready
    timed("analysis, one model", analysis(SPLINE))
    timed("an effect added", analysis(SPLINE, LAG))
    timed("undo", analysis(SPLINE))
    for kind in ("time", "temperature", "map", "loop", "allan", "channels", "ladder"):
        timed(f"figure {kind}", figure(kind))
    for span_s in (7200.0, 1200.0, 300.0, 10.0):
        timed(f"zoom to {span_s:g} s", figure("time", from_s=15000.0, to_s=15000.0 + span_s))
    timed("diagnosis", lambda: computed(client, "/diagnoses", {"runs": [run], "model": SPLINE}))


def main(out: Path, run: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        listing(out / run, Path(folder))
    with served(out) as client:
        workbench(client, run)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
