"""Does wrong data from the unit, or from the chamber's sensor, ever pass for a complete and admissible record?

    python -m benchmarks.spoiled_unit_data --out spoiled_unit.jsonl --seed 1

Every kind of spoiling of `KINDS` x two lengths: a whole run on the simulated station each. Frames are changed between
the simulated unit and its bus, with the CRC made right again; this file knows the bytes of the shipped layout itself
and shares nothing with the driver. Each run is assembled again from its journals alone, as if the bench had been
killed. Results are appended to the file as they come; what stands there already is not run again. Prints one JSON
object; exit code 1 when a record is complete and admissible, when what was left out is not what was spoiled to within
a second, or when assembling again gives another record.
"""

from __future__ import annotations

import argparse
import functools
import json
import random
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

import bench.acquisition.station.stage as opening
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.run.runner import Job, run_job
from bench.acquisition.station.settings.station import StationSettings
from bench.analysis.judging.judge import analyse
from bench.base import config
from bench.record import RunFolder
from bench.record.samples import read_samples
from benchmarks import campaigns
from drivers.sim.station import SimulatedStation

STATION = Path(__file__).parent.parent / "profiles" / "stations" / "simulated.yaml"
PROFILE = """\
name: spoiled
segments:
  - {kind: ramp, to_degc: 25.5, rate_degc_per_min: 1, arrival_band_degc: 0.5}
  - {kind: soak, duration_min: 1.5}
"""
AT_S = 50.0
LENGTHS_S = (6.0, 60.0)
RATE_HZ = 500
RATE, RESONATOR, HEARTBEAT = 0x120, 0x130, 0x700
FLAGS, STATUS = 6, 0x0F
VALID, LOCKED, COMPENSATED, SATURATED = 0x10, 0x20, 0x40, 0x80

Frames = np.ndarray[Any, np.dtype[np.void]]
Spoil = Callable[[Frames, "State"], Frames]


class State:
    """What a kind remembers while it lasts."""

    def __init__(self, seed: int) -> None:
        self.kept: dict[int, npt.NDArray[np.uint8]] = {}
        self.rng = np.random.default_rng(seed)


def _only(frames: Frames, identifier: int) -> npt.NDArray[np.intp]:
    return np.flatnonzero(frames["id"] == identifier)


def _changed(identifier: int, change: Callable[[npt.NDArray[np.uint8]], None]) -> Spoil:
    """Payloads (k, 8) of one message changed in place, then signed."""

    def spoil(frames: Frames, state: State) -> Frames:
        frames = frames.copy()
        rows = _only(frames, identifier)
        data = frames["data"][rows]
        change(data)
        frames["data"][rows] = data if identifier == HEARTBEAT else _signed(data, identifier)
        return frames

    return spoil


def _bits(byte: int, clear: int, put: int) -> Callable[[npt.NDArray[np.uint8]], None]:
    def change(data: npt.NDArray[np.uint8]) -> None:
        data[:, byte] = (data[:, byte] & (0xFF ^ clear)) | put

    return change


def _number(first: int, kind: str, value: Callable[[npt.NDArray[Any]], Any]) -> Callable[[npt.NDArray[np.uint8]], None]:
    """A little-endian number at a byte replaced by what `value` makes of it."""
    size = np.dtype(kind).itemsize

    def change(data: npt.NDArray[np.uint8]) -> None:
        raw = np.ascontiguousarray(data[:, first : first + size]).view(kind)[:, 0]
        new = np.broadcast_to(np.asarray(value(raw)), raw.shape).astype(kind)
        data[:, first : first + size] = new[:, None].view(np.uint8)

    return change


def _rate(value: Callable[[npt.NDArray[Any]], Any]) -> Spoil:
    return _changed(RATE, _number(0, "<i4", value))


def _temperature(value: Callable[[npt.NDArray[Any]], Any]) -> Spoil:
    return _changed(RESONATOR, _number(4, "<i2", value))


def _frozen(identifier: int, first: int, size: int) -> Spoil:
    """A number keeps the value that it had first, its frame its counter."""

    def spoil(frames: Frames, state: State) -> Frames:
        frames = frames.copy()
        rows = _only(frames, identifier)
        if len(rows):
            data = frames["data"][rows]
            kept = state.kept.setdefault(identifier, data[0, first : first + size].copy())
            data[:, first : first + size] = kept
            frames["data"][rows] = _signed(data, identifier)
        return frames

    return spoil


