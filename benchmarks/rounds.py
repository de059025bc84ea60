"""Measurement for all benchmarks: a process per method, one thread, alternating rounds; the least value counts.

A benchmark module declares `CASES: dict[str, Case]` and `tables(quick) -> list[Table]`, which calls `measured`. A
method runs in a separate process (`python -m benchmarks.rounds MODULE CASE METHOD FOLDER`): the input is loaded and
not counted, a warm-up on few rows excludes imports and caches, then the work is done `REPEATS` times.
"""

from __future__ import annotations

import gc
import importlib
import importlib.util
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ONE_THREAD = {
    name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
}
REPEATS = 2
TIMEOUT_S = 1800.0


@dataclass(frozen=True)
class Method:
    """A measured method; `needs` names packages that may be missing; a `limit` is a physical limit.

    `once`: so slow that it runs once on all rows.
    """

    work: Callable[[Any], Any]
    needs: tuple[str, ...] = ()
    limit: bool = False
    once: bool = False


@dataclass(frozen=True)
class Case:
    """Methods for the same task; the first is ours, and ratios are relative to it.

    `load` reads the input from the folder that the parent filled, `few` takes a small part of it for the warm-up,
    `error` compares a result with the reference in the folder (None: not compared).
    """

    load: Callable[[Path], Any]
    few: Callable[[Any], Any]
    methods: Mapping[str, Method]
    error: Callable[[Any, Any, Path], float] | None = None
    repeats: int = REPEATS


@dataclass(frozen=True)
class Row:
    """One method: least CPU and wall [s], peak memory above interpreter, imports and input [MB], relative error."""

    case: str
    method: str
    cpu_s: float = float("nan")
    wall_s: float = float("nan")
    peak_mb: float = float("nan")
    error: float | None = None
    limit: bool = False
    failed: str = ""

    def against(self, ours: Row) -> float:
        """CPU of this in units of ours: above 1, ours is faster."""
        return self.cpu_s / ours.cpu_s


@dataclass(frozen=True)
class Table:
    """A table of docs/performance.md, with one sentence of explanation."""

    title: str
    reading: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: int = 1
    """Columns that hold words."""

    def markdown(self) -> str:
        """Heading, sentence, table."""
        rule = ["---"] * self.left + ["--:"] * (len(self.head) - self.left)
        padded = ([*row, *[""] * (len(self.head) - len(row))] for row in self.rows)
        lines = ["| " + " | ".join(cells) + " |" for cells in (self.head, rule, *padded)]
        return "\n".join([f"### {self.title}", "", self.reading, "", *(line.replace("  |", " |") for line in lines)])


def compared(title: str, reading: str, rows: Sequence[Row]) -> Table:
    """Rows of `measured` as the usual table."""
    head = ("case", "method", "CPU ms", "wall ms", "peak MB", "relative error", "CPU against ours")
    first: dict[str, Row] = {}
    out = []
    for row in rows:
        ours = first.setdefault(row.case, row)
        if row.failed:
            out.append([row.case, row.method, row.failed])
            continue
        error = "" if row.error is None or math.isnan(row.error) else f"{row.error:.0e}"
        times = (f"{1e3 * row.cpu_s:.1f}", f"{1e3 * row.wall_s:.1f}", f"{row.peak_mb:.0f}")
        out.append([row.case, f"**{row.method}**" if row is ours else row.method, *times, error, times_ours(row, ours)])
    return Table(title, reading, head, out, left=2)


def times_ours(row: Row, ours: Row) -> str:
    """Ratio of CPU times, two figures of it below 10."""
    ratio = row.against(ours)
    return "1" if row is ours else f"{ratio:.2g} x" if ratio < 10.0 else f"{ratio:.0f} x"


def measured(module: str, folder: Path, cases: Mapping[str, Case], rounds: int) -> list[Row]:
    """All methods of all cases, in alternating rounds; a missing package or a failure is stated in its row."""
    found: list[Row] = []
    for case, own in cases.items():
        tries: dict[str, list[Row]] = {name: [] for name in own.methods}
        for turn in range(rounds):
            for name, method in own.methods.items():
                if not ((turn and method.once) or any(row.failed for row in tries[name])):
                    tries[name].append(_attempt(module, folder, case, name, method))
        found += [best(rows) for rows in tries.values()]
    return found


def best(rows: Sequence[Row]) -> Row:
    """Least times and largest peak of the rounds; a failure is kept."""
    failed = [row for row in rows if row.failed]
    if failed:
        return failed[0]
    least = {key: min(getattr(row, key) for row in rows) for key in ("cpu_s", "wall_s")}
    return replace(rows[0], **least, peak_mb=max(row.peak_mb for row in rows))


def missing(packages: Sequence[str]) -> str:
    """Missing packages as text for a row; empty if all are installed."""
    gone = [name for name in packages if importlib.util.find_spec(name) is None]
    return f"not installed: {', '.join(gone)}" if gone else ""


def _attempt(module: str, folder: Path, case: str, name: str, method: Method) -> Row:
    empty = Row(case, name, limit=method.limit)
    if gone := missing(method.needs):
        return replace(empty, failed=gone)
    answer = spawn("benchmarks.rounds", module, case, name, str(folder))
    return replace(empty, **answer)


def spawn(module: str, *arguments: str) -> dict[str, Any]:
    """A module of the benchmarks in a separate process with one thread; its last JSON line, or {"failed": reason}."""
    command = [sys.executable, "-m", module, *arguments]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=TIMEOUT_S, env=os.environ | ONE_THREAD
        )
    except subprocess.TimeoutExpired:
        return {"failed": f"not done after {TIMEOUT_S:g} s"}
    if done.returncode:
        return {"failed": (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1][:90]}
    return dict(json.loads(done.stdout.splitlines()[-1]))


def memory_mb(line: str) -> float:
    """A line of this process's memory: VmHWM is its peak, VmRSS its current size [MB]."""
    text = Path("/proc/self/status").read_text(encoding="ascii")
    return next(float(row.split()[1]) for row in text.splitlines() if row.startswith(line)) * 1024 / 1e6


def forget_the_peak() -> float:
    """Reset the peak; returns the current size [MB]."""
    gc.collect()
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return memory_mb("VmRSS")


def timed(work: Callable[[], Any], repeats: int = REPEATS) -> tuple[dict[str, float], Any]:
    """Least CPU and wall [s] and the peak [MB] above the size before, and the last result."""
    before, cpu, wall = forget_the_peak(), float("inf"), float("inf")
    answer: Any = None
    for _ in range(repeats):
        answer = None  # else the peak would hold two
        begun = time.process_time(), time.perf_counter()
        answer = work()
        cpu, wall = min(cpu, time.process_time() - begun[0]), min(wall, time.perf_counter() - begun[1])
    return {"cpu_s": cpu, "wall_s": wall, "peak_mb": memory_mb("VmHWM") - before}, answer


def worker(module: str, case: str, method: str, folder: Path) -> dict[str, Any]:
    """One method in this process."""
    own: Case = importlib.import_module(module).CASES[case]
    what = own.methods[method]
    given = own.load(folder)
    what.work(own.few(given))
    found, answer = timed(lambda: what.work(given), 1 if what.once else own.repeats)
    return {**found, "error": None if what.limit or own.error is None else own.error(answer, given, folder)}


if __name__ == "__main__":
    print("\n" + json.dumps(worker(*sys.argv[1:4], Path(sys.argv[4]))))
