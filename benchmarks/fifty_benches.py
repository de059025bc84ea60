"""Fifty benches send to one centre while they are killed, cut off and cloned: what arrives, and what that costs.

    python -m benchmarks.fifty_benches [BENCHES] [RUNS]

Every bench is an archive of its own with small runs (means and raw data of two minutes). Its `send` is a process; it is
killed by SIGKILL at a moment drawn at random, or finds the centre gone, until one ends by itself. Some disks are cloned
after half of the runs and go on separately. In the end every manifest of every bench must be at the centre once.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bench.archive import Centre, Ledger, archive, fetch, outbox, reached, register_all, scrub, send
from bench.archive.registry.opening import open_registry
from bench.base import CentreError
from bench.record import MANIFEST, RunFolder, sha256
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


def attempt(root: Path, centre: str, draw: random.Random) -> str:
    """One `send` as a process: `done`, `killed`, or the last line of what it said."""
    process = subprocess.Popen(
        [sys.executable, "-c", SEND, centre, str(root)], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    try:
        _, said = process.communicate(timeout=draw.uniform(0.3, 4.0))
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.communicate()
        return "killed"
    return "done" if process.returncode == 0 else said.strip().splitlines()[-1]


def until_done(root: Path, centre: str, seed: int) -> Counter[str]:
    """Attempts of one bench until one ends by itself, every fifth while the cable is out."""
    draw, found = random.Random(seed), Counter[str]()
    while not found["done"]:
        out = draw.random() < 0.2
        said = attempt(root, "sftp://bench@127.0.0.1:9/runs" if out else centre, draw)
        found["cut off" if out and said not in {"killed", "done"} else said] += 1
    return found


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


def main(benches: int = 50, count: int = 20) -> None:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory(prefix="fifty-") as folder:
        place = Path(folder)
        url = str(place / "centre")
        roots, refused = [place / f"bench-{number:02d}" for number in range(benches)], 0
        clones: list[Ledger] = []
        for number, root in enumerate(roots):
            if number % CLONED:
                runs(root, number, count)
            else:
                clones.append(clone(root, number, count)[1])
        with ThreadPoolExecutor(4) as pool:
            found = sum(pool.map(lambda pair: until_done(pair[1], url, pair[0]), enumerate(roots)), Counter())
        centre = Centre(url)
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
    runs(one.root, 1, 1, count + 20)
    shutil.move(centre.url, f"{centre.url}-gone")
    try:
        reached(centre.url, one)
    except CentreError as error:
        print(f"centre gone: {str(error)[-70:]} {len(outbox(None, one, centre.url).waiting)} run waits")


def manifests(root: Path) -> list[str]:
    return [sha256(path) for path in root.glob(f"*/*/{MANIFEST}")]


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
