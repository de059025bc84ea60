"""A registry of a million units: what `bench fleet`, the page's answers and registering a run cost.

    python -m benchmarks.million_units [UNITS] [FOLDER]

The rows are written by SQL into an SQLite file (2.9 GB for a million units): a finished run a unit, ten quantities and
a diagnosis each, lots of 200, fifty stations. `bench fleet` is a process whose time and peak memory are taken. The
answers are those of the page's HTTP API, from a server that has never counted them, from one that starts again, and
after runs were registered. These belong to an archive of their own, whose ledger has 20,000 others.
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

import httpx
import numpy as np

from bench.archive.registry.ledger import archive
from bench.archive.registry.opening import FILE, open_registry
from bench.archive.registry.summaries import summarise
from bench.archive.registry.writing import register
from bench.record import RunFolder
from bench.web.ground.settings import Settings
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
            lacks = ("thermal_lag", "", "", "hysteresis", "")
            _insert(database, "diagnoses", "run model verdict lacks file_sha256", ((
                f"{ARCHIVE}/{_path(i)}", "spline", "missing_effect" if lacks[i % 5] else "adequate", lacks[i % 5],
                f"{i:064x}") for i in numbers))  # fmt: skip
            _insert(database, "quantities", "run name unit value", _values(numbers))
            database.commit()
    with open_registry(path) as registry, registry.writing() as connection:
        summarise(connection)


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


_FILTERS = (
    "station=S-07", "lot=L-00007", "plan=ramp_-40_85", "since=2025-06-01&until=2025-06-07", "q=G-0500", "limits=line",
)  # fmt: skip
ROUTES = (
    "/units", "/units?q=G-0500", "/units?q=L-00007&sort=oldest", "/units?standing=fail",
    "/units?sort=serial&offset=900000",
    "/units/G-0000042", "/units/G-0000042/trends/residual_rms_dph", "/fleet", "/fleet/charts/residual_rms_dph",
    "/fleet/charts/distances", "/fleet/lacks", *(f"/fleet?{one}" for one in _FILTERS),
    "/fleet/charts/residual_rms_dph?station=S-07", "/fleet/lacks?lot=L-00007",
)  # fmt: skip


def answers(here: Path, meanwhile: Callable[[], object]) -> None:
    """Seconds of the page's answers: first ever (and until it was counted), first after a start, again, and stale."""
    settings, took = Settings(out=here, project=here), dict[str, list[str]]()

    def ask(client: httpx.Client) -> None:
        for route in ROUTES:
            begun = time.perf_counter()
            answer = client.get(f"/api/v1{route}", timeout=600.0)
            text = f"{time.perf_counter() - begun:.3f}"
            while answer.status_code == 202:
                time.sleep(0.1)
                answer = client.get(f"/api/v1{route}", timeout=600.0)
            if (whole := time.perf_counter() - begun) > 2.0 * float(text) + 0.1:
                text += f" ({whole:.1f})"
            took.setdefault(route, []).append(text if answer.is_success else f"status {answer.status_code}")

    with served(settings, repeats=False) as client:
        ask(client)
    with served(settings, repeats=False) as client:
        ask(client)
        ask(client)
        meanwhile()
        ask(client)
    for route, own in took.items():
        print(f"GET {route}: first ever (until counted) {own[0]} s, first after a start {own[1]} s, again {own[2]} s, "
              f"after a run was registered {own[3]} s", flush=True)  # fmt: skip


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
        here = root / "reports"
        registry, limits = here / FILE, here / "profiles" / "limits" / "line.yaml"
        limits.parent.mkdir(parents=True, exist_ok=True)
        if not registry.exists():
            begun = time.perf_counter()
            fill(registry, units)
            print(f"made in {time.perf_counter() - begun:.0f} s", flush=True)
        print(f"{units:,} units, {registry.stat().st_size / 1e9:.1f} GB", flush=True)
        limits.write_text(LIMITS)
        print(f"bench fleet --limits: {fleet(registry, here, '--limits', str(limits))}", flush=True)
        answers(here, lambda: print(registering(registry, root / "bench"), flush=True))


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, str), sys.argv[1:], strict=False)))
