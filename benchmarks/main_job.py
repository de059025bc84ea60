"""Speed of the main job in multiples of real time, before and after a change, by stage; checks that no bit changed.

    git worktree add /tmp/before 40f771d
    python -m benchmarks.main_job --before /tmp/before [--after .] [--profile profiles/quick.yaml] [--rounds 3]

Each run is a separate process, before and after in turn; CPU is that of all its threads. Of the rounds the fastest
counts, stage by stage. The digests are those of all captured frames, all chamber readings, and the tables.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmarks.rounds import Table  # the child runs with code of another commit, which has none

BEFORE = "40f771d"
"""The last commit with a simulation that was not looked at for speed."""

STAGES = {
    "simulation: chamber": "drivers.sim.station:SimulatedStation.advance",
    "simulation: physics of the unit": "drivers.sim.resonator:Resonator.advance",
    "simulation: its frames": "drivers.sim.can_gyro:CanGyro.send",
    "acquisition: poll over Modbus": "drivers.chamber:Chamber.poll",
    "acquisition: capture, journal": "drivers.canbus:InProcessCapture.poll",
    "acquisition: decoding": "bench.acquisition.station.unit:LiveUnit.take",
    "acquisition: sequence, guards": "bench.acquisition.run.sequencer:Sequencer._tick",
    "tables: data": "bench.acquisition.recording.assemble:_write_data",
    "tables: means": "bench.acquisition.recording.assemble:write_means",
    "tables: rest": "bench.acquisition.run.runner:assemble",
    "analysis: report, diagnosis": "bench.commands.analysis:report_on",
}
"""What is measured, and the function that does it; what it calls of the others is theirs."""
ACQUISITION = ("simulation", "acquisition", "start, imports")


class Stages:
    """CPU and wall time [s] of each stage, minus that of the stages inside it."""

    def __init__(self) -> None:
        self.cpu_s: dict[str, float] = defaultdict(float)
        self.wall_s: dict[str, float] = defaultdict(float)
        self._open: list[str] = []
        self._since = time.process_time(), time.perf_counter()

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Count the time inside as this stage."""
        self._charge()
        self._open.append(name)
        try:
            yield
        finally:
            self._charge()
            self._open.pop()

    def _charge(self) -> None:
        now = time.process_time(), time.perf_counter()
        if self._open:
            self.cpu_s[self._open[-1]] += now[0] - self._since[0]
            self.wall_s[self._open[-1]] += now[1] - self._since[1]
        self._since = now

    def watch(self, name: str, where: str) -> None:
        """Count every call of a function, `module:Class.method` or `module:function`, as this stage."""
        module, _, path = where.partition(":")
        *outer, last = path.split(".")
        owner = functools.reduce(getattr, outer, import_module(module))
        function: Callable[..., Any] = getattr(owner, last)

        @functools.wraps(function)
        def watched(*given: Any, **named: Any) -> Any:
            with self.of(name):
                return function(*given, **named)

        setattr(owner, last, watched)


def run_once(profile: Path, out: Path) -> dict[str, Any]:
    """The main job in this process: times by stage, simulated time, digests."""
    stages = Stages()
    with stages.of("start, imports"):
        for name, where in STAGES.items():
            stages.watch(name, where)
        from bench.analysis.effects.model import load_model
        from bench.commands import acquisition, analysis

        models = [load_model(model) for model in analysis.DEFAULT_MODELS]
        task = acquisition.Task((), {}, out)
        result = acquisition.conduct(profile, None, task, quiet=True)
        analysis.report_on(result.run, models, result.error)
    manifest = json.loads((result.run.path / "manifest.json").read_text())
    journals = {path.name: digest(path) for path in sorted(result.run.journal.glob("*.gtbj"))}
    tables = {name: manifest["files"][name][:16] for name in ("data.parquet", "means.parquet")}
    return {
        "cpu_s": stages.cpu_s,
        "wall_s": stages.wall_s,
        "simulated_s": manifest["duration_s"],
        "digests": journals | tables,
    }


def digest(journal: Path) -> str:
    """Of the frames and readings of a journal; events and headers contain calendar time."""
    from drivers.journal import Kind, read_blocks

    kept = (block for block in read_blocks(journal) if block.kind in (Kind.FRAMES, Kind.READING))
    found = hashlib.sha256()
    for block in kept:
        found.update(block.payload)
    return found.hexdigest()[:16]


