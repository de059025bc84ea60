"""Fifty benches send to one centre while they are killed, cut off and cloned: what arrives, and what that costs.

    python -m benchmarks.fifty_benches [BENCHES] [RUNS] [folder|s3|sftp]

Every bench is an archive of its own with small runs (means and raw data of two minutes). Its `send` is a process; it is
killed by SIGKILL at a moment drawn at random, or the line is cut (of a folder: it finds the centre gone), until one
ends by itself. Some disks are cloned after half of the runs and go on separately. In the end every manifest of every
bench must be at the centre once. The servers for S3 (moto) and SFTP (asyncssh) are processes on this computer; a line
is cut between bench and server after a number of bytes drawn at random.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bench.archive import Centre, Ledger, archive, fetch, outbox, reached, register_all, scrub, send
from bench.archive.registry.opening import open_registry
from bench.base import CentreError
from bench.record import MANIFEST, RunFolder, sha256
from tests.support.centre_servers import s3, sftp
from tests.support.run_folders import make_run, ramp_run

CLONED = 10
"""Every tenth disk is cloned."""
SEND = """
import sys
from pathlib import Path
from bench.archive import archive, reached, send
ledger = archive(Path(sys.argv[2]))
send(reached(sys.argv[1], ledger), ledger)
"""


def runs(root: Path, bench: int, count: int, first: int = 0) -> None:
    """Runs of one bench, each of another unit; every bench calls its first unit the same."""
    ledger = archive(root)
    for number in range(first, first + count):
        unit = "SIM-0001" if number == 0 else f"B{bench:02d}-{number:04d}"
        name = f"20261101T{number // 60:02d}{number % 60:02d}00Z_ramp"
        data = ramp_run(legs=(("soak", "soak", 25.0, 120.0),), seed=bench * 1000 + number)
        make_run(root / unit / name, **data, unit=unit, run=name, created=f"2026-11-01T{number // 60:02d}:00:00+00:00")
        ledger.saw(f"{unit}/{name}", sha256(root / unit / name / MANIFEST))


class Cable:
    """A line to a server, as a port of its own, that is cut after so many bytes."""

    def __init__(self, port: int, cut_after: int) -> None:
        self._port, self._left, self._ends = port, cut_after, list[socket.socket]()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._port))
                self._ends += [near, far]
                for one, other in ((near, far), (far, near)):
                    threading.Thread(target=self._forward, args=(one, other), daemon=True).start()

    def _forward(self, one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(4096):
                self._left -= len(data)
                if self._left < 0:
                    self.cut()
                    return
                other.sendall(data)
            other.shutdown(socket.SHUT_WR)

    def cut(self) -> None:
        """Nothing passes any more."""
        for end in (self._listener, *self._ends):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


@dataclass(frozen=True)
class Place:
    """The centre: its kind, its URL, and the port of its server."""

    kind: str
    url: str
    port: int = 0

    @property
    def latest_s(self) -> float:
        """When the last `send` is killed: one that needs a client's library starts slowly [s]."""
        return 4.0 if self.kind == "folder" else 25.0

    def behind(self, port: int) -> tuple[str, dict[str, str]]:
        """URL and environment of a process that reaches it through another port."""
        if self.kind == "s3":
            return self.url, {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}"}
        return f"sftp://bench@127.0.0.1:{port}/runs", {}