def _without(identifier: int) -> Spoil:
    return lambda frames, state: frames[frames["id"] != identifier]


def _signed(data: npt.NDArray[np.uint8], identifier: int) -> npt.NDArray[np.uint8]:
    """With CRC-8/SAE-J1850 over the bytes before the last and the low byte of the identifier."""
    for row in data:
        row[7] = _crc(bytes(row[:7]) + bytes([identifier & 0xFF]))
    return data


def _crc(data: bytes) -> int:
    crc = 0xFF
    for byte in data:
        crc = _TABLE[crc ^ byte]
    return crc ^ 0xFF


def _crc_step(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1) ^ 0x1D if byte & 0x80 else byte << 1
    return byte & 0xFF


_TABLE = [_crc_step(byte) for byte in range(256)]
_AIR: Spoil = lambda frames, state: frames  # noqa: E731 (the station shows it)

KINDS: Mapping[str, Spoil] = {
    "status 3": _changed(RATE, _bits(FLAGS, STATUS, 3)),
    "status 15": _changed(RATE, _bits(FLAGS, STATUS, 15)),
    "RateValid 0": _changed(RATE, _bits(FLAGS, VALID, 0)),
    "LoopLocked 0": _changed(RATE, _bits(FLAGS, LOCKED, 0)),
    "RateSaturated 1": _changed(RATE, _bits(FLAGS, 0, SATURATED)),
    "CompensationActive 1": _changed(RATE, _bits(FLAGS, 0, COMPENSATED)),
    "rate 7FFFFFFF": _rate(lambda raw: 0x7FFFFFFF),
    "rate 80000000": _rate(lambda raw: -0x80000000),
    "rate frozen": _frozen(RATE, 0, 4),
    "rate 0": _rate(lambda raw: 0),
    "temperature 160": _temperature(lambda raw: 32_000),
    "temperature 8000": _temperature(lambda raw: -0x8000),
    "temperature 7FFF": _temperature(lambda raw: 0x7FFF),
    "temperature + 20": _temperature(lambda raw: raw + 4000),
    "temperature - 20": _temperature(lambda raw: raw - 4000),
    "temperature in degF": _temperature(lambda raw: raw * 1.8 + 6400),
    "temperature frozen": _frozen(RESONATOR, 4, 2),
    "temperature missing": _without(RESONATOR),
    "heartbeat stopped": _changed(HEARTBEAT, _bits(0, 0xFF, 4)),
    "heartbeat missing": _without(HEARTBEAT),
    "heartbeat 255": _changed(HEARTBEAT, _bits(0, 0xFF, 255)),
    "air 80 degC": _AIR,
    "air -60 degC": _AIR,
}
"""Kinds of spoiling, by what is wrong."""


@dataclass(frozen=True)
class Case:
    """One run."""

    kind: str
    length_s: float


@dataclass(frozen=True)
class Outcome:
    """What became of it."""

    case: Case
    state: str
    spoiled_s: float
    """How long of the record was spoiled."""
    left_out_s: float
    complete: bool
    admissible: bool
    within: bool
    """What the exit code of the run rests on."""
    same_again: bool
    """Assembled again from the journals alone, the record is the same."""
    sentence: str

    @property
    def wrong(self) -> str:
        """What is not as it should be; empty: nothing."""
        if (self.complete and self.admissible) or self.within:
            return "complete and admissible"
        if abs(self.left_out_s - self.spoiled_s) > 1.0:
            return f"{self.left_out_s:.2f} s are left out, {self.spoiled_s:.2f} s were spoiled"
        return "" if self.same_again else "assembled again, it is another record"


def cases(seed: int) -> list[Case]:
    """All of them, in an order that the seed gives."""
    found = [Case(kind, length_s) for kind in KINDS for length_s in LENGTHS_S]
    random.Random(seed).shuffle(found)
    return found


class Wire:
    """Stands between the simulated unit and its bus."""

    def __init__(self, bus: Any, case: Case, seed: int) -> None:
        self.bus, self._case, self._state = bus, case, State(seed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.bus, name)

    def send_block(self, frames: Frames) -> None:
        """Send FRAME records (n,), spoiled while the case lasts."""
        if len(frames) and AT_S <= frames["t_ns"][0] * 1e-9 < AT_S + self._case.length_s:
            frames = KINDS[self._case.kind](frames, self._state)
        self.bus.send_block(frames)


