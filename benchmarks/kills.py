"""SIGKILL at random times to a bench with real processes and real time: measures the loss, and checks the rest.

    python -m benchmarks.kills --kills 20 --seed 1

Chamber and bus are served by `bench sim`; each run is killed with its whole process group, the capture of the bus
included. The loss is the time between the kill and the last sample of the recovered run. Prints one JSON object; exit
code 1 when a kill lost more than a second, a recovered block has a wrong CRC, or the chamber was not made safe.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bench.acquisition.recording.assemble import assemble
from bench.record.folder import RunFolder
from bench.record.samples import read_samples
from drivers.journal import Damage, read_blocks

PROFILE = "name: killed\nsegments:\n  - {kind: ramp, to_degc: 85, rate_degc_per_min: 2}\n"
PATIENCE_S = 60.0
MOST_LOST_S = 1.0


@dataclass(frozen=True)
class Kill:
    """Loss of one kill."""

    after_s: float
    """Bench time of the kill [s]."""
    lost_s: float
    """From the last recovered sample to the kill [s]."""
    blocks: int
    """Blocks of the journals with the right CRC."""
    torn_bytes: int
    """What was left out of the journals: a block that the kill cut off."""
    gaps: int
    """Samples missing before the last one."""
    safe: bool
    """Whether the watchdog says that the chamber was made safe, verified."""


@contextmanager
def served(folder: Path) -> Iterator[Path]:
    """A simulated station in a separate process; yields its station file."""
    path = folder / "station.yaml"
    sim = bench("sim", "--write-station", path)
    try:
        assert sim.stderr is not None
        while "ready" not in sim.stderr.readline():
            if sim.poll() is not None:
                raise RuntimeError("bench sim did not start")
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        content["watchdog"] = {"silent_s": 10.0, "retry_min": 0.5}
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        (folder / "profile.yaml").write_text(PROFILE, encoding="utf-8")
        yield path
    finally:
        sim.kill()
        sim.communicate()


def bench(*arguments: Any, **options: Any) -> subprocess.Popen[str]:
    """The command in a separate process."""
    command = [sys.executable, "-c", "from bench.cli import main; main()", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def kill_once(station: Path, out: Path, wait_s: float) -> Kill:
    """Start a run, kill it the given time after its first frame, recover it."""
    process = bench("run", station.parent / "profile.yaml", "--station", station, "--out", out, "--model", "polynomial",
                    start_new_session=True)  # fmt: skip
    try:
        journal = _wait_for(lambda: next(iter(out.glob("*/*/journal/can0.gtbj")), None))
        _wait_for(lambda: journal.stat().st_size > 10_000)
        time.sleep(wait_s)
        killed_ns = time.time_ns()
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=PATIENCE_S)  # the watchdog writes there too: to its end
    finally:
        process.kill()
    run = RunFolder(journal.parent.parent)
    damage = Damage()
    blocks = [block for path in sorted(run.journal.glob("*.gtbj")) for block in read_blocks(path, damage)]
    last = list(read_blocks(run.journal / "bench.gtbj"))[-1]  # bench time beside calendar time
    killed_s = last.t_s + (killed_ns - last.wall_ns) * 1e-9
    manifest = assemble(run)
    data = read_samples(run.data, "time", "rate")
    times = data["time"][np.isfinite(data["rate"])]
    events = list(run.events())
    safe = any(event["kind"] == "watchdog" and event.get("ok") for event in events)
    moved = any(event["kind"] == "write" for event in events)
    gaps = manifest.losses["lost"]
    return Kill(round(killed_s, 3), round(killed_s - float(times[-1]), 3), len(blocks),
                damage.skipped_bytes + damage.torn_bytes, gaps, safe or not moved)  # fmt: skip


def _wait_for(condition: Any) -> Any:
    until_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > until_s:
            raise TimeoutError("the run did not start")
        time.sleep(0.02)
    return found


def kill_often(kills: int, seed: int, folder: Path) -> list[Kill]:
    """The given number of kills, each 0 to 4 s after the first frames."""
    rng = random.Random(seed)
    with served(folder) as station:
        return [kill_once(station, folder / f"out{n}", rng.uniform(0.0, 4.0)) for n in range(kills)]


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        kills = kill_often(arguments.kills, arguments.seed, Path(scratch))
    lost = [kill.lost_s for kill in kills]
    figures = {
        "kills": len(kills),
        "after_s": [min(kill.after_s for kill in kills), max(kill.after_s for kill in kills)],
        "lost_s": {"median": float(np.median(lost)), "worst": max(lost)},
        "blocks_with_right_crc": sum(kill.blocks for kill in kills),
        "torn_bytes": sum(kill.torn_bytes for kill in kills),
        "samples_missing_before_the_last": sum(kill.gaps for kill in kills),
        "made_safe": sum(kill.safe for kill in kills),
    }
    print(json.dumps(figures, indent=1))
    return 0 if max(lost) <= MOST_LOST_S and figures["made_safe"] == len(kills) else 1


if __name__ == "__main__":
    sys.exit(main())
