"""Checks that the chamber is off, and the report true, when only its answers are corrupted and all requests reach it.

    python -m benchmarks.spoiled_answers --out spoiled.jsonl --seed 1

Every register map x every function code that it uses x every kind of spoiling of `benchmarks.spoiling` x from before
the start, during a ramp, in the safe state: a whole run on the simulated station each, with the proxy between driver
and simulated controller. Results are appended to the file as they come; what stands there already is not run again.
Prints one JSON object; exit code 1 when a chamber stayed on, a run claimed a safe state that was not reached, or one
whose safe state was spoiled claimed to have verified it.
"""

from __future__ import annotations

import argparse
import functools
import json
import random
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, redirect_stderr
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Literal, get_args
from unittest.mock import patch

import bench.acquisition.station.station as opening
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.runner import Job, run_job
from bench.acquisition.run.status import Status
from bench.acquisition.run.wiring import Continue, Stop
from bench.acquisition.station import stage
from bench.acquisition.station.settings.station import StationSettings
from bench.base import BenchError, config
from benchmarks import campaigns
from benchmarks.spoiling import KINDS, TIMEOUT_S, SpoilingProxy
from drivers.errors import DriverError
from drivers.modbus import ModbusLink
from drivers.registers import list_maps, load_map
from drivers.sim.station import SimulatedStation

STATION = Path(__file__).parent.parent / "profiles" / "stations" / "simulated.yaml"
PROFILE = """\
name: spoiled
segments:
  - {kind: ramp, to_degc: 24.5, rate_degc_per_min: 2, arrival_band_degc: 0.5}
  - {kind: soak, duration_min: 0.5}
"""
AT_S = 20.0
"""In the middle of the ramp [s]."""
AMBIENT_DEGC = 23.0
NOT_VERIFIED = "SAFE STATE NOT VERIFIED"
When = Literal["before", "ramp", "safe state"]


@dataclass(frozen=True)
class Case:
    """One run."""

    map: str
    function: int
    kind: str
    when: When


@dataclass(frozen=True)
class Outcome:
    """Result of one run."""

    case: Case
    off: bool
    """Whether the simulated controller says itself that it is off, past wire and driver."""
    setpoint: float
    """Its set point [degC]."""
    struck: int
    """Answers that were spoiled, all in all."""
    struck_at_end: int
    """Of these, in the safe state."""
    said: str
    """What the run says; empty: it went to its end."""

    @property
    def unverified(self) -> bool:
        """Whether the bench reports that it could not verify the safe state."""
        return NOT_VERIFIED in self.said

    @property
    def wrong(self) -> str:
        """Violations; empty if there are none."""
        if not self.off:
            return "the chamber is on"
        if self.case.when == "before" and not self.struck_at_end:
            return ""  # nothing was commanded
        if not self.unverified and abs(self.setpoint - AMBIENT_DEGC) > 0.1:
            return f"verified, and its set point is {self.setpoint:g} degC"
        if self.struck_at_end and not self.unverified:
            return f"{self.struck_at_end} answers of its safe state were spoiled, and it claims to be verified"
        return ""


def cases(seed: int, maps: Sequence[str] = ()) -> list[Case]:
    """All cases, in an order given by the seed."""
    found = []
    for name in maps or list_maps():
        registers = load_map(name).registers.values()
        functions = {register.read for register in registers} | {r.write for r in registers if r.write is not None}
        found += [
            Case(name, function, kind, when)
            for function in sorted(functions)
            for kind in KINDS
            for when in get_args(When)
        ]
    random.Random(seed).shuffle(found)
    return found


def run_case(case: Case, seed: int, folder: Path) -> Outcome:
    """One run on the simulated station."""
    with _between():
        return _run(case, seed, folder)


def _run(case: Case, seed: int, folder: Path) -> Outcome:
    _here.case, _here.seed, _here.worlds, _here.proxies = case, seed, [], []
    proxies: list[SpoilingProxy] = _here.proxies
    try:
        watcher = _Watcher(case.when, proxies)
        try:
            error: Any = run_job(_job(case.map, folder), watcher.look, decider=watcher).error
        except (BenchError, DriverError) as refused:
            error = refused
        commands = _here.worlds[0].chamber.commands()
        struck = sum(proxy.struck for proxy in proxies)
    finally:
        for proxy in proxies:
            proxy.close()
    at_end = 0 if watcher.struck is None else struck - watcher.struck
    if case.when == "ramp" and watcher.began:
        at_end = struck - watcher.at_last
    return Outcome(case, not commands.on, commands.setpoint, struck, at_end, "" if error is None else str(error))


