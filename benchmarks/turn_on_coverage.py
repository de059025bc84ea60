"""How often does the expanded uncertainty U of a certificate hold the error of a fresh turn-on?

    python -m benchmarks.turn_on_coverage --archives 100 --seed 1 --out turn_on_coverage.jsonl

Each archive is a unit of its own history, as the shipped quick plan makes it: a calibration, a verification with its
power cycles, and a run of the verification's profile more. Every power-on has a draw of its turn-on bias, from the
seed and the count of power-ons, and every run noise of its own. U is what the certificate of the calibration with its
verification states (`uncertainty.expanded_dph`); the errors are what the calibration leaves in the fresh run. One row
of it is drawn for each archive, so a turn-on and a temperature. Counted is whether the error of this mean over the
averaging time is within U; the mean of all such means of the turn-on at the temperature stands beside it. A
calibration that gets no certificate states no U and is counted apart. Results are appended to the file as they come;
what stands there already is not run again. Prints one JSON object with n and seed; exit code 1 where the 95 % interval
of the share lies below 95 %.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.stats import binomtest

from bench.acquisition import load_profile
from bench.analysis import analyse, load_model
from bench.base import InputError, library
from bench.deliver import budget, gather
from bench.mystery import virtual
from bench.record import Manifest, RunFolder, load, write_means
from benchmarks import campaigns
from drivers.sim.resonator import PowerOn, UnitSettings, default_unit

MODELS = ("spline_lag_loop", "spline")
"""That of the quick plan; and one that knows neither lag nor loop, which is fitted ten times faster."""
CALIBRATION, CHECK = "quick_calibration", "quick_check"
NEAR_DEGC = 2.0
BAR = 0.95
TURN_ONS = {"shipped": None, "large": 0.5}
"""Standard deviation of the turn-on bias [deg/h]; None: that of the shipped unit."""


@dataclass(frozen=True)
class Case:
    """One archive."""

    turn_on: str
    number: int
    model: str = MODELS[0]


def cases(archives: int, turn_ons: Sequence[str] = (), models: Sequence[str] = MODELS[:1]) -> Iterator[Case]:
    """All of them, archive by archive, so that a campaign cut short is a smaller campaign."""
    for number in range(archives):
        for name in turn_ons or TURN_ONS:
            yield from (Case(name, number, model) for model in models)


def run_case(case: Case, seed: int) -> dict[str, Any]:
    """U, the errors of the fresh turn-on at one temperature, and the share of all its means that is outside.

    Or why the calibration gets no certificate.
    """
    settings, station = unit_of(case.turn_on), f"{seed} {case.turn_on} {case.number}"
    with tempfile.TemporaryDirectory() as place:
        folders, count = [], 1
        for profile in (CALIBRATION, CHECK, CHECK):
            folders.append(record(Path(place) / str(count), settings, profile, station, count))
            count += 1 + sum(segment.kind == "power_cycle" for segment in _chamber(profile).segments)
        analyse(folders[0], [load_model(case.model)], diagnose=False)
        try:
            evidence = gather(folders[0], (folders[1],), None, ())
        except InputError as refusal:  # a calibration that gets no certificate states no U
            return {"refused": str(refusal).rpartition("no certificate: ")[2]}
        stated = budget(evidence)
        fresh = load(folders[2])
        left = fresh.bias - evidence.source.fit.predict(fresh).bias
    rng = np.random.default_rng([seed, case.number, zlib.crc32(case.turn_on.encode())])
    temperature, known = fresh.channel("temperature"), np.isfinite(left)
    turn_on = rng.choice(np.unique(fresh.turn_on[known]))
    row = rng.choice(np.flatnonzero(known & (fresh.turn_on == turn_on)))
    near = known & (fresh.turn_on == turn_on) & (np.abs(temperature - temperature[row]) <= NEAR_DEGC)
    return {
        "expanded_dph": stated.expanded_dph,
        "coverage_factor": stated.at_rest.coverage_factor,
        "turn_ons": list(stated.turn_ons),
        "at_degc": float(temperature[row]),
        "error_dph": float(left[row]),
        "mean_error_dph": float(left[near].mean()),
        "outside": float(np.mean(np.abs(left[known]) > stated.expanded_dph)),
    }


def unit_of(turn_on: str) -> UnitSettings:
    """The shipped unit, with another scatter of its turn-on bias where the case has one."""
    shipped, sigma = default_unit(), TURN_ONS[turn_on]
    if sigma is None:
        return shipped
    truth = [m.model_copy(update={"sigma_dph": sigma}) if m.mechanism == "turn_on" else m for m in shipped.truth]
    return shipped.model_copy(update={"truth": tuple(truth)})


@lru_cache(maxsize=4)
def _chamber(profile: str) -> virtual.Trace:
    return virtual.chamber(load_profile(library() / f"{profile}.yaml"), seed=1)


def record(folder: Path, settings: UnitSettings, profile: str, station: str, count: int) -> Path:
    """A run folder of power-on number `count` of a unit; its seeds are made as those of a simulated run."""
    folder.mkdir(parents=True)
    trace, seed = _chamber(profile), zlib.crc32(f"{station} {profile}".encode())
    samples = virtual.unit(settings, trace, seed, power=PowerOn(count, seed=seed))
    run = RunFolder(folder)
    columns = {"time": samples.time, **samples.channels}
    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})
    pq.write_table(table.append_column("segment", pa.array(samples.segment.astype(np.int16))), run.data)
    write_means(run.data, run.means)
    (folder / "events.jsonl").write_text("", encoding="utf-8")
    Manifest(
        run=folder.name,
        unit="SIM-0001",
        created=f"2026-11-{20 + count}T06:00:00+00:00",
        profile=profile,
        state="done",
        cause="finished",
        simulated=True,
        power_on=count,
        sample_rate_hz=virtual.RATE_HZ,
        rows=len(samples.time),
        duration_s=float(trace.seconds),
        segments=trace.segments,
        losses={"received": len(samples.time), "lost": 0},
        files=run.hashes(),
    ).write(folder)
    return folder


def campaign(todo: Sequence[Case], seed: int, out: Path) -> list[tuple[Case, dict[str, Any]]]:
    """Run what is not in the file yet, and append it; all results that the file then holds."""
    return campaigns.found(todo, lambda case: run_case(case, seed), out, Case)


def table(results: Sequence[tuple[Case, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Of each turn-on: in how many archives U holds the error of the fresh turn-on."""
    rows = []
    for name, model in sorted({(case.turn_on, case.model) for case, _ in results}):
        every = [found for case, found in results if (case.turn_on, case.model) == (name, model)]
        mine = [found for found in every if "refused" not in found]
        for what in ("error_dph", "mean_error_dph"):
            held = sum(abs(found[what]) <= found["expanded_dph"] for found in mine)
            ends = binomtest(held, len(mine)).proportion_ci(0.95, method="exact")
            rows.append({
                "turn_on": name, "model": model, "what": what, "n": len(mine),
                "without_certificate": len(every) - len(mine), "held": held, "share": round(held / len(mine), 4),
                "interval": [round(ends.low, 4), round(ends.high, 4)], "below": bool(ends.high < BAR),
                "median_expanded_dph": round(float(np.median([found["expanded_dph"] for found in mine])), 4),
                "rms_error_dph": round(float(np.sqrt(np.mean([found[what] ** 2 for found in mine]))), 4),
                "means_outside": round(float(np.mean([found["outside"] for found in mine])), 4),
            })  # fmt: skip
    return rows


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--archives", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("turn_on_coverage.jsonl"))
    parser.add_argument(
        "--turn-on", action="append", default=[], choices=sorted(TURN_ONS), help="only this; repeatable"
    )
    parser.add_argument("--model", action="append", default=[], choices=MODELS, help="this one; repeatable")
    arguments = parser.parse_args()
    todo = list(cases(arguments.archives, arguments.turn_on, arguments.model or MODELS[:1]))
    rows = table(campaign(todo, arguments.seed, arguments.out))
    print(json.dumps({"seed": arguments.seed, "bar": BAR, "table": rows}, indent=1))
    return 1 if any(row["below"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
