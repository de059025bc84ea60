"""A registry of a million units: what `bench fleet`, the page's answers and registering a run cost.

    python -m benchmarks.million_units [UNITS] [FOLDER]

The rows are written by SQL into an SQLite file (some 4 GB for a million units): a finished run a unit, ten quantities
each, lots of 200, fifty stations. `bench fleet` is a process whose time and peak memory are taken; the answers are those
of the page's HTTP API, each asked once and again; the run that is registered belongs to an archive of its own, whose ledger
has 20,000 others.
"""

from __future__ import annotations

import contextlib
import resource
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from bench.archive.registry.ledger import archive
from bench.archive.registry.opening import FILE, open_registry
from bench.archive.registry.writing import register
from bench.record import RunFolder
from tests.support.run_folders import make_run, ramp_run

UNITS, LOT, STATIONS, SEEN = 1_000_000, 200, 50, 20_000
ARCHIVE = "0123456789ab"
QUANTITIES = (
    "angle_random_walk_dprh", "bias_instability_dph", "bias_max_dph", "bias_span_dph", "fit_rms_dph",
    "noise_floor_dph", "rate_random_walk_dphrh", "residual_peak_dph", "residual_rms_dph", "thermal_hysteresis_dph",
)  # fmt: skip
LIMITS = """name: line
limits:
  - {quantity: residual_rms_dph, upper: 2.0}
  - {quantity: bias_max_dph, upper: 2.2}
"""
_BATCH = 20_000
_FLEET = "import sys; from bench.cli import main; sys.exit(main(sys.argv[1:]))"


def fill(path: Path, units: int) -> None:
    """Make the registry and its rows."""
    open_registry(path).close()
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA synchronous=OFF")
        database.execute("INSERT INTO archives VALUES (?, ?)", (ARCHIVE, "elsewhere:/line"))
        for start in range(0, units, _BATCH):
            numbers = range(start, min(start + _BATCH, units))
            _insert(
                database, "units", "serial lot archive", ((_serial(i), f"L-{i // LOT:05d}", ARCHIVE) for i in numbers)
            )
            _insert(database, "runs", "id archive path unit profile station created state cause simulated corrected "
                    "manifest_sha256 seen", map(_run, numbers))  # fmt: skip
            _insert(database, "calibrations", "run verdict judged limits model file_sha256", map(_calibration, numbers))
            _insert(database, "quantities", "run name unit value", _values(numbers))
            database.commit()


def _insert(database: sqlite3.Connection, table: str, columns: str, rows: Iterable[tuple[object, ...]]) -> None:
    names = columns.split()
    database.executemany(f"INSERT INTO {table} ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})", rows)


def _serial(number: int) -> str:
    return f"G-{number:07d}"


def _path(number: int) -> str:
    return f"{_serial(number)}/20260101T000000Z_ramp"


def _run(number: int) -> tuple[object, ...]:
    begun = time.strftime("%Y-%m-%dT%H:%M:%S+00:00", time.gmtime(1.7e9 + 90.0 * number))
    return (f"{ARCHIVE}/{_path(number)}", ARCHIVE, _path(number), _serial(number), "ramp_-40_85",
            f"S-{number % STATIONS:02d}", begun, "done", "end of profile", False, False, f"{number:064x}",
            number + 2)  # fmt: skip


def _calibration(number: int) -> tuple[object, ...]:
    verdict = "FAIL" if number % 500 == 499 else "PASS"
    return f"{ARCHIVE}/{_path(number)}", "bounded", verdict, "line", "spline", f"{number:064x}"


def _values(numbers: range) -> Iterator[tuple[object, ...]]:
    random = np.random.default_rng(numbers.start)
    of_lot = np.random.default_rng(7).normal(0.0, 0.05, (numbers.stop // LOT + 1, len(QUANTITIES)))
    noise = random.normal(0.0, 0.1, (len(numbers), len(QUANTITIES)))
    values = 1.0 + of_lot[np.array(numbers) // LOT] + noise
    for number, own in zip(numbers, values.tolist(), strict=True):
        run = f"{ARCHIVE}/{_path(number)}"
        for name, value in zip(QUANTITIES, own, strict=True):
            yield run, name, "deg/h", value


def timed(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def fleet(root: Path, *more: str) -> str:
    """`bench fleet` as a process: seconds, peak memory, and the sentence that it prints."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", _FLEET, "fleet", "--out", str(root), *more], capture_output=True, text=True
    )
    took = time.perf_counter() - begun
    peak = max(before, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
    said = (done.stdout or done.stderr).splitlines()
    return f"{took:.1f} s, {peak / 1e6:.2f} GB, exit {done.returncode}: {said[0][:100] if said else ''}"


def answers(root: Path) -> None:
    """The page's answers that speak of all units, each asked once and again."""
    from fastapi.testclient import TestClient

    from bench.web import Settings, create_app

    with TestClient(create_app(Settings(out=root, project=root, own=root / "own"))) as client:
        for route in ("/units", "/units?q=G-0500", "/units?q=L-00007&sort=oldest", "/units/G-0000042", "/fleet",
                      "/fleet?station=S-07", "/fleet/charts/residual_rms_dph", "/fleet/charts/distances", "/runs"):  # fmt: skip
            took, size = [], 0
            for _ in range(2):
                begun = time.perf_counter()
                answer = client.get(f"/api/v1{route}")
                took.append(time.perf_counter() - begun)
                size = len(answer.content)
            print(
                f"GET {route}: {took[0]:.2f} s, again {took[1]:.3f} s, {size / 1e3:.0f} kB, {answer.status_code}",
                flush=True,
            )


def registering(registry: Path, folder: Path) -> str:
    """Seconds to register a run of an archive that has seen 20,000 others."""
    ledger = archive(folder)
    ledger.saw_all([(f"A-{number}/r", f"{number:064x}") for number in range(SEEN)])
    took = []
    with open_registry(registry) as opened:
        for number in range(5):
            run = f"r{number}"
            make_run(folder / "NEW" / run, **ramp_run(legs=(("soak", "soak", 25.0, 120.0),)), unit="NEW", run=run)
            took.append(timed(lambda run=run: register(opened, RunFolder(folder / "NEW" / run), ledger)))  # type: ignore[misc]
    return f"register a run: {np.median(took):.3f} s (5 runs, slowest {max(took):.3f} s)"


def main(units: int = UNITS, where: str | None = None) -> None:
    with contextlib.ExitStack() as stack:
        root = Path(where) if where else Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="million-")))
        root.mkdir(parents=True, exist_ok=True)
        if not (root / FILE).exists():
            print(f"made in {timed(lambda: fill(root / FILE, units)):.0f} s", flush=True)
        print(f"{units:,} units, {(root / FILE).stat().st_size / 1e9:.1f} GB", flush=True)
        limits = root / "line.yaml"
        limits.write_text(LIMITS)
        print(f"bench fleet: {fleet(root)}", flush=True)
        print(f"bench fleet --limits: {fleet(root, '--limits', str(limits))}", flush=True)
        answers(root)
        print(registering(root / FILE, root.with_name(f"{root.name}-bench")))


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, str), sys.argv[1:])))
