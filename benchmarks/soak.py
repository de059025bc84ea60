"""A long simulated run with random faults: checks leaks, the report of every episode, and losses against injections.

    python -m benchmarks.soak --hours 24 --seed 1 [--out FOLDER]

Wrong data from the unit come in the pauses between the faults. Prints one JSON object; exit code 1 when something is
wrong. Bench time is simulated, the wires are real: Modbus TCP through a proxy that injects faults, CAN frames through a
wrapper that injects faults. 24 h take about ten minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.runner import Job, run_job
from bench.acquisition.run.status import Status
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.station import Station
from bench.base import config
from bench.record.folder import RunFolder
from bench.record.samples import SampleFile
from benchmarks.soak_data import DATA_S, random_data, spoiled
from drivers.wire import load_dbc

STATION = Path(__file__).parent.parent / "profiles" / "stations" / "simulated.yaml"
UNIT, BUS, CHAMBER = "SIM-0001", "can0", "chamber"
RATE_HZ = 500
HEARTBEAT = load_dbc("vibratory")["GYRO_HEARTBEAT"].id
SAMPLE_S = 600.0
"""Bench time between two looks at memory and handles [s]."""
QUIET_S = 90.0
"""Least time between two faults [s]."""
MOST_KB_PER_H = 100.0
"""More growth of the resident set than this is a leak: 24 h of frames are 1.2 GB."""

WIRE = ("silence", "drop", "truncate", "garble", "transaction", "device", "function", "count", "exception", "split",
        "close", "refuse", "delay")  # fmt: skip
FRAMES = ("loss", "corrupt", "reorder", "error_frames")


def random_fault(rng: random.Random, at_s: float) -> dict[str, Any]:
    """A fault that a run survives."""
    kind = rng.choice(("chamber", "chamber", "frames", "duplicate", "outage", "unit"))
    fault: dict[str, Any] = {"at_s": round(at_s)}
    if kind == "chamber":
        name = rng.choice(WIRE)
        fault |= {"on": CHAMBER, "fault": name, "for_s": rng.randint(3, 40)}
        if name in ("silence", "refuse"):
            return fault
        return fault | {"share": round(rng.uniform(0.05, 0.5), 2), "seconds": 0.05 if name == "delay" else 0.0}
    if kind == "frames":
        return fault | {"on": BUS, "fault": rng.choice(FRAMES), "share": round(rng.uniform(0.01, 0.2), 3),
                        "for_s": rng.randint(5, 60)}  # fmt: skip
    if kind == "duplicate":
        return fault | {"on": BUS, "fault": "duplicate", "share": 0.1, "for_s": rng.randint(5, 60)}
    if kind == "outage":
        name = rng.choice(("silence", "bus_off", "burst"))
        return fault | {"on": BUS, "fault": name, "for_s": 3, "seconds": 1.0 if name == "burst" else 0.0}
    return fault | {
        "on": UNIT,
        "fault": rng.choice(("reset", "silent_reset")),
        "seconds": round(rng.uniform(0.1, 3), 1),
    }


def random_faults(hours: float, seed: int, mean_s: float) -> list[dict[str, Any]]:
    """Faults over the given hours, about one every `mean_s` [s]."""
    rng, at_s, faults = random.Random(seed), 60.0, []
    while at_s < 3600.0 * hours - 120.0:
        faults.append(random_fault(rng, at_s))
        at_s += QUIET_S + rng.expovariate(1.0 / (mean_s - QUIET_S))
    return faults


def profile_text(hours: float) -> str:
    """Ramps of up to 40 degC at 1.5 degC/min and soaks, slightly longer than the given hours in total."""
    cycles = max(round(hours / 2), 1)
    quarter_min = 15.0 * hours / cycles  # of a cycle: ramp, soak, ramp, soak
    high = 25.0 + min(40.0, 1.5 * quarter_min)
    soak_min = 2 * quarter_min - (high - 25.0) / 1.5
    legs = []
    for target in (high, 25.0):
        legs.append(f"{{kind: ramp, to_degc: {target:.2f}, rate_degc_per_min: 1.5, arrival_band_degc: 3}}")
        legs.append(f"{{kind: soak, duration_min: {soak_min:.4f}}}")
    cycle = "\n".join(f"      - {leg}" for leg in legs)
    return f"name: soak\nsegments:\n  - kind: repeat\n    times: {cycles}\n    segments:\n{cycle}\n"


@dataclass
class Watcher:
    """Observes the process during the run."""

    every_s: float
    seen: list[tuple[float, float, int, int]] = field(default_factory=list)
    """Bench time [s], resident set [kB], open files, threads."""
    station: Station | None = None

    def __call__(self, station: Station, status: Status) -> None:
        self.station = station
        if not self.seen or status.t_s - self.seen[-1][0] >= self.every_s:
            self.seen.append((status.t_s, resident_kb(), len(os.listdir("/proc/self/fd")), threading.active_count()))  # noqa: PTH208

    def quarters(self, column: int) -> dict[str, list[int]]:
        """Observations of the first and of the last quarter of the run."""
        quarter = max(len(self.seen) // 4, 1)
        parts = {"first_quarter": self.seen[:quarter], "last_quarter": self.seen[-quarter:]}
        return {name: sorted({int(row[column]) for row in rows}) for name, rows in parts.items()}

    def slope_kb_per_h(self) -> float:
        """Growth of the resident set over the second half of the run."""
        half = np.array(self.seen)[len(self.seen) // 2 :]
        return float(np.polyfit(half[:, 0] / 3600.0, half[:, 1], 1)[0]) if len(half) > 2 else 0.0


def resident_kb() -> float:
    """Resident set of this process [kB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1024


def soak(hours: float, seed: int, out: Path, mean_s: float = 600.0, every_s: float = SAMPLE_S) -> dict[str, Any]:
    """Run it; returns the measured values, and under `wrong` the violations."""
    faults = random_faults(hours, seed, mean_s)
    content = dict(config.read_yaml(STATION).content) | {"faults": faults, "seed": seed}
    text = profile_text(hours)
    station = config.load_config(config.parse_yaml(json.dumps(content), "station.yaml"), StationSettings)
    job = Job(profile_from_text(text), text, station, json.dumps(content), {"model.yaml": "name: m\n"}, out=out)
    watcher, started_s = Watcher(every_s), time.monotonic()
    handles = len(os.listdir("/proc/self/fd")), threading.active_count()  # noqa: PTH208
    data = random_data(faults, seed)
    with spoiled(data, seed):
        result = run_job(job, watcher)
    took_s = time.monotonic() - started_s
    after = len(os.listdir("/proc/self/fd")), threading.active_count()  # noqa: PTH208
    reported = episodes(result.run)
    time_axis = axis(result.run)
    injection = watcher.station.injection  # type: ignore[union-attr]
    struck = {on: dict(wire.counts) for on, wire in injection.wires.items()}
    no_crc = injection.wires[BUS].struck["corrupt", HEARTBEAT] if BUS in injection.wires else 0
    struck[CHAMBER] = dict(injection.proxy.counts)
    manifest = result.run.manifest()
    figures = {
        "hours": round(manifest.duration_s / 3600, 3),
        "seed": seed,
        "wall_s": round(took_s, 1),
        "faults": len(faults),
        "faults_by_name": dict(Counter(f"{fault['on']} {fault['fault']}" for fault in faults)),
        "wrong_data": len(data),
        "wrong_data_by_kind": dict(Counter(kind for _, kind in data)),
        "left_out": sum(entry.samples for entry in manifest.left_out),
        "struck": struck,
        "corrupt_heartbeats": no_crc,
        "state": manifest.state,
        "cause": manifest.cause,
        "losses": manifest.losses,
        "events": reported,
        **time_axis,
        "rss_kb": [round(kb) for _, kb, _, _ in watcher.seen],
        "rss_slope_kb_per_h": round(watcher.slope_kb_per_h(), 1),
        "open_files": watcher.quarters(2),
        "threads": watcher.quarters(3),
        "handles_before_after": [handles, after],
        "run": str(result.run.path),
    }
    return figures | {"wrong": list(wrong(figures, faults, hours))}


def episodes(run: RunFolder) -> dict[str, int]:
    """Number of events by kind; for those of a rehearsal, beginnings and ends separately."""
    kinds: Counter[str] = Counter()
    for event in run.events():
        kinds[
            f"fault {'begins' if event['begins'] else 'ends'}" if event["kind"] == "rehearsal" else event["kind"]
        ] += 1
    return dict(kinds)


def axis(run: RunFolder) -> dict[str, Any]:
    """Number of samples, and whether their time stamps increase."""
    samples, last_s, backwards = 0, -1.0, 0
    with SampleFile(run.data) as file:
        for table in file.batches(["time", "rate"], 1 << 19):
            times = table["time"]
            backwards += int(np.count_nonzero(np.diff(times, prepend=last_s) <= 0))
            last_s = float(times[-1])
            samples += int(np.count_nonzero(np.isfinite(table["rate"])))
    return {"samples": samples, "last_s": round(last_s, 3), "time_stamps_not_increasing": backwards}


def wrong(figures: dict[str, Any], faults: list[dict[str, Any]], hours: float) -> Iterator[str]:
    """Violations."""
    losses = figures["losses"]
    if figures["hours"] < hours - 0.05:
        yield f"{figures['hours']} h instead of {hours:g}"
    if figures["state"] != "done":
        yield f"the run ended {figures['state']}: {figures['cause']}"
    if figures["time_stamps_not_increasing"]:
        yield f"{figures['time_stamps_not_increasing']} time stamps do not increase"
    begun = figures["events"].get("fault begins", 0)
    if begun != len(faults):
        yield f"{begun} of {len(faults)} faults are events"
    sent = round(figures["last_s"] * RATE_HZ)
    found = figures["samples"] + losses["lost"] + losses["late"] + figures["left_out"]
    if abs(found - sent) > 1 + losses["resets"]:
        counts = f"{figures['samples']} samples, {losses['lost']} lost and {losses['late']} late"
        yield f"{counts} and {figures['left_out']} left out are {found}, {sent} were sent"
    resets = sum(1 for fault in faults if fault["fault"] in ("reset", "silent_reset"))
    if losses["resets"] != resets:
        yield f"{losses['resets']} of {resets} resets were counted"
    corrupt = figures["struck"].get(BUS, {}).get("corrupt", 0) - figures["corrupt_heartbeats"]  # these have no CRC
    if losses["corrupt"] != corrupt:
        yield f"{losses['corrupt']} corrupt frames counted, {corrupt} injected"
    if abs(figures["left_out"] / RATE_HZ - DATA_S * figures["wrong_data"]) > figures["wrong_data"]:
        yield f"{figures['left_out']} samples left out for {figures['wrong_data']} stretches of {DATA_S:g} s"
    yield from leaks(figures, hours)


def leaks(figures: dict[str, Any], hours: float) -> Iterator[str]:
    """Resources that grow although they must not."""
    if hours >= 4 and figures["rss_slope_kb_per_h"] > MOST_KB_PER_H:
        yield f"memory grows by {figures['rss_slope_kb_per_h']} kB/h"
    for what in ("open_files", "threads"):  # a connection that is being renewed may be counted twice
        most, least_late = max(figures[what]["first_quarter"]), min(figures[what]["last_quarter"])
        if least_late > most:
            yield f"{what} grow: {figures[what]}"
    before, after = figures["handles_before_after"]
    if tuple(after) > tuple(before):
        yield f"open files and threads were {before} before the run and are {after} after it"


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mean-s", type=float, default=600.0, help="about one fault in so many seconds")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        figures = soak(arguments.hours, arguments.seed, arguments.out or Path(scratch), arguments.mean_s)
    print(json.dumps(figures, indent=1))
    return 1 if figures["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
