"""Is the page open, and is an abort heard at once, while others hold thousands of connections during a real-time run?

    python -m benchmarks.page_under_load --connections 2000 --out page_under_load.jsonl

For each kind of load a run in real time on a served station (`bench sim`), a page (`bench ui`) that asks for tokens,
and a process that keeps so many connections to it: idle, headers or bodies that come byte by byte, uploads that are
abandoned, requests without or with a wrong token, answers that nobody reads. Connections that the page closes are
opened again. Meanwhile the page is asked, and then an operator aborts the run: through the page, or with the run's
own socket, as `bench abort` does. Results are appended to the file as they come; what stands there already is not run
again. Prints one JSON object; exit code 1 when an abort took more than a second, was not heard, or a frame was lost.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import httpx

from bench.acquisition import ask_run, live_below
from bench.record.folder import RunFolder
from bench.web import add_person
from benchmarks import campaigns
from benchmarks.kills import bench, served

MOST_S = 1.0
PATIENCE_S = 120.0
ASKED = 10
"""Questions to page and run under load, before the abort."""
_HEAD = "Host: 127.0.0.1\r\nX-Bench: 1\r\n"
_FORM = '--b\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\ntime,rate\n'
_TYPED = f"{_HEAD}Content-Length: 1000000\r\nContent-Type: "
_UPLOAD = f"POST /api/v1/imports HTTP/1.1\r\n{_TYPED}multipart/form-data; boundary=b\r\n"
_POST = f"POST /api/v1/session HTTP/1.1\r\n{_TYPED}application/json\r\n\r\n{{"
Via = Literal["page", "socket"]


@dataclass(frozen=True)
class Load:
    """What is sent on each connection at first, and then once a second."""

    first: str = ""
    then: str = ""


LOADS = {
    "idle": Load(),
    "slow headers": Load(f"GET / HTTP/1.1\r\n{_HEAD}X-Slow: ", "a"),
    "slow bodies": Load(_POST, " "),
    "abandoned uploads": Load(f"{_UPLOAD}\r\n{_FORM}", ""),
    "abandoned uploads of an engineer": Load(f"{_UPLOAD}Authorization: Bearer TOKEN\r\n\r\n{_FORM}", ""),
    "no token": Load(f"GET /api/v1/runs HTTP/1.1\r\n{_HEAD}\r\n", f"GET /api/v1/runs HTTP/1.1\r\n{_HEAD}\r\n"),
    "wrong tokens": Load(f"GET /api/v1/runs HTTP/1.1\r\n{_HEAD}Authorization: Bearer no\r\n\r\n", ""),
    "unread answers": Load(f"GET /static/app.js HTTP/1.1\r\n{_HEAD}\r\n" * 20, ""),
}
"""Kinds of load."""


@dataclass(frozen=True)
class Case:
    """One run."""

    load: str
    via: Via
    connections: int


@dataclass(frozen=True)
class Outcome:
    """What became of it."""

    case: Case
    held: int
    """Connections that were open when the abort was sent."""
    opened: int
    """Connections that had been opened by then."""
    page_s: float
    """Longest answer of the page before [s]."""
    run_s: float
    """Longest answer of the run's own socket before [s]."""
    abort_s: float
    """From the request to the answer that the run has taken it [s]."""
    state: str
    """How the run ended."""
    frames: int
    lost: int

    @property
    def wrong(self) -> str:
        """What is not as it should be; empty: nothing."""
        if self.state != "aborted":
            return f"the run is {self.state}"
        if self.lost or not self.frames:
            return f"{self.lost} of {self.frames} frames lost"
        return f"the abort took {self.abort_s:.2f} s" if self.abort_s > MOST_S else ""


def run_case(case: Case, folder: Path) -> Outcome:
    """One run, one page, one load, one abort."""
    out = folder / "out"
    access = folder / "access.yaml"
    operator, engineer = add_person(access, "Operator", "operator"), add_person(access, "Engineer", "engineer")
    with served(folder) as station, _page(out, access) as url, _run(station, out) as live:
        with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {operator}"}, trust_env=False) as client:
            name = _until(lambda: [run["run"] for run in client.get("/api/v1/live").json()["runs"]])[0]
        with _loaded(case, url, engineer) as counted:
            slowest = {"page": 0.0, "run": 0.0}
            for _ in range(ASKED):
                slowest["page"] = max(slowest["page"], _timed(lambda: _get(url, operator)))
                slowest["run"] = max(slowest["run"], _timed(lambda: ask_run(live, "status")))
                time.sleep(0.2)
            held, opened = counted()
            if case.via == "page":
                abort_s = _timed(lambda: _post(f"{url}/api/v1/live/{name}/abort?wait_s=0", operator))
            else:
                abort_s = _timed(lambda: ask_run(live, "abort"))
            _until((live.path / "manifest.json").exists)
        manifest = _until(lambda: RunFolder(live.path).manifest())
    losses = manifest.losses
    times = (round(seconds, 3) for seconds in (slowest["page"], slowest["run"], abort_s))
    return Outcome(case, held, opened, *times, manifest.state, losses["received"], losses["lost"])


def _get(url: str, token: str) -> None:
    httpx.get(f"{url}/api/v1/live", headers={"Authorization": f"Bearer {token}"}, timeout=60.0, trust_env=False).json()


