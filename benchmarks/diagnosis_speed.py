"""CPU and wall of `bench diagnose` on a three-hour run at 500 Hz, with one worker and with two, and its parts.

    python -m benchmarks.diagnosis_speed [RUN ...] [--rounds 3]

Without a run three hours are simulated. A process per result, numbers of workers in turn; the least value counts. In
the first table imports are not counted; "own" is the CPU of the main process (two idle processors need at least that
long), "all" includes copies. The second table has all that a new process does, with one worker.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rounds import Table, spawn

_PROFILE = """\
name: three_hours
start: {temperature_degc: 25, soak_min: 20}
segments:
  - {kind: ramp, to_degc: 70, rate_degc_per_min: 1.5}
  - {kind: soak, duration_min: 20}
  - {kind: ramp, to_degc: 10, rate_degc_per_min: 1.5}
  - {kind: soak, duration_min: 20}
  - {kind: ramp, to_degc: 40, rate_degc_per_min: 1.0}
"""
_WORKERS = (1, 2)
_PARTS = ("start, imports", "means, floor", "catalogue", "next run")


def _recorded(folder: Path) -> Path:
    """A simulated three-hour run at 500 Hz in this folder."""
    from bench.commands import acquisition

    profile = folder / "three_hours.yaml"
    profile.write_text(_PROFILE)
    return acquisition.conduct(profile, None, acquisition.Task((), {}, folder), quiet=True).run.path


def _spent() -> tuple[float, float, float]:
    """CPU of this process, of its ended copies, and wall time [s]."""
    times = os.times()
    return time.process_time(), times.children_user + times.children_system, time.perf_counter()


def once(path: Path, workers: int) -> dict[str, Any]:
    """One diagnosis in this process: its means and floor, then the search; times [s] and a digest of the result."""

    from bench.analysis.diagnosis.diagnose import diagnose
    from bench.analysis.effects.model import load_model
    from bench.commands.analysis import floor_of, recovered, usual_means

    model = load_model("spline")
    begun = _spent()
    seconds = recovered([path])
    (data,) = usual_means(seconds)
    floor_dph = floor_of(seconds, data.interval_s)
    read = _spent()
    found = diagnose([data], model, floor_dph=floor_dph, workers=workers)
    done = _spent()
    return {
        "floor_s": read[0] - begun[0],
        "own_s": done[0] - read[0],
        "all_s": done[0] - read[0] + done[1] - read[1],
        "wall_s": done[2] - read[2],
        "rows": len(data),
        "digest": hashlib.sha256(json.dumps(found.to_json(), sort_keys=True).encode()).hexdigest()[:12],
    }


def cold(path: Path) -> dict[str, Any]:
    """CPU [s] of the parts of one diagnosis in this new process, imports included."""
    from bench.analysis import diagnose, load_model, next_experiment
    from bench.analysis.diagnosis.describing import Describer
    from bench.commands.analysis import floor_of, recovered, usual_means

    formulas = 0.0
    describe = Describer.describe

    def timed(*given: Any) -> Any:
        nonlocal formulas
        begun = time.process_time()
        try:
            return describe(*given)
        finally:
            formulas += time.process_time() - begun

    Describer.describe = timed  # type: ignore[method-assign]
    model = load_model("spline")
    marks = [0.0, time.process_time()]
    seconds = recovered([path])
    runs = usual_means(seconds)
    floor_dph = floor_of(seconds, runs[0].interval_s)
    marks.append(time.process_time())
    found = diagnose(runs, model, floor_dph=floor_dph, workers=1)
    marks.append(time.process_time())
    next_experiment(found, runs)
    marks.append(time.process_time())
    spent = dict(zip(_PARTS, np.diff(marks).tolist(), strict=True))
    return spent | {"catalogue": spent["catalogue"] - formulas, "formulas": formulas}


def measured_cold(path: Path, rounds: int) -> Table:
    """The parts of a diagnosis in a new process."""
    tries = [spawn("benchmarks.diagnosis_speed", "--cold", str(path.resolve())) for _ in range(rounds)]
    failed = next((one["failed"] for one in tries if "failed" in one), "")
    if failed:
        return Table("Diagnosis, cold", failed, ("part",), ())
    least = min(tries, key=lambda one: sum(one.values()))
    answer = sum(least[part] for part in ("start, imports", "means, floor", "catalogue"))
    rows = [[part, f"{seconds:.2f}"] for part, seconds in least.items()]
    rows += [["until the catalogue's answer", f"{answer:.2f}"], ["all", f"{sum(least.values()):.2f}"]]
    return Table(f"Diagnosis, cold: {path.name}", "A new process with one worker.", ("part", "CPU s"), rows)


def measured(path: Path, rounds: int) -> Table:
    """All numbers of workers in turn."""
    tries: dict[int, list[dict[str, Any]]] = {workers: [] for workers in _WORKERS}
    for _ in range(rounds):
        for workers, own in tries.items():
            own.append(spawn("benchmarks.diagnosis_speed", "--child", str(workers), str(path.resolve())))
    failed = [answer["failed"] for own in tries.values() for answer in own if "failed" in answer]
    if failed:
        return Table("Diagnosis", failed[0], ("workers",), ())
    least = {n: {key: min(t[key] for t in own) for key in own[0] if key.endswith("_s")} for n, own in tries.items()}
    one = least[_WORKERS[0]]
    rows = [
        [str(workers), *(f"{found[key]:.2f}" for key in ("floor_s", "own_s", "all_s", "wall_s")),
         f"{one['own_s'] / found['own_s']:.2f} x", f"{one['wall_s'] / found['wall_s']:.2f} x"]
        for workers, found in least.items()
    ]  # fmt: skip
    digests = {answer["digest"] for own in tries.values() for answer in own}
    same = "identical digit for digit" if len(digests) == 1 else "DIFFERENT"
    means = tries[_WORKERS[0]][0]["rows"]
    reading = (
        f"Run {path.name}, {means} means; results with any number of workers: {same}. Floor: reading the 1 s means and "
        "the noise of the soaks; then the diagnosis: CPU of the main process, of all, and wall time."
    )
    head = ("workers", "floor CPU s", "own CPU s", "all CPU s", "wall s", "own CPU", "wall")
    return Table(f"Diagnosis: {path.name}", reading, head, rows)


def tables(quick: bool, runs: Sequence[Path] = (), rounds: int = 3) -> list[Table]:
    """The tables of docs/performance.md."""
    with tempfile.TemporaryDirectory() as folder:
        paths = runs or [_recorded(Path(folder))]
        return [of(path, 1 if quick else rounds) for path in paths for of in (measured, measured_cold)]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--child", type=int, metavar="WORKERS")
    parser.add_argument("--cold", action="store_true")
    options = parser.parse_args()
    if options.cold:
        print("\n" + json.dumps(cold(options.runs[0])))
        return
    if options.child:
        print("\n" + json.dumps(once(options.runs[0], options.child)))
        return
    for table in tables(False, options.runs, options.rounds):
        print(table.markdown())


if __name__ == "__main__":
    main()