def attempt(root: Path, centre: tuple[str, dict[str, str]], killed_s: float) -> str:
    """One `send` as a process: `done`, `killed`, or the last line of what it said."""
    process = subprocess.Popen(
        [sys.executable, "-c", SEND, centre[0], str(root)], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
        text=True, env={**os.environ, **centre[1]},
    )  # fmt: skip
    try:
        _, said = process.communicate(timeout=killed_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        return "killed"
    return "done" if process.returncode == 0 else said.strip().splitlines()[-1]


def until_done(root: Path, place: Place, seed: int) -> Counter[str]:
    """Attempts of one bench until one ends by itself, every fifth while the cable is out or is pulled."""
    draw, found = random.Random(seed), Counter[str]()
    while not found["done"]:
        out, killed_s = draw.random() < 0.2, draw.uniform(0.3, place.latest_s)
        if not out:
            found[attempt(root, (place.url, {}), killed_s)] += 1
            continue
        cable = Cable(place.port, draw.randrange(100_000) if place.port else -1)
        said = attempt(root, place.behind(cable.port), max(killed_s, 4.0))
        cable.cut()
        found[said if said in {"killed", "done"} else "cut off"] += 1
    return found


@contextmanager
def placed(kind: str, folder: Path) -> Iterator[Place]:
    """A centre that does not exist yet."""
    if kind == "s3":
        os.environ.update({"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test"})
        with s3() as (address, _):
            os.environ["AWS_ENDPOINT_URL"] = address
            yield Place(kind, "s3://line/runs", int(address.rpartition(":")[2]))
    elif kind == "sftp":
        folder.mkdir()
        with sftp(folder) as url:
            yield Place(kind, url, int(url.rpartition(":")[2].partition("/")[0]))
    else:
        yield Place(kind, str(folder))


def timed(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def clone(root: Path, bench: int, count: int) -> tuple[Ledger, Ledger]:
    """A bench whose disk is copied after half of its runs; both go on."""
    runs(root, bench, count // 2)
    copy = root.with_name(f"{root.name}-clone")
    shutil.copytree(root, copy)
    runs(root, bench, count - count // 2, count // 2)
    runs(copy, bench + 500, count - count // 2, count // 2)
    return archive(root), archive(copy)


def main(benches: int = 50, count: int = 20, kind: str = "folder") -> None:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory(prefix="fifty-") as folder, placed(kind, Path(folder) / "centre") as there:
        place = Path(folder)
        roots, refused = [place / f"bench-{number:02d}" for number in range(benches)], 0
        clones: list[Ledger] = []
        for number, root in enumerate(roots):
            if number % CLONED:
                runs(root, number, count)
            else:
                clones.append(clone(root, number, count)[1])
        with ThreadPoolExecutor(4) as pool:
            found = sum(pool.map(lambda pair: until_done(pair[1], there, pair[0]), enumerate(roots)), Counter())
        centre = Centre(there.url)
        for ledger in clones:
            try:
                send(centre, ledger)
            except Exception as error:
                refused += "--copied" in str(error)
            send(centre, ledger.renewed())
        print(f"{benches} benches, {count} runs each; attempts: {dict(found)}; clones refused: {refused}/{len(clones)}")
        wanted = Counter(digest for root in roots for digest in manifests(root))
        wanted += Counter(digest for ledger in clones for digest in manifests(ledger.root) if digest not in wanted)
        here = archive(place / "here")
        print(f"fetch {timed(lambda: fetch(centre, here)):.1f} s, again {timed(lambda: fetch(centre, here)):.2f} s")
        got = Counter(manifests(here.root))
        lost, twice = wanted - got, Counter({key: n for key, n in got.items() if n > wanted[key]})
        print(f"runs {wanted.total()}, at the centre {got.total()}, lost {lost.total()}, twice {twice.total()}")
        folders = [RunFolder(path.parent) for path in here.root.glob(f"*/*/{MANIFEST}")]
        with open_registry(here.root / "registry.sqlite") as registry:
            print(f"register {timed(lambda: register_all(registry, folders, here)):.1f} s")
        costs(centre, archive(roots[1]), count)


def costs(centre: Centre, one: Ledger, count: int) -> None:
    """What a scrub and a `send` take, and what a bench says while the centre is gone."""
    done = scrub(centre)
    took = timed(lambda: scrub(centre))
    print(f"scrub {done.files} files, {done.bytes / 1e6:.1f} MB, {len(done.faults)} faults, {took:.1f} s")
    print(f"send with nothing to send {timed(lambda: send(centre, one)) * 1e3:.0f} ms")
    runs(one.root, 1, 20, count)
    print(f"send a run {timed(lambda: send(centre, one)) / 20 * 1e3:.0f} ms")
    if "://" in centre.url:
        return
    runs(one.root, 1, 1, count + 20)
    shutil.move(centre.url, f"{centre.url}-gone")
    try:
        reached(centre.url, one)
    except CentreError as error:
        print(f"centre gone: {str(error)[-70:]} {len(outbox(None, one, centre.url).waiting)} run waits")


def manifests(root: Path) -> list[str]:
    return [sha256(path) for path in root.glob(f"*/*/{MANIFEST}")]


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, int, str), sys.argv[1:], strict=False)))