def child(checkout: Path, profile: Path) -> dict[str, Any]:
    """One run of the main job with the code of a checkout."""
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve()), "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, __file__, "--child", str(profile.resolve()), out]
        output = subprocess.run(command, env=environment, cwd=out, check=True, stdout=subprocess.PIPE, text=True).stdout
    answer: dict[str, Any] = json.loads(output.splitlines()[-1])
    return answer


def least(runs: list[dict[str, Any]], what: str) -> dict[str, float]:
    """Least time of each stage over the rounds [s]."""
    return {name: min(run[what].get(name, 0.0) for run in runs) for name in ("start, imports", *STAGES)}


def tables(quick: bool) -> list[Table]:
    """This checkout against the commit before the main job was sped up, if the repository contains it."""
    profile = Path("profiles/quick.yaml" if quick else "profiles/ramp_-40_85.yaml")
    with tempfile.TemporaryDirectory() as name:
        before = exported(BEFORE, Path(name))
        return compared(profile, before, Path(__file__).parents[1], 1 if quick else 2)


def exported(commit: str, folder: Path) -> Path | None:
    """The files of a commit; None for an unknown one."""
    made = subprocess.run(
        ["git", "archive", commit], cwd=Path(__file__).parent.parent, capture_output=True, check=False
    )
    if made.returncode:
        return None
    subprocess.run(["tar", "-x", "-C", str(folder)], input=made.stdout, check=True)
    return folder


def compared(profile: Path, before: Path | None, after: Path, rounds: int) -> list[Table]:
    """Runs in turn; two tables."""
    old, new = [], []
    for _ in range(rounds):
        if before is not None:
            old.append(child(before, profile))
        new.append(child(after, profile))
    return [real_time(profile, old, new), by_stage(old, new)]


def real_time(profile: Path, before: list[dict[str, Any]], after: list[dict[str, Any]]) -> Table:
    """Multiples of real time, before and after."""
    from benchmarks.rounds import Table

    simulated_s = after[0]["simulated_s"]
    rows = []
    for title, kept in (("acquisition", ACQUISITION), ("whole, with tables, report, diagnosis", ("",))):
        for what in ("cpu_s", "wall_s"):
            old, new = (multiple(runs, what, kept) for runs in (before, after))
            name = f"{title}, {'CPU' if what == 'cpu_s' else 'wall'}"
            rows.append([name, *((f"{old:.0f}", f"{new:.0f}", f"{new / old:.2f} x") if old else ("", f"{new:.0f}"))])
    same = all(run["digests"] == after[0]["digests"] for run in (*before, *after))
    frames = (
        f"Frames, readings and tables are {'identical bit for bit' if same else 'not identical'}. " if before else ""
    )
    return Table(
        f"Times real time, {profile.stem}",
        f"{simulated_s / 3600:.1f} h at 500 Hz, simulated, captured, fitted, diagnosed, reported; before is {BEFORE}. "
        f"{frames}More is faster.",
        ("times real time", "before", "after", "ratio"),
        rows,
    )


def multiple(runs: list[dict[str, Any]], what: str, kept: tuple[str, ...]) -> float:
    """Simulated time over the least time of the stages with this prefix; 0 without a run."""
    sums = [sum(s for name, s in run[what].items() if name.startswith(kept)) for run in runs]
    return float(runs[0]["simulated_s"] / min(sums)) if runs else 0.0


def by_stage(before: list[dict[str, Any]], after: list[dict[str, Any]]) -> Table:
    """CPU of each stage, before and after."""
    from benchmarks.rounds import Table

    hours = after[0]["simulated_s"] / 3600.0
    new = least(after, "cpu_s")
    old = least(before, "cpu_s") if before else {}
    rows = []
    for name, own in new.items():
        then = (f"{old[name] / hours:.3f}", f"{old[name] / max(own, 1e-9):.1f} x") if old else ("", "")
        rows.append([name, then[0], f"{own / hours:.3f}", then[1], f"{own / sum(new.values()):.0%}"])
    return Table(
        "CPU of a simulated hour by stage",
        "Time in another stage counts only for that stage; the ratio is before over after.",
        ("stage", "before s", "after s", "ratio", "share after"),
        rows,
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--before", type=Path)
    parser.add_argument("--after", type=Path, default=Path.cwd())
    parser.add_argument("--profile", type=Path, default=Path("profiles/ramp_-40_85.yaml"))
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--child", nargs=2, type=Path, metavar=("PROFILE", "OUT"))
    options = parser.parse_args()
    if options.child:
        print(json.dumps(run_once(*options.child)))
        return
    for table in compared(options.profile, options.before, options.after, options.rounds):
        print(table.markdown(), end="\n\n")


if __name__ == "__main__":
    main()