def _post(url: str, token: str) -> None:
    answer = httpx.post(url, json={}, headers={"Authorization": f"Bearer {token}"}, timeout=60.0, trust_env=False)
    answer.raise_for_status()


def _timed(act: Any) -> float:
    begun = time.monotonic()
    act()
    return time.monotonic() - begun


def _until(found: Any) -> Any:
    until_s = time.monotonic() + PATIENCE_S
    while not (value := found()):
        if time.monotonic() > until_s:
            raise TimeoutError("it did not come")
        time.sleep(0.05)
    return value


@contextmanager
def _page(out: Path, access: Path) -> Iterator[str]:
    server = bench("ui", "--port", "0", "--no-browser", "--out", out, "--access", access)
    try:
        assert server.stderr is not None
        yield server.stderr.readline().split()[2].rstrip("/")
    finally:
        server.terminate()
        server.communicate()


@contextmanager
def _run(station: Path, out: Path) -> Iterator[Any]:
    run = bench("run", station.parent / "profile.yaml", "--station", station, "--out", out, "--model", "polynomial")
    try:
        _until(lambda: any(journal.stat().st_size > 10_000 for journal in out.glob("*/*/journal/can0.gtbj")))
        yield live_below(out)[0]
        run.communicate(timeout=PATIENCE_S)
    finally:
        run.kill()
        run.communicate()


@contextmanager
def _loaded(case: Case, url: str, token: str) -> Iterator[Any]:
    """A process that keeps the connections; yields a function that counts them."""
    command = [sys.executable, "-m", "benchmarks.page_under_load", "--attack", case.load, url, f"--token={token}"]
    process = subprocess.Popen([*command, "--connections", str(case.connections)], stdin=subprocess.PIPE,
                               stdout=subprocess.PIPE, text=True)  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    stdin, stdout = process.stdin, process.stdout
    stdout.readline()  # all have been opened once

    def counted() -> tuple[int, int]:
        stdin.write("\n")
        stdin.flush()
        held, opened = stdout.readline().split()
        return int(held), int(opened)

    try:
        yield counted
    finally:
        process.kill()
        process.communicate()


async def attack(load: str, url: str, token: str, count: int) -> None:
    """Keep so many connections; says when all were opened, and counts them for each line of stdin."""
    what = LOADS[load]
    host, _, port = url.removeprefix("http://").partition(":")
    first, then = (text.replace("TOKEN", token).encode() for text in (what.first, what.then))
    held, opened = 0, 0

    async def keep() -> None:
        nonlocal held, opened
        while True:
            try:
                reader, writer = await asyncio.open_connection(host, int(port), limit=1)
            except OSError:
                await asyncio.sleep(0.1)
                continue
            held, opened = held + 1, opened + 1
            with contextlib.suppress(OSError):
                writer.write(first)
                while not (reader.at_eof() or writer.is_closing()):
                    await asyncio.sleep(1.0)
                    writer.write(then)
                    if load != "unread answers":
                        with contextlib.suppress(TimeoutError):
                            await asyncio.wait_for(reader.read(65536), 0.01)
            held -= 1
            writer.transport.abort()

    tasks = [asyncio.create_task(keep()) for _ in range(count)]
    while opened < count:
        await asyncio.sleep(0.05)
    print("ready", flush=True)
    loop = asyncio.get_running_loop()
    while await loop.run_in_executor(None, sys.stdin.readline):
        print(held, opened, flush=True)
    for task in tasks:
        task.cancel()


def cases(connections: int) -> list[Case]:
    """Every load, and both ways of an abort."""
    return [Case(load, via, connections) for load in LOADS for via in get_args(Via)]


def campaign(todo: Sequence[Case], out: Path) -> list[Outcome]:
    """Run what is not in the file yet; all outcomes that the file then holds."""

    def run(case: Case) -> Outcome:
        with tempfile.TemporaryDirectory() as scratch:
            return run_case(case, Path(scratch))

    return campaigns.resumed(todo, run, out, lambda outcome: outcome.case, asdict, made)


def made(content: dict[str, Any]) -> Outcome:
    """An outcome as it was written."""
    return Outcome(**{**content, "case": Case(**content["case"])})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("page_under_load.jsonl"))
    parser.add_argument("--connections", type=int, default=2000)
    parser.add_argument("--attack", nargs=2, metavar=("LOAD", "URL"), help=argparse.SUPPRESS)
    parser.add_argument("--token", default="", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    if arguments.attack:
        asyncio.run(attack(*arguments.attack, arguments.token, arguments.connections))
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what was started ends with the campaign
    outcomes = campaign(cases(arguments.connections), arguments.out)
    wrong = [outcome for outcome in outcomes if outcome.wrong]
    figures = {
        "n": len(outcomes),
        "connections": arguments.connections,
        "abort_s": {via: max(o.abort_s for o in outcomes if o.case.via == via) for via in get_args(Via)},
        "page_s": max(outcome.page_s for outcome in outcomes),
        "run_s": max(outcome.run_s for outcome in outcomes),
        "frames": sum(outcome.frames for outcome in outcomes),
        "lost": sum(outcome.lost for outcome in outcomes),
        "outcomes": [asdict(outcome) | {"wrong": outcome.wrong} for outcome in outcomes],
        "wrong": len(wrong),
    }
    print(json.dumps(figures, indent=1))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