class _Watcher:
    """Arms the proxy at the right time, and ends the run for cases of the safe state."""

    def __init__(self, when: When, proxies: list[SpoilingProxy]) -> None:
        self.began, self.struck, self.at_last = False, None if when == "before" else 0, 0
        self._when, self._proxies = when, proxies

    def look(self, station: Any, status: Status) -> None:
        """Arm it in the middle of the ramp."""
        self.began = True
        self.at_last = self._proxies[0].struck
        if self._when == "ramp" and status.t_s >= AT_S:
            self._proxies[0].armed = True

    def decide(self, status: Status) -> Continue | Stop:
        """Arm it with the last tick."""
        if self._when == "safe state" and status.t_s >= AT_S:
            self._proxies[0].armed = True
            return Stop("the safe state is what matters", who="spoiled answers")
        return Continue()


_here = threading.local()
"""Case of this thread, its simulators and its proxies."""


@contextmanager
def _between() -> Iterator[None]:
    """Keeps a reference to the simulator of each run, and routes its link through the proxy of its case."""
    simulate = stage.simulate

    @functools.wraps(simulate)
    def seen(*args: Any, **options: Any) -> SimulatedStation:
        _here.worlds.append(simulate(*args, **options))
        world: SimulatedStation = _here.worlds[-1]
        return world

    def link(url: str, **options: Any) -> ModbusLink:
        case: Case = _here.case
        proxy = SpoilingProxy(int(url.rpartition(":")[2]), case.function, case.kind, _here.seed)
        proxy.armed = case.when == "before"
        _here.proxies.append(proxy)
        return ModbusLink(f"tcp://127.0.0.1:{proxy.port}", **options | {"timeout_s": TIMEOUT_S})

    with (
        patch.object(stage, "simulate", seen), patch.object(opening, "ModbusLink", link), redirect_stderr(StringIO())
    ):  # fmt: skip
        yield


def _job(name: str, folder: Path) -> Job:
    content = dict(config.read_yaml(STATION).content)
    content["chamber"] = content["chamber"] | {"map": name, "link": {"degraded_after_s": 1.0, "lost_after_s": 3.0}}
    content["safe_state"] = {"retry_min": 0.1}
    station = config.load_config(config.parse_yaml(json.dumps(content), "station.yaml"), StationSettings)
    texts = {"model.yaml": "name: m\n"}
    return Job(profile_from_text(PROFILE), PROFILE, station, json.dumps(content), texts, out=folder)


def campaign(todo: Sequence[Case], seed: int, out: Path, at_once: int = 1) -> list[Outcome]:
    """Run what is not in the file yet, and append it; all outcomes that the file then holds."""

    def run(case: Case) -> Outcome:
        with tempfile.TemporaryDirectory() as scratch:
            return _run(case, seed, Path(scratch))

    done = {outcome.case for outcome in read(out)}
    with _between(), ThreadPoolExecutor(at_once) as pool:  # a run mostly waits for answers
        runs = {case: pool.submit(run, case) for case in todo if case not in done}
        return campaigns.resumed(
            todo, lambda case: runs[case].result(), out, lambda outcome: outcome.case, asdict, _made
        )


def read(path: Path) -> list[Outcome]:
    """Outcomes of an earlier, perhaps interrupted, campaign."""
    return campaigns.read(path, _made)


def _made(content: dict[str, Any]) -> Outcome:
    return Outcome(**{**content, "case": Case(**content["case"])})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("spoiled_answers.jsonl"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sample", type=int, help="only so many, drawn by the seed")
    parser.add_argument("--at-once", type=int, default=6, help="so many runs at a time")
    parser.add_argument("--map", action="append", default=[], help="only this register map; may be given several times")
    arguments = parser.parse_args()
    todo = cases(arguments.seed, arguments.map)[: arguments.sample]
    outcomes = campaign(todo, arguments.seed, arguments.out, arguments.at_once)
    wrong = [outcome for outcome in outcomes if outcome.wrong]
    figures = {
        "n": len(outcomes),
        "seed": arguments.seed,
        "answers_spoiled": sum(outcome.struck for outcome in outcomes),
        "safe_states_spoiled": sum(outcome.struck_at_end > 0 for outcome in outcomes),
        "off": sum(outcome.off for outcome in outcomes),
        "said_unverified": sum(outcome.unverified for outcome in outcomes),
        "wrong": [{**asdict(outcome.case), "wrong": outcome.wrong, "said": outcome.said} for outcome in wrong],
    }
    print(json.dumps(figures, indent=1))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
