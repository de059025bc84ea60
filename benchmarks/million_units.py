"""A registry of a million units: what `bench fleet`, the page's answers and registering a run cost.

    python -m benchmarks.million_units [UNITS] [FOLDER]

The rows are written by SQL into an SQLite file (2.3 GB for a million units): a finished run a unit, ten quantities
each, lots of 200, fifty stations. `bench fleet` is a process whose time and peak memory are taken. The answers are
those of the page's HTTP API: once, again, and after runs were registered. These belong to an archive of their own,
whose ledger has 20,000 others.
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
from bench.archive.registry.opening import open_registry
from bench.archive.registry.writing import register
from bench.record import RunFolder
from bench.web.ground.settings import Settings
from bench.web.shelf import stock
from tests.support.run_folders import make_run, ramp_run
from tests.support.web_client import served

UNITS, LOT, STATIONS, SEEN = 1_000_000, 200, 50, 20_000
ARCHIVE = "0123456789ab"
QUANTITIES = (
    "angle_random_walk_dprh", "bias_instability_dph", "bias_max_dph", "bias_span_dph", "fit_rms_dph",
    "noise_floor_dph", "rate_random_walk_dphrh", "residual_peak_dph", "residual_rms_dph", "thermal_hysteresis_dph",
)  # fmt: skip
LIMITS = """name: line
limits:
  - {quantity: residual_rms_dph, unit: deg/h, upper: 2.0, reason: budget}
  - {quantity: bias_max_dph, unit: deg/h, upper: 2.2, reason: budget}
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


def fleet(registry: Path, here: Path, *more: str) -> str:
    """`bench fleet` as a process: seconds, those of a processor, peak memory, and the sentence that it prints."""
    command = [sys.executable, "-c", _FLEET, "fleet", "--registry", str(registry), "--out", str(here), *more]
    begun = time.perf_counter()
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    took, used = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    said = (done.stdout or done.stderr).splitlines()[0][:80]
    cpu = used.ru_utime + used.ru_stime
    return f"{took:.1f} s ({cpu:.1f} s of a processor), {used.ru_maxrss / 1e6:.2f} GB, exit {done.returncode}: {said}"


ROUTES = (
    "/units", "/units?q=G-0500", "/units?q=L-00007&sort=oldest", "/units?standing=fail", "/units/G-0000042", "/fleet",
    "/fleet?station=S-07", "/fleet/charts/residual_rms_dph", "/fleet/charts/distances",
)  # fmt: skip


def answers(registry: Path, here: Path, meanwhile: Callable[[], object]) -> None:
    """The page's answers that speak of all units: once, again, and after `meanwhile`, when the last ones are stale."""
    with served(Settings(out=here, registry=str(registry), project=here)) as client:
        took: dict[str, list[float]] = {route: [] for route in ROUTES}
        size: dict[str, int] = {}

        def ask() -> None:
            for route in ROUTES:
                begun = time.perf_counter()
                answer = client.get(f"/api/v1{route}", timeout=300.0)
                took[route].append(time.perf_counter() - begun)
                size[route] = len(answer.content) if answer.is_success else -answer.status_code

        ask()
        stock._SHARED_S = 1e6  # as the file beside the run folders, which is asked again only after it changed
        ask()
        ask()
        meanwhile()
        stock._SHARED_S = 1e-3
        ask()
        for route, own in took.items():
            first, _, again, stale = own
            print(f"GET {route}: {first:.2f} s, again {again:.3f} s, stale {stale:.3f} s, {size[route]} B", flush=True)


def registering(registry: Path, folder: Path) -> str:
    """Seconds to register a run of an archive that has seen 20,000 others."""
    ledger = archive(folder)
    ledger.saw_all([(f"A-{number}/r", f"{number:064x}") for number in range(SEEN)])
    took = []
    with open_registry(registry) as opened:
        for number in range(5):
            run = folder / "NEW" / f"r{number}"
            make_run(run, **ramp_run(legs=(("soak", "soak", 25.0, 120.0),)), unit="NEW", run=run.name)
            begun = time.perf_counter()
            register(opened, RunFolder(run), ledger)
            took.append(time.perf_counter() - begun)
    return f"register a run: {np.median(took):.3f} s (5 runs, slowest {max(took):.3f} s)"


def main(units: int = UNITS, where: str | None = None) -> None:
    with contextlib.ExitStack() as stack:
        root = Path(where) if where else Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="million-")))
        registry, here = root / "line.sqlite", root / "reports"
        here.mkdir(parents=True, exist_ok=True)
        if not registry.exists():
            begun = time.perf_counter()
            fill(registry, units)
            print(f"made in {time.perf_counter() - begun:.0f} s", flush=True)
        print(f"{units:,} units, {registry.stat().st_size / 1e9:.1f} GB", flush=True)
        limits = root / "line.yaml"
        limits.write_text(LIMITS)
        print(f"bench fleet --limits: {fleet(registry, here, '--limits', str(limits))}", flush=True)
        answers(registry, here, lambda: print(registering(registry, root / "bench"), flush=True))


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, str), sys.argv[1:], strict=False)))