@contextmanager
def _spoiled(case: Case, seed: int) -> Iterator[None]:
    simulate = opening.simulate

    @functools.wraps(simulate)
    def spoiled(*args: Any, **options: Any) -> SimulatedStation:
        world = simulate(*args, **options)
        for unit in world.units:
            unit.wire.bus = Wire(unit.wire.bus, case, seed)
        advance = world.advance

        def shown(t0_s: float, t1_s: float) -> None:
            world.shown.pop("temperature", None)
            if case.kind.startswith("air") and AT_S <= t0_s < AT_S + case.length_s:
                world.shown["temperature"] = float(case.kind.split()[1])
            advance(t0_s, t1_s)

        world.advance = shown  # type: ignore[method-assign]
        return world

    with patch.object(opening, "simulate", spoiled):
        yield


def run_case(case: Case, seed: int, folder: Path) -> Outcome:
    """One run on the simulated station."""
    content = config.read_yaml(STATION).content
    station = config.load_config(config.parse_yaml(json.dumps(content), "station.yaml"), StationSettings)
    job = Job(
        profile_from_text(PROFILE), PROFILE, station, json.dumps(content), {"model.yaml": "name: m\n"}, out=folder
    )
    with _spoiled(case, seed), redirect_stderr(StringIO()):
        run = run_job(job).run
    spoiled_s, left_out_s = _times(run, case)
    analysis = analyse(run.path, diagnose=False)
    said = analysis.to_json()
    return Outcome(
        case, analysis.manifest.state, round(spoiled_s, 3), round(left_out_s, 3), said["complete"], said["admissible"],
        analysis.within_limits, _same_again(run), said["sentence"],
    )  # fmt: skip


def _times(run: RunFolder, case: Case) -> tuple[float, float]:
    """How long of the record was spoiled, and how long of it has no value [s], from the table itself."""
    name = "chamber_temperature" if case.kind.startswith("air") else "rate"
    table = read_samples(run.data, "time", name, "chamber_setpoint")
    time, value = table["time"], table[name]
    hz = RATE_HZ
    if name != "rate":
        read = np.isfinite(table["chamber_setpoint"])
        time, value, hz = time[read], value[read], 1
    spoiled = (time >= AT_S) & (time < AT_S + case.length_s)
    return np.count_nonzero(spoiled) / hz, np.count_nonzero(np.isnan(value.astype(float))) / hz


def _same_again(run: RunFolder) -> bool:
    before = [run.manifest().left_out, run.data.read_bytes(), run.means.read_bytes()]
    for file in (run.data, run.means, run.path / "manifest.json"):
        file.unlink()
    manifest = assemble(run)
    return before == [manifest.left_out, run.data.read_bytes(), run.means.read_bytes()]


def campaign(todo: Sequence[Case], seed: int, out: Path) -> list[Outcome]:
    """Run what is not in the file yet, and append it; all outcomes that the file then holds."""

    def run(case: Case) -> Outcome:
        with tempfile.TemporaryDirectory() as scratch:
            return run_case(case, seed, Path(scratch))

    return campaigns.resumed(todo, run, out, lambda outcome: outcome.case, asdict, _made)


def read(path: Path) -> list[Outcome]:
    """Outcomes of an earlier, perhaps interrupted, campaign; its last line may be torn."""
    return campaigns.read(path, _made)


def _made(content: dict[str, Any]) -> Outcome:
    return Outcome(**{**content, "case": Case(**content["case"])})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("spoiled_unit_data.jsonl"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sample", type=int, help="only so many, drawn by the seed")
    arguments = parser.parse_args()
    outcomes = campaign(cases(arguments.seed)[: arguments.sample], arguments.seed, arguments.out)
    wrong = [outcome for outcome in outcomes if outcome.wrong]
    figures = {
        "n": len(outcomes),
        "seed": arguments.seed,
        "states": {
            state: sum(outcome.state == state for outcome in outcomes) for state in ("done", "aborted", "failed")
        },
        "complete_and_admissible": sum(outcome.complete and outcome.admissible for outcome in outcomes),
        "furthest_off_s": max((abs(outcome.left_out_s - outcome.spoiled_s) for outcome in outcomes), default=None),
        "wrong": [{**asdict(outcome.case), "wrong": outcome.wrong, "said": outcome.sentence} for outcome in wrong],
    }
    print(json.dumps(figures, indent=1))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
